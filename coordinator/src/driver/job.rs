//! What the driver holds for one job.

use super::Sink;
use super::handle::NoImage;
use super::live::Live;
use crate::report::About;
use crate::schedule::job::{Job, Stage, Step};
use crate::schedule::work::Kind;
use crate::schedule::{Outcome, Scheduler};
use crate::types::{JobId, JobProgress, JobState, JobStats, Limits, MapStats};
use gatherlight_proto::message::{BlobRef, SceneManifest};
use gatherlight_render::export::ImageMetadata;
use gatherlight_render::film::{ChannelSet, Film, TileGrid};
use gatherlight_render::job::{Phase, PreparedJob};
use gatherlight_render::photon::MapKind;
use gatherlight_render::settings::RenderSettings;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

/// A job as it is handed in: its blobs are there and its scene is prepared.
pub struct Spec {
    /// Name for listings.
    pub name: String,
    /// Makes a repeated submission the same job.
    pub request_key: [u8; 16],
    /// Its scene's files.
    pub manifest: SceneManifest,
    /// Its settings, as submitted.
    pub settings: RenderSettings,
    /// When to end it early.
    pub limits: Limits,
    /// Its scene.
    pub prepared: Arc<PreparedJob>,
}

impl std::fmt::Debug for Spec {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Spec").field("name", &self.name).finish_non_exhaustive()
    }
}

/// One job, from submission until it is forgotten.
pub(super) struct JobRecord {
    pub(super) id: JobId,
    name: String,
    pub(super) request_key: [u8; 16],
    pub(super) manifest: SceneManifest,
    pub(super) settings: RenderSettings,
    pub(super) grid: TileGrid,
    pub(super) channels: ChannelSet,
    /// Maps whose photons carry directions.
    pub(super) directions: BTreeSet<MapKind>,
    /// Until it ends.
    pub(super) live: Option<Live>,
    pub(super) stats: JobStats,
    pub(super) image: Option<BlobRef>,
    pub(super) kept_film: Option<(Film, ImageMetadata)>,
    /// What its image will say of how it was made.
    pub(super) about: About,
    submitted: Duration,
    state: JobState,
    round: u32,
    rounds: u32,
    /// Tiles or splat units of all rounds.
    image_units: u64,
    state_since: Duration,
    progress: watch::Sender<JobProgress>,
}

impl JobRecord {
    pub(super) fn new(id: JobId, spec: Spec, phases: &[Phase], sink: Option<Arc<dyn Sink>>, now: Duration) -> Self {
        let live = Live::new(&spec, sink);
        let Spec { name, request_key, manifest, settings, prepared, .. } = spec;
        let (grid, channels) = (prepared.grid(), prepared.channels());
        let prepared_rounds = prepared.rounds();
        let image_units = phases.iter().filter(|p| p.makes_image()).map(Phase::units).sum();
        let directions = MapKind::ALL.into_iter().filter(|&k| prepared.photon_directions(k)).collect();
        let about = About::new(&prepared, phases);
        let maps = map_stats(phases);
        let stats = JobStats { maps, k: settings.k, gather_radius: settings.max_radius, ..JobStats::default() };
        // Passes over the pixels are one phase to whoever watches.
        let rounds = if settings.merges_rounds() { prepared_rounds } else { 1 };
        let first = JobProgress { rounds, ..snapshot(id, &name, &stats) };
        JobRecord {
            id,
            name,
            request_key,
            manifest,
            settings,
            grid,
            channels,
            directions,
            live: Some(live),
            stats,
            image: None,
            kept_film: None,
            about,
            submitted: now,
            state: JobState::Waiting,
            round: 0,
            rounds,
            image_units,
            state_since: now,
            progress: watch::Sender::new(first),
        }
    }
    pub(super) fn watch(&self) -> watch::Receiver<JobProgress> {
        self.progress.subscribe()
    }
    pub(super) fn progress(&self) -> JobProgress {
        self.progress.borrow().clone()
    }
    pub(super) fn is_final(&self) -> bool {
        self.state.is_final()
    }
    pub(super) fn image(&self) -> Result<BlobRef, NoImage> {
        self.image.ok_or(NoImage::NotDone(self.state.name()))
    }
    pub(super) fn map_stats(&mut self, kind: MapKind) -> Option<&mut MapStats> {
        self.stats.maps.iter_mut().find(|m| m.kind == kind)
    }
    /// The job has ended: only its snapshot and image stay.
    pub(super) fn finish(&mut self, now: Duration, outcome: Outcome) {
        self.count_broadcast();
        self.live = None;
        let state = match outcome {
            Outcome::Done => JobState::Done,
            Outcome::Failed(error) => JobState::Failed(error),
            Outcome::Cancelled => JobState::Cancelled,
        };
        self.publish(now, state, (0, 0), 0);
    }
    /// Publishes a fresh snapshot of a running job.
    pub(super) fn refresh(&mut self, now: Duration, scheduler: &Scheduler) {
        let Some(job) = scheduler.job(self.id) else { return };
        self.count_broadcast();
        self.count(job);
        let holders: BTreeSet<_> = scheduler.leases().filter(|l| l.lease.job == self.id).map(|l| l.worker).collect();
        let (state, units) = self.visible_state(job, holders.len() as u64);
        self.publish(now, state, units, holders.len() as u32);
    }
    /// Takes over what the scheduler has counted.
    pub(super) fn count(&mut self, job: &Job) {
        for m in &mut self.stats.maps {
            let total = job.total(Kind::Emission(m.kind));
            (m.emitted_count, m.stored_count) = (total.units, total.stored);
        }
        let done = job.done();
        self.stats.retried_leases = job.retried;
        (self.stats.workers, self.stats.workers_lost) = (job.workers, job.workers_lost);
        self.stats.rounds_done = done.rounds;
        self.stats.units_done = done.units;
        self.stats.ended_by = done.ended_by;
        self.change_to(job.round().min(self.rounds - 1));
    }
    fn change_to(&mut self, round: u32) {
        if round != self.round {
            self.round = round;
            // The same state of another round begins anew.
            self.state_since = Duration::MAX;
        }
    }
    fn count_broadcast(&mut self) {
        if let Some(live) = &self.live {
            self.stats.broadcast_bytes = live.sent_bytes();
        }
    }
    /// The state a client sees, with units done and in all.
    fn visible_state(&self, job: &Job, workers: u64) -> (JobState, (u64, u64)) {
        if workers == 0 && self.state == JobState::Waiting && job.open_phases().next().is_some() {
            return (JobState::Waiting, (0, 0));
        }
        if job.is_assembling() {
            return (JobState::Assemble, (0, 0));
        }
        let round = job.round();
        let in_stage = |stage: Stage| job.steps().filter(move |s| s.round() == round && s.stage == stage);
        let done = |s: &Step| (s.work.done.units(), s.work.phase.units());
        // What the round's other phases wait for comes first.
        for s in in_stage(Stage::Working).chain(in_stage(Stage::Building)) {
            match (s.work.phase, s.stage) {
                (Phase::Emission { map, .. }, Stage::Working) => return (JobState::Emission(map), done(s)),
                (Phase::Emission { map, .. }, _) => return (JobState::Merge(map), (0, s.work.stored)),
                (Phase::Bootstrap { .. }, _) => return (JobState::Bootstrap, done(s)),
                _ => {}
            }
        }
        match in_stage(Stage::Working).next() {
            Some(s) if matches!(s.work.phase, Phase::Splat { .. }) => {
                (JobState::Splat, self.image_done(job, Kind::Splat, done(s)))
            }
            Some(s) => self.gathering(job, round, workers, done(s)),
            // A round is being closed.
            None if self.about.has_units() => (JobState::Splat, self.image_done(job, Kind::Splat, (0, 0))),
            None => (JobState::Gather, self.image_done(job, Kind::Gather, (0, 0))),
        }
    }
    /// Tiles or splat units done and in all: those of the round, or of all passes.
    fn image_done(&self, job: &Job, kind: Kind, of_round: (u64, u64)) -> (u64, u64) {
        if self.rounds == 1 { (job.total(kind).units, self.image_units) } else { of_round }
    }
    /// The state of a gather phase: maps are on their way until the first tiles are there.
    fn gathering(&self, job: &Job, round: u32, workers: u64, tiles: (u64, u64)) -> (JobState, (u64, u64)) {
        let tiles = self.image_done(job, Kind::Gather, tiles);
        let bytes: u64 = job.maps(round).iter().map(|m| m.bytes).sum();
        let (sent, total) = (self.live.as_ref().map_or(0, |l| l.sent_bytes_of(round)), bytes * workers.max(1));
        if tiles.0 == 0 && bytes > 0 && sent < total {
            return (JobState::Broadcast, (sent, total));
        }
        (JobState::Gather, tiles)
    }
    fn publish(&mut self, now: Duration, state: JobState, (done, total): (u64, u64), workers: u32) {
        if state != self.state || self.state_since > now {
            self.state_since = now;
            self.state = state;
        }
        let state_elapsed = now.saturating_sub(self.state_since);
        let seconds = state_elapsed.as_secs_f64();
        let next = JobProgress {
            state: self.state.clone(),
            done,
            total,
            rate: if seconds > 0.0 { done as f64 / seconds } else { 0.0 },
            state_elapsed,
            elapsed: now.saturating_sub(self.submitted),
            workers,
            stats: self.stats.clone(),
            result_digest: self.image.map(|i| i.digest),
            round: self.round,
            rounds: self.rounds,
            ..snapshot(self.id, &self.name, &self.stats)
        };
        self.progress.send_replace(next);
    }
}

fn snapshot(id: JobId, name: &str, stats: &JobStats) -> JobProgress {
    JobProgress {
        id,
        name: name.to_owned(),
        state: JobState::Waiting,
        done: 0,
        total: 0,
        rate: 0.0,
        state_elapsed: Duration::ZERO,
        elapsed: Duration::ZERO,
        workers: 0,
        stats: stats.clone(),
        result_digest: None,
        round: 0,
        rounds: 1,
    }
}

/// One entry a kind of map, over all rounds.
fn map_stats(phases: &[Phase]) -> Vec<MapStats> {
    let mut maps: Vec<MapStats> = Vec::new();
    for phase in phases {
        let Phase::Emission { map: kind, paths, .. } = *phase else { continue };
        match maps.iter_mut().find(|m| m.kind == kind) {
            Some(m) => m.emitted_total += paths,
            None => maps.push(MapStats { kind, emitted_count: 0, emitted_total: paths, stored_count: 0, bytes: 0 }),
        }
    }
    maps
}

//! What the driver holds for one job.

use super::handle::NoImage;
use super::live::{Live, StatedError};
use crate::schedule::job::{Job, Stage, Step};
use crate::schedule::work::Kind;
use crate::schedule::{Outcome, Scheduler};
use crate::types::{JobId, JobProgress, JobState, JobStats, MapStats};
use gatherlight_proto::message::{BlobRef, Submission};
use gatherlight_proto::stored::StoredJob;
use gatherlight_render::export::ImageMetadata;
use gatherlight_render::film::Film;
use gatherlight_render::job::{Phase, PreparedJob};
use gatherlight_render::settings::RenderSettings;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, SystemTime};
use tokio::sync::watch;

/// A job as it is handed in: its blobs are there and its scene is prepared.
pub struct Spec {
    /// What is wanted.
    pub submission: Submission,
    /// Name of the token that submits it; empty where there are none.
    pub owner: String,
    /// Its scene.
    pub prepared: Arc<PreparedJob>,
}

impl Spec {
    /// As it is kept.
    pub(super) fn stored(&self) -> StoredJob {
        StoredJob {
            submission: self.submission.clone(),
            owner: self.owner.clone(),
            submitted: since_1970(),
            program: gatherlight_render::VERSION.to_owned(),
            restarts: 0,
            last: None,
            image: None,
        }
    }
}

/// Time since 1970, by the clock on the wall: only it goes on while no coordinator runs.
pub(super) fn since_1970() -> Duration {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default()
}

impl std::fmt::Debug for Spec {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Spec").field("name", &self.submission.name).finish_non_exhaustive()
    }
}

/// One job, from submission until it is forgotten.
pub(super) struct JobRecord {
    pub(super) id: JobId,
    /// As it is kept.
    pub(super) stored: StoredJob,
    /// Until it ends.
    pub(super) live: Option<Live>,
    pub(super) stats: JobStats,
    /// Of them, what is of closed rounds whose film is kept.
    pub(super) kept_stats: JobStats,
    /// What is of later rounds.
    pub(super) later_stats: BTreeMap<u32, JobStats>,
    /// Bytes of results noted since a film was kept.
    pub(super) noted_bytes: u64,
    pub(super) image: Option<BlobRef>,
    pub(super) kept_film: Option<(Film, ImageMetadata)>,
    /// Time since the submission and before this driver.
    pub(super) age: Duration,
    submitted: Duration,
    state: JobState,
    round: u32,
    rounds: u32,
    /// Tiles or splat units of all rounds.
    image_units: u64,
    state_since: Duration,
    waits_for: String,
    progress: watch::Sender<JobProgress>,
}

impl JobRecord {
    /// Takes note of what the image says of its error.
    pub(super) fn state_error(&mut self, error: StatedError) {
        (self.stats.noise, self.stats.bias) = (error.noise, error.bias);
    }
    /// A job that was submitted `age` ago, or one that has ended.
    pub(super) fn new(id: JobId, stored: StoredJob, age: Duration, now: Duration) -> Self {
        let last = stored.last.clone();
        let first = last.unwrap_or_else(|| snapshot(id, &stored, &JobStats::default()));
        JobRecord {
            id,
            live: None,
            stats: first.stats.clone(),
            kept_stats: JobStats::default(),
            later_stats: BTreeMap::new(),
            noted_bytes: 0,
            image: stored.image,
            kept_film: None,
            age,
            submitted: now.saturating_sub(age),
            state: first.state.clone(),
            round: first.round,
            rounds: first.rounds,
            image_units: 0,
            state_since: now,
            waits_for: String::new(),
            progress: watch::Sender::new(first),
            stored,
        }
    }
    /// The work begins, or goes on from `kept`, counts over closed rounds, and `later` ones.
    pub(super) fn begin(&mut self, live: Live, rounds: u32, kept: JobStats, later: BTreeMap<u32, JobStats>) {
        self.image_units = live.phases.iter().filter(|p| p.makes_image()).map(Phase::units).sum();
        // Passes over the pixels are one phase to whoever watches.
        self.rounds = if self.stored.submission.settings.merges_rounds() { rounds } else { 1 };
        self.stats = JobStats { restarts: self.stored.restarts, ..kept.clone() };
        later.values().for_each(|part| self.stats.add(part));
        let radii = live.about.gather_radii.values().copied();
        self.stats.gather_radius = radii.reduce(f32::max).or(self.stats.gather_radius);
        (self.kept_stats, self.later_stats, self.live) = (kept, later, Some(live));
        let fresh = JobProgress { rounds: self.rounds, ..snapshot(self.id, &self.stored, &self.stats) };
        self.progress.send_replace(fresh);
    }
    /// Counts a part of the work of a round.
    pub(super) fn add_stats(&mut self, round: u32, part: &JobStats) {
        self.stats.add(part);
        self.later_stats.entry(round).or_default().add(part);
    }
    /// Counts over the rounds before `rounds`, whose film is kept from now on.
    pub(super) fn keep_stats(&mut self, rounds: u32, job: &Job) -> &JobStats {
        let later = self.later_stats.split_off(&rounds);
        std::mem::replace(&mut self.later_stats, later).values().for_each(|part| self.kept_stats.add(part));
        for m in &mut self.kept_stats.maps {
            let total = job.closed_totals().get(&Kind::Emission(m.kind)).copied().unwrap_or_default();
            (m.emitted_count, m.stored_count) = (total.units, total.stored);
        }
        self.kept_stats.gather_radius = self.stats.gather_radius;
        &self.kept_stats
    }
    pub(super) fn watch(&self) -> watch::Receiver<JobProgress> {
        self.progress.subscribe()
    }
    pub(super) fn progress(&self) -> JobProgress {
        self.progress.borrow().clone()
    }
    /// Whether it is what `owner` submitted with this key.
    pub(super) fn is(&self, owner: &str, request_key: &[u8; 16]) -> bool {
        self.stored.owner == owner && self.stored.submission.request_key == *request_key
    }
    pub(super) fn is_final(&self) -> bool {
        self.state.is_final()
    }
    pub(super) fn image(&self) -> Result<BlobRef, NoImage> {
        self.image.ok_or(NoImage::NotDone(self.state.name()))
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
        self.waits_for.clear();
        self.publish(now, state, (0, 0), 0);
        self.stored.last = Some(self.progress());
        self.stored.image = self.image;
    }
    /// Publishes a fresh snapshot of a running job.
    pub(super) fn refresh(&mut self, now: Duration, scheduler: &Scheduler) {
        let Some(job) = scheduler.job(self.id) else { return };
        self.count_broadcast();
        self.count(job);
        let holders: BTreeSet<_> = scheduler.leases().filter(|l| l.lease.job == self.id).map(|l| l.worker).collect();
        let (state, units) = self.visible_state(job, holders.len() as u64);
        self.waits_for = if holders.is_empty() { scheduler.waits_for(job) } else { String::new() };
        self.publish(now, state, units, holders.len() as u32);
    }
    /// Takes over what the scheduler has counted.
    pub(super) fn count(&mut self, job: &Job) {
        for m in &mut self.stats.maps {
            let total = job.total(Kind::Emission(m.kind));
            (m.emitted_count, m.stored_count) = (total.units, total.stored);
        }
        let done = job.done();
        (self.stats.retried_leases, self.stats.repeated_leases) = (job.retried, job.repeated);
        self.stats.disputes = job.disputes;
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
            Some(s) => self.gathering(job, round, done(s)),
            // A round is being closed.
            None if self.live.as_ref().is_some_and(|l| l.about.has_units()) => {
                (JobState::Splat, self.image_done(job, Kind::Splat, (0, 0)))
            }
            None => (JobState::Gather, self.image_done(job, Kind::Gather, (0, 0))),
        }
    }
    /// Tiles or splat units done and in all: those of the round, or of all passes.
    fn image_done(&self, job: &Job, kind: Kind, of_round: (u64, u64)) -> (u64, u64) {
        if self.rounds == 1 { (job.total(kind).units, self.image_units) } else { of_round }
    }
    /// The state of a gather phase: maps are on their way until the first tiles are there, or one copy has left from here.
    fn gathering(&self, job: &Job, round: u32, tiles: (u64, u64)) -> (JobState, (u64, u64)) {
        let tiles = self.image_done(job, Kind::Gather, tiles);
        let bytes: u64 = job.maps(round).iter().map(|m| m.bytes).sum();
        let (sent, total) = (self.live.as_ref().map_or(0, |l| l.sent_bytes_of(round)), bytes);
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
            waits_for: self.waits_for.clone(),
            ..snapshot(self.id, &self.stored, &self.stats)
        };
        self.progress.send_replace(next);
    }
}

fn snapshot(id: JobId, stored: &StoredJob, stats: &JobStats) -> JobProgress {
    JobProgress {
        id,
        name: stored.submission.name.clone(),
        owner: stored.owner.clone(),
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
        priority: stored.submission.priority,
        waits_for: String::new(),
    }
}

/// Counts of a job of these phases before it begins.
pub(super) fn first_stats(phases: &[Phase], settings: &RenderSettings) -> JobStats {
    JobStats { maps: map_stats(phases), k: settings.k, gather_radius: settings.max_radius, ..JobStats::default() }
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

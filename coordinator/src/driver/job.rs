//! What the driver holds for one job.

use super::handle::NoImage;
use crate::report::About;
use crate::schedule::job::{Emission, Job, JobStage, MapStage};
use crate::schedule::{Outcome, Scheduler};
use crate::types::{JobId, JobProgress, JobState, JobStats, MapStats};
use bytes::Bytes;
use gatherlight_proto::Digest;
use gatherlight_proto::message::{BlobRef, SceneManifest};
use gatherlight_render::export::ImageMetadata;
use gatherlight_render::film::{ChannelSet, Film, TileGrid};
use gatherlight_render::job::{Phase, PreparedJob};
use gatherlight_render::photon::merge::Merger;
use gatherlight_render::photon::{EmissionRange, MapKind};
use gatherlight_render::settings::RenderSettings;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
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
    /// Its scene.
    pub prepared: Arc<PreparedJob>,
}

impl std::fmt::Debug for Spec {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Spec").field("name", &self.name).finish_non_exhaustive()
    }
}

/// A map that workers may fetch.
pub(super) struct ServedMap {
    pub(super) digest: Digest,
    pub(super) bytes: Bytes,
    pub(super) sent: Arc<AtomicU64>,
}

/// Everything heavy of a job that has not ended.
pub(super) struct Live {
    pub(super) prepared: Option<Arc<PreparedJob>>,
    pub(super) mergers: BTreeMap<MapKind, Merger>,
    /// There once the first tile is.
    pub(super) film: Option<Film>,
    pub(super) maps: Vec<ServedMap>,
    pub(super) blobs: BTreeSet<Digest>,
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
    pub(super) live: Option<Live>,
    pub(super) stats: JobStats,
    pub(super) image: Option<BlobRef>,
    pub(super) kept_film: Option<(Film, ImageMetadata)>,
    /// What its image will say of how it was made.
    pub(super) about: About,
    submitted: Duration,
    state: JobState,
    state_since: Duration,
    progress: watch::Sender<JobProgress>,
}

impl JobRecord {
    pub(super) fn new(id: JobId, spec: Spec, now: Duration) -> Self {
        let Spec { name, request_key, manifest, settings, prepared } = spec;
        let (grid, channels) = (prepared.grid(), prepared.channels());
        let directions = MapKind::ALL.into_iter().filter(|&k| prepared.photon_directions(k)).collect();
        let mut mergers = BTreeMap::new();
        let mut maps = Vec::new();
        for phase in prepared.phases() {
            if let Phase::Emission { map: kind, paths, .. } = phase {
                mergers.insert(kind, Merger::new(kind, EmissionRange { first: 0, end: paths }));
                maps.push(MapStats { kind, emitted_count: 0, emitted_total: paths, stored_count: 0, bytes: 0 });
            }
        }
        let about = About::new(&prepared);
        let live = Live {
            mergers,
            film: None,
            maps: Vec::new(),
            blobs: manifest.blobs().iter().map(|b| b.digest).collect(),
            prepared: Some(prepared),
        };
        let stats = JobStats { maps, k: settings.k, gather_radius: settings.max_radius, ..JobStats::default() };
        let first = snapshot(id, &name, &stats);
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
        self.stats.retried_leases = job.retried;
        for e in &job.emissions {
            if let Some(m) = self.map_stats(e.kind) {
                m.emitted_count = e.work.done.units();
                m.stored_count = e.work.stored;
            }
        }
        let holders: BTreeSet<_> = scheduler.leases().filter(|l| l.lease.job == self.id).map(|l| l.worker).collect();
        let (state, units) = self.visible_state(job, holders.len() as u64);
        self.publish(now, state, units, holders.len() as u32);
    }
    fn count_broadcast(&mut self) {
        if let Some(live) = &self.live {
            self.stats.broadcast_bytes = live.maps.iter().map(|m| m.sent.load(Ordering::Relaxed)).sum();
        }
    }
    /// The state a client sees, with units done and in all.
    fn visible_state(&self, job: &Job, workers: u64) -> (JobState, (u64, u64)) {
        let done = |e: &Emission| (e.work.done.units(), e.work.phase.units());
        if workers == 0 && self.state == JobState::Waiting && job.open_phases().next().is_some() {
            return (JobState::Waiting, (0, 0));
        }
        match job.stage {
            JobStage::Assembling => (JobState::Assemble, (0, 0)),
            JobStage::Gathering => {
                let map_bytes: u64 = job.maps().iter().map(|m| m.bytes).sum();
                let (tiles, total) = (job.gather.done.units(), job.gather.phase.units());
                let broadcast_total = map_bytes * workers.max(1);
                if tiles == 0 && map_bytes > 0 && self.stats.broadcast_bytes < broadcast_total {
                    (JobState::Broadcast, (self.stats.broadcast_bytes, broadcast_total))
                } else {
                    (JobState::Gather, (tiles, total))
                }
            }
            JobStage::Emitting => {
                let find = |stage: MapStage| job.emissions.iter().find(move |e| e.stage == stage);
                match (find(MapStage::Emitting), find(MapStage::Building)) {
                    (Some(e), _) => (JobState::Emission(e.kind), done(e)),
                    (None, Some(e)) => (JobState::Merge(e.kind), (0, e.work.stored)),
                    (None, None) => (JobState::Gather, (0, 0)),
                }
            }
        }
    }
    fn publish(&mut self, now: Duration, state: JobState, (done, total): (u64, u64), workers: u32) {
        if state != self.state {
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
    }
}

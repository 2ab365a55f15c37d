//! What clients see of jobs and workers, and what coordinator and workers tell each other.

use crate::collective::Transfers;
use crate::digest::Digest;
use gatherlight_render::film::light_image::Mutations;
use gatherlight_render::film::{Bias, Noise};
use gatherlight_render::photon::MapKind;
use std::fmt;
use std::str::FromStr;
use std::time::Duration;

/// Names a job; drawn at random, so that it cannot be guessed from another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct JobId(pub u64);

impl fmt::Display for JobId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

/// A text that is no job id.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no job id; job ids are 16 hexadecimal digits, as `gatherlight jobs` lists them")]
pub struct ParseJobIdError(String);

impl FromStr for JobId {
    type Err = ParseJobIdError;
    fn from_str(s: &str) -> Result<Self, Self::Err> {
        let valid = s.len() == 16 && s.bytes().all(|b| b.is_ascii_hexdigit());
        let id = valid.then(|| u64::from_str_radix(s, 16).ok()).flatten();
        id.map(JobId).ok_or_else(|| ParseJobIdError(s.chars().take(64).collect()))
    }
}

/// Where a job stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum JobState {
    /// Accepted; no worker has begun.
    Waiting,
    /// Photon paths for this map are being traced.
    Emission(MapKind),
    /// This map's photons are merged and its search structure is built.
    Merge(MapKind),
    /// The maps are on their way to the workers.
    Broadcast,
    /// Bootstrap paths are being traced.
    Bootstrap,
    /// Units that splat onto the light image are being computed.
    Splat,
    /// Tiles are being rendered.
    Gather,
    /// All tiles are there; the image is being put together and encoded.
    Assemble,
    /// The image can be fetched.
    Done,
    /// The work failed; the text says why.
    Failed(String),
    /// Cancelled by a client.
    Cancelled,
}

impl JobState {
    /// Name in listings: `waiting`, `emission`, `merge`, `broadcast`, `bootstrap`, `splat`, `gather`, `assemble`, `done`,
    /// `failed`, `cancelled`.
    pub const fn name(&self) -> &'static str {
        match self {
            JobState::Waiting => "waiting",
            JobState::Emission(_) => "emission",
            JobState::Merge(_) => "merge",
            JobState::Broadcast => "broadcast",
            JobState::Bootstrap => "bootstrap",
            JobState::Splat => "splat",
            JobState::Gather => "gather",
            JobState::Assemble => "assemble",
            JobState::Done => "done",
            JobState::Failed(_) => "failed",
            JobState::Cancelled => "cancelled",
        }
    }
    /// Whether the job has come to its end.
    pub const fn is_final(&self) -> bool {
        matches!(self, JobState::Done | JobState::Failed(_) | JobState::Cancelled)
    }
}

/// When to end a job before all its rounds or units are done. Like a configuration, it is no part of the settings: the image
/// says how many rounds or units it is made of.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Limits {
    /// Time since the submission, after which no further round or unit is begun.
    pub time: Option<Duration>,
    /// Relative standard error of the image (> 0) from which on no further round is begun.
    pub error: Option<f32>,
}

/// A limit that ended a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Limit {
    /// [`Limits::time`].
    Time,
    /// [`Limits::error`].
    Error,
}

impl Limit {
    /// Name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Limit::Time => "time",
            Limit::Error => "error",
        }
    }
}

/// Counts of one photon map, or of all rounds' maps of its kind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapStats {
    /// Which map.
    pub kind: MapKind,
    /// Photon paths emitted so far; the divisor of every estimate once the map is built.
    pub emitted_count: u64,
    /// Photon paths to emit.
    pub emitted_total: u64,
    /// Photons stored so far.
    pub stored_count: u64,
    /// Bytes of the maps built so far, as broadcast.
    pub bytes: u64,
}

/// What was not finite and was left out, by where it arose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NonFinite {
    /// Camera samples.
    pub samples: u64,
    /// Splats of light paths and Markov chains.
    pub splats: u64,
    /// Photons and light vertices.
    pub photons: u64,
}

impl NonFinite {
    /// Adds others.
    pub fn add(&mut self, other: &NonFinite) {
        self.samples = self.samples.saturating_add(other.samples);
        self.splats = self.splats.saturating_add(other.splats);
        self.photons = self.photons.saturating_add(other.photons);
    }
    /// All of them.
    pub fn total(&self) -> u64 {
        self.samples.saturating_add(self.splats).saturating_add(self.photons)
    }
}

/// What a job has cost and counted so far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JobStats {
    /// Per photon map, in canonical order; empty where the method needs none.
    pub maps: Vec<MapStats>,
    /// Rays traced by gather and splat phases.
    pub rays: u64,
    /// Samples and splats left out because they were not finite.
    pub non_finite: NonFinite,
    /// What Markov chains did.
    pub mutations: Mutations,
    /// The image's noise so far, once two rounds are there to compare.
    pub noise: Option<Noise>,
    /// Its bias so far, of methods whose rounds are blurred, once there are enough to compare.
    pub bias: Option<Bias>,
    /// Largest gather radius, in world units, once known: given or chosen from the map's density.
    pub gather_radius: Option<f32>,
    /// Neighbours of a density estimate.
    pub k: u32,
    /// Compute time of all workers, summed over their threads' pools (wall time of tasks).
    pub busy: Duration,
    /// Leases handed out again because a worker was lost or late, failed or gave them back.
    pub retried_leases: u64,
    /// Leases given to a second worker because the first one took long.
    pub repeated_leases: u64,
    /// Workers that were given work.
    pub workers: u32,
    /// Of them, those that were lost.
    pub workers_lost: u32,
    /// Bytes of results received from workers.
    pub result_bytes: u64,
    /// Bytes of maps and bootstraps sent to workers.
    pub broadcast_bytes: u64,
    /// Rounds of the gather phase that are complete.
    pub rounds_done: u32,
    /// Units of the splat phase done: Markov chains, or whole rounds.
    pub units_done: u64,
    /// The limit that ended the job before its last round or unit.
    pub ended_by: Option<Limit>,
    /// Results that two workers gave for the same indices and that differ: one of them has bad hardware.
    pub disputes: u64,
    /// Times the coordinator was restarted amid the job.
    pub restarts: u32,
    /// What collective operations moved, of results that count; a coordinator that is started again knows those of rounds whose
    /// film it finds.
    pub transfers: Transfers,
}

impl JobStats {
    /// Adds the work that `part` counts: rays, mutations, what was not finite, time, transfers, and bytes of results and
    /// maps.
    pub fn add(&mut self, part: &JobStats) {
        self.rays = self.rays.saturating_add(part.rays);
        self.mutations.add(&part.mutations);
        self.non_finite.add(&part.non_finite);
        self.busy += part.busy;
        self.result_bytes += part.result_bytes;
        self.transfers.add(&part.transfers);
        for map in &part.maps {
            match self.maps.iter_mut().find(|m| m.kind == map.kind) {
                Some(m) => m.bytes += map.bytes,
                None => self.maps.push(*map),
            }
        }
    }
}

/// A snapshot of one job.
#[derive(Clone, Debug, PartialEq)]
pub struct JobProgress {
    /// The job.
    pub id: JobId,
    /// Its name, by default the scene file's.
    pub name: String,
    /// Name of the token that submitted it; empty where there are no tokens.
    pub owner: String,
    /// Where it stands.
    pub state: JobState,
    /// The round that is worked on, from 0.
    pub round: u32,
    /// Rounds in all, ≥ 1.
    pub rounds: u32,
    /// Units of the present state done: paths, bytes (broadcast), units or tiles.
    pub done: u64,
    /// Units of the present state in all; 0 where it has none.
    pub total: u64,
    /// Units per second of the present state, averaged since it began; 0 while unknown.
    pub rate: f64,
    /// Time since the present state began.
    pub state_elapsed: Duration,
    /// Time since the job was submitted; stands still once it has ended.
    pub elapsed: Duration,
    /// Workers that hold a lease of this job now.
    pub workers: u32,
    /// Counts so far.
    pub stats: JobStats,
    /// BLAKE3 digest of the finished EXR, once done.
    pub result_digest: Option<Digest>,
    /// Jobs of higher priority get workers first.
    pub priority: i32,
    /// Why no worker works on it, as a sentence; empty where one does, or will.
    pub waits_for: String,
}

/// A worker as the coordinator sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct WorkerInfo {
    /// Number given on joining; never used again.
    pub id: u64,
    /// Name it gave itself.
    pub name: String,
    /// Compute threads.
    pub threads: u32,
    /// Memory it may use, in bytes.
    pub memory_bytes: u64,
    /// `working`, `idle`, `draining` or `set aside`.
    pub state: String,
    /// Leases it holds.
    pub leases: u32,
    /// Leases it has completed.
    pub completed: u64,
    /// Time since it was last heard.
    pub last_heard: Duration,
    /// Time since it joined.
    pub joined: Duration,
}

//! How a worker runs. Nothing here can change an image.

use crate::counters::Counters;
use crate::relay::Listen;
use crate::shared::Shared;
use gatherlight_proto::message::{Lease, Task};
use gatherlight_proto::version::Versions;
use std::sync::Arc;
use std::time::Duration;

/// Failed attempts in a row to reach the coordinator before a worker gives up: with pauses of up to 10 s, a coordinator
/// may be away for a quarter of an hour.
pub const DEFAULT_ATTEMPTS: u32 = 100;
/// Memory a worker may use unless told: enough for two maps of 10⁸ photons.
pub const DEFAULT_MEMORY_BYTES: u64 = 8 << 30;

/// A worker's configuration.
#[derive(Clone, Debug)]
pub struct WorkerConfig {
    /// Name for listings.
    pub name: String,
    /// Compute threads; 0: one per core.
    pub threads: usize,
    /// Memory for scene files and maps, in bytes.
    pub memory_bytes: u64,
    /// Failed attempts in a row before it gives up.
    pub max_attempts: u32,
    /// Whether and where it listens for other workers.
    pub relay: Listen,
    /// Versions it claims; tests claim others.
    pub versions: Versions,
    /// What it counts of itself.
    pub counters: Arc<Counters>,
    /// What is in this process already.
    pub shared: Shared,
    /// Misbehaviour, for tests.
    pub faults: Faults,
}

impl WorkerConfig {
    /// Defaults beside the name.
    pub fn new(name: impl Into<String>) -> Self {
        WorkerConfig {
            name: name.into(),
            threads: 0,
            memory_bytes: DEFAULT_MEMORY_BYTES,
            max_attempts: DEFAULT_ATTEMPTS,
            relay: Listen::Auto,
            versions: Versions::own(),
            counters: Arc::default(),
            shared: Shared::default(),
            faults: Faults::default(),
        }
    }
}

/// Misbehaviour that tests ask for.
#[derive(Clone, Debug, Default)]
pub struct Faults {
    /// Waits this long before each task.
    pub delay: Duration,
    /// Is slow: takes this much longer for each photon path.
    pub per_path: Duration,
    /// Is slow: takes this much longer for each tile.
    pub per_tile: Duration,
    /// Vanishes, without a word, when it is given emission task number n (from 0).
    pub die_at_emission: Option<u64>,
    /// Vanishes when it is given bootstrap task number n (from 0).
    pub die_at_bootstrap: Option<u64>,
    /// Vanishes when it is given splat task number n (from 0).
    pub die_at_splat: Option<u64>,
    /// Vanishes when it is given gather task number n (from 0).
    pub die_at_gather: Option<u64>,
    /// Reports every task as failed with this text.
    pub fail: Option<String>,
    /// Flips a bit in every result.
    pub corrupt: bool,
    /// Delivers every result twice.
    pub deliver_twice: bool,
}

impl Faults {
    /// How much longer it takes for a lease.
    pub(crate) fn slowness(&self, lease: &Lease) -> Duration {
        let each = match lease.task {
            Task::Emission { .. } => self.per_path,
            Task::Gather { .. } => self.per_tile,
            Task::Bootstrap | Task::Splat { .. } => Duration::ZERO,
        };
        each.mul_f64(lease.range.len() as f64)
    }
}

//! What computing and sending cost in a run that is timed, not only checked.

use super::World;
use crate::pipeline::{Link, estimate};
use gatherlight_proto::message::{Lease, Task};
use gatherlight_proto::types::JobId;
use gatherlight_render::job::Phase;

/// Costs in seconds and bytes. All machines are alike and have the same link; the coordinator's takes in one result after the
/// other. Where a run has none, computing costs by fixed units, and results and maps count with [`Costs::NOMINAL`] bytes
/// and take no time.
#[derive(Clone, Copy, Debug)]
pub struct Costs {
    /// Every machine's link.
    pub link: Link,
    /// A worker's seconds for a photon path.
    pub path: f64,
    /// A worker's seconds for a tile of one round.
    pub tile: f64,
    /// Photons stored for each path.
    pub stored_per_path: f64,
    /// Bytes of a stored photon in a batch or a map.
    pub photon_bytes: f64,
    /// Bytes of a tile.
    pub tile_bytes: f64,
    /// The coordinator's seconds to decode a photon of a batch, beside receiving others.
    pub decode_photon: f64,
    /// The coordinator's seconds to merge, build and encode a photon of a map.
    pub build_photon: f64,
    /// A worker's seconds to decode a photon of a map.
    pub read_photon: f64,
    /// The coordinator's seconds to close a round, and to put the image together.
    pub close: f64,
}

impl Costs {
    /// Bytes of photons and tiles where only bytes are counted.
    pub(super) const NOMINAL: (f64, f64) = (11.0, 3_072.0);
}

/// Seconds as the simulation's microseconds.
pub(super) fn micros(seconds: f64) -> u64 {
    (seconds * 1e6).ceil() as u64
}

impl World<'_> {
    /// Photons stored by `paths`.
    pub(super) fn stored(&self, task: &Task, paths: u64) -> u64 {
        match (task, &self.conditions.costs) {
            (Task::Emission { .. }, Some(c)) => (paths as f64 * c.stored_per_path) as u64,
            (Task::Emission { .. }, None) => paths / 2,
            _ => 0,
        }
    }
    /// Microseconds that a worker computes a lease.
    pub(super) fn compute_time(&self, lease: &Lease, speed: u64) -> u64 {
        let units = lease.range.len();
        match (&self.conditions.costs, &lease.task) {
            (Some(c), Task::Emission { .. } | Task::Bootstrap) => micros(units as f64 * c.path).max(1),
            (Some(c), Task::Gather { .. } | Task::Splat { .. }) => micros(units as f64 * c.tile).max(1),
            (None, task) => super::cost(task) * units * 1_000_000 / speed + 1,
        }
    }
    /// Counts the bytes of a result and returns the microseconds after which it has arrived.
    pub(super) fn deliver_time(&mut self, task: &Task, units: u64) -> u64 {
        let (photon, tile) = self.conditions.costs.map_or(Costs::NOMINAL, |c| (c.photon_bytes, c.tile_bytes));
        let stored = self.stored(task, units) as f64;
        let bytes = match task {
            Task::Gather { .. } | Task::Splat { .. } => units as f64 * tile,
            Task::Emission { .. } => stored * photon,
            Task::Bootstrap => units as f64 * 4.0,
        };
        self.report.result_bytes += bytes as u64;
        let Some(c) = &self.conditions.costs else { return 0 };
        // The link takes one after the other, and decoding keeps up or does not.
        let seconds = (bytes / c.link.bytes_per_second).max(stored * c.decode_photon);
        self.received_until = self.received_until.max(self.now) + micros(seconds);
        self.received_until - self.now + micros(c.link.latency)
    }
    /// Microseconds until what is made of a phase is there, at the coordinator; after that, its map travels.
    pub(super) fn build_time(&mut self, job: JobId, phase: Phase) -> u64 {
        let is_map = matches!(phase, Phase::Emission { .. });
        let paths = phase.units();
        let task = Task::Emission { round: 0, map: gatherlight_render::photon::MapKind::Global };
        let photons = if is_map { self.stored(&task, paths) as f64 } else { 0.0 };
        let Some(c) = self.conditions.costs else {
            self.report.broadcast_bytes += (photons * Costs::NOMINAL.0) as u64;
            return 200_000;
        };
        if !is_map {
            return micros(c.close);
        }
        let bytes = (photons * c.photon_bytes) as u64;
        self.report.broadcast_bytes += bytes;
        let built = micros(photons * c.build_photon);
        let travels = estimate(self.workers.len(), bytes, c.link) + photons * c.read_photon;
        let ready = self.maps_ready.entry((job, phase.round())).or_default();
        *ready = (*ready).max(self.now + built + micros(travels));
        built
    }
    /// When the maps that a task reads are at its worker.
    pub(super) fn ready_at(&self, lease: &Lease) -> u64 {
        let Task::Gather { round, .. } = lease.task else { return 0 };
        // Passes read the maps of the last round that had any.
        self.maps_ready.range((lease.job, 0)..=(lease.job, round)).next_back().map_or(0, |(_, &at)| at)
    }
}

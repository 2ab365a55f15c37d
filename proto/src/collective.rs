//! What the collective operations of a job moved, and how long that took.

use std::time::Duration;

/// A collective operation: one payload to every worker, or a part from every worker to the coordinator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Collective {
    /// The scene's files, to each worker.
    BroadcastScene,
    /// Photon maps, to each worker.
    BroadcastMap,
    /// The joined bootstrap, to each worker.
    BroadcastBootstrap,
    /// The sample map, to each worker.
    BroadcastSampleMap,
    /// Photons, to the coordinator.
    GatherPhotons,
    /// Luminances of bootstrap paths, to the coordinator.
    GatherLuminances,
    /// Tiles, to the coordinator; with the light image of their samples, where the method splats.
    GatherTiles,
    /// Light images of splat phases, to the coordinator's sum.
    ReduceLight,
}

impl Collective {
    /// All, in the order in which a job comes to them.
    pub const ALL: [Collective; 8] = [
        Collective::BroadcastScene,
        Collective::GatherPhotons,
        Collective::BroadcastMap,
        Collective::GatherLuminances,
        Collective::BroadcastBootstrap,
        Collective::BroadcastSampleMap,
        Collective::GatherTiles,
        Collective::ReduceLight,
    ];

    /// Whether workers receive it.
    pub const fn is_broadcast(self) -> bool {
        use Collective::{BroadcastBootstrap, BroadcastMap, BroadcastSampleMap, BroadcastScene};
        matches!(self, BroadcastScene | BroadcastMap | BroadcastBootstrap | BroadcastSampleMap)
    }
    /// Name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Collective::BroadcastScene => "broadcast scene",
            Collective::BroadcastMap => "broadcast maps",
            Collective::BroadcastBootstrap => "broadcast bootstrap",
            Collective::BroadcastSampleMap => "broadcast sample map",
            Collective::GatherPhotons => "gather photons",
            Collective::GatherLuminances => "gather luminances",
            Collective::GatherTiles => "gather tiles",
            Collective::ReduceLight => "reduce light images",
        }
    }
}

/// Transfers of one kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Transfer {
    /// How many.
    pub count: u64,
    /// Bytes received.
    pub bytes: u64,
    /// Their times, summed: of a broadcast how long the worker waited for it, of what is sent to the coordinator from its
    /// announcement to its last byte, with the wait for room.
    pub time: Duration,
}

impl Transfer {
    /// Adds others.
    pub fn add(&mut self, other: Transfer) {
        self.count = self.count.saturating_add(other.count);
        self.bytes = self.bytes.saturating_add(other.bytes);
        self.time = self.time.saturating_add(other.time);
    }
}

/// Transfers by collective.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Transfers([Transfer; Collective::ALL.len()]);

impl Transfers {
    /// Adds `transfer` to those of its kind.
    pub fn record(&mut self, collective: Collective, transfer: Transfer) {
        self.0[collective as usize].add(transfer);
    }
    /// Adds others.
    pub fn add(&mut self, others: &Transfers) {
        self.0.iter_mut().zip(others.0).for_each(|(sum, other)| sum.add(other));
    }
    /// Those of one kind.
    pub fn of(&self, collective: Collective) -> Transfer {
        self.0[collective as usize]
    }
    /// The kinds that there are any of, in the order of [`Collective::ALL`].
    pub fn iter(&self) -> impl Iterator<Item = (Collective, Transfer)> {
        Collective::ALL.into_iter().map(|c| (c, self.of(c))).filter(|(_, t)| t.count > 0)
    }
}

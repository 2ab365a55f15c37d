//! The indices of one phase, and counts over phases of a kind.

use super::pool::IntervalPool;
use core::time::Duration;
use gatherlight_proto::message::WorkerId;
use gatherlight_render::job::Phase;
use gatherlight_render::photon::{EmissionRange, MapKind};

/// Phases that are alike in all rounds: what is measured of one holds for the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Emission for this map.
    Emission(MapKind),
    /// Bootstrap.
    Bootstrap,
    /// Where the samples go.
    SampleMap,
    /// Splat.
    Splat,
    /// Gather.
    Gather,
}

impl Kind {
    /// That of a phase.
    pub const fn of(phase: Phase) -> Self {
        match phase {
            Phase::Emission { map, .. } => Kind::Emission(map),
            Phase::Bootstrap { .. } => Kind::Bootstrap,
            Phase::SampleMap { .. } => Kind::SampleMap,
            Phase::Splat { .. } => Kind::Splat,
            Phase::Gather { .. } => Kind::Gather,
        }
    }
}

/// Counts over all phases of a kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Total {
    /// Indices done.
    pub units: u64,
    /// Photons in accepted results.
    pub stored: u64,
}

impl Total {
    /// Adds what is done of a phase.
    pub fn add(&mut self, work: &Work) {
        self.units += work.done.units();
        self.stored += work.stored;
    }
}

/// What is remembered of indices that came back undone.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct History {
    /// Times they were leased.
    pub attempts: u32,
    /// Times their worker was lost or late.
    pub losses: u32,
    /// Who failed on them, and why.
    pub failures: Vec<(WorkerId, String)>,
}

/// Indices to be leased again, as they were.
#[derive(Clone, Debug, PartialEq)]
pub struct Retry {
    /// The indices.
    pub range: EmissionRange,
    /// Their past.
    pub history: History,
    /// When they came back.
    pub since: Duration,
}

/// The indices of one phase.
#[derive(Clone, Debug)]
pub struct Work {
    /// The phase.
    pub phase: Phase,
    /// Never leased.
    pub fresh: IntervalPool,
    /// To be leased again.
    pub retries: Vec<Retry>,
    /// Done; never handed out again.
    pub done: IntervalPool,
    /// Photons in accepted results.
    pub stored: u64,
}

impl Work {
    /// Nothing is done yet.
    pub fn new(phase: Phase) -> Self {
        let fresh = IntervalPool::full(phase.units());
        Work { phase, fresh, retries: Vec::new(), done: IntervalPool::default(), stored: 0 }
    }
    /// Units not handed out now.
    pub fn waiting(&self) -> u64 {
        self.fresh.units() + self.retries.iter().map(|r| r.range.len()).sum::<u64>()
    }
    /// Whether every index is done.
    pub fn is_complete(&self) -> bool {
        self.done.units() == self.phase.units()
    }
}

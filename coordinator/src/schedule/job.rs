//! One job's work: what is handed out, what is done, what comes next.
//!
//! ```text
//!               all photons there           all maps built            all tiles there
//!  each map:  Emitting ───► Building ───► Built
//!  the job:   Emitting ─────────────────────────► Gathering ─────────► Assembling ───► Done
//!                 └───────────────────────────────────┴───────────────────┴──────────► Failed | Cancelled
//! ```
//! Maps are worked on in order, and the next one is begun as soon as nothing of the one before is left to hand out: one
//! is merged while the next is traced. A method without photons begins with Gathering.

use super::pool::IntervalPool;
use core::time::Duration;
use gatherlight_proto::message::{MapRef, Task, WorkerId};
use gatherlight_proto::types::JobId;
use gatherlight_render::job::Phase;
use gatherlight_render::photon::{EmissionRange, MapKind};

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
    fn new(phase: Phase) -> Self {
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
    /// Photons stored per path so far.
    pub fn stored_per_unit(&self) -> f64 {
        if self.done.is_empty() { 0.0 } else { self.stored as f64 / self.done.units() as f64 }
    }
}

/// State of one map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapStage {
    /// Photons are missing.
    Emitting,
    /// The coordinator merges and builds.
    Building,
    /// Workers may fetch it.
    Built(MapRef),
}

/// One map's emission.
#[derive(Clone, Debug)]
pub struct Emission {
    /// Which map.
    pub kind: MapKind,
    /// Its paths.
    pub work: Work,
    /// Its state.
    pub stage: MapStage,
}

/// State of the job; see the drawing above. Ended jobs are no longer here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JobStage {
    /// Maps are missing.
    Emitting,
    /// Tiles are missing.
    Gathering,
    /// The coordinator puts the image together.
    Assembling,
}

/// A job that has not ended.
#[derive(Clone, Debug)]
pub struct Job {
    /// Its id.
    pub id: JobId,
    /// Its maps, in order.
    pub emissions: Vec<Emission>,
    /// Its tiles.
    pub gather: Work,
    /// Its state.
    pub stage: JobStage,
    /// Leases handed out again so far.
    pub retried: u64,
    /// Since when every worker that is there is set aside.
    pub stuck_since: Option<Duration>,
}

/// What a job wants of the coordinator after a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Nothing new.
    Nothing,
    /// Merge and build this map.
    Build(MapKind),
    /// Put the image together.
    Assemble,
}

impl Job {
    /// `None` when the last phase is not the gather pass, or it is not the only one.
    pub fn new(id: JobId, phases: &[Phase]) -> Option<Self> {
        let (&last, first) = phases.split_last()?;
        let Phase::Gather { .. } = last else { return None };
        let mut emissions: Vec<Emission> = Vec::new();
        for &phase in first {
            match phase {
                Phase::Emission { map, .. } if emissions.iter().all(|e| e.kind != map) => {
                    emissions.push(Emission { kind: map, work: Work::new(phase), stage: MapStage::Emitting });
                }
                _ => return None,
            }
        }
        let stage = if emissions.is_empty() { JobStage::Gathering } else { JobStage::Emitting };
        Some(Job { id, emissions, gather: Work::new(last), stage, retried: 0, stuck_since: None })
    }
    /// The phases with something to hand out, in order, by index; the gather pass comes after all emissions.
    pub fn open_phases(&self) -> impl Iterator<Item = usize> + '_ {
        let gather = (self.stage == JobStage::Gathering).then_some(self.emissions.len());
        (0..self.emissions.len()).chain(gather).filter(|&i| self.work(i).is_some_and(|w| w.waiting() > 0))
    }
    /// Work of phase `index`.
    pub fn work(&self, index: usize) -> Option<&Work> {
        match self.emissions.get(index) {
            Some(e) => Some(&e.work),
            None => (index == self.emissions.len()).then_some(&self.gather),
        }
    }
    /// Work of phase `index`.
    pub fn work_mut(&mut self, index: usize) -> Option<&mut Work> {
        let gather = self.emissions.len();
        match self.emissions.get_mut(index) {
            Some(e) => Some(&mut e.work),
            None => (index == gather).then_some(&mut self.gather),
        }
    }
    /// What a worker is told to do with indices of phase `index`.
    pub fn task(&self, index: usize) -> Task {
        match self.emissions.get(index) {
            Some(e) => Task::Emission(e.kind),
            None => Task::Gather(self.maps()),
        }
    }
    /// The maps that are built, in order.
    pub fn maps(&self) -> Vec<MapRef> {
        let built = |e: &Emission| if let MapStage::Built(map) = e.stage { Some(map) } else { None };
        self.emissions.iter().filter_map(built).collect()
    }
    /// Takes the steps that are due after something was done. To be called until it returns [`Next::Nothing`].
    pub fn advance(&mut self) -> Next {
        for e in &mut self.emissions {
            if e.stage == MapStage::Emitting && e.work.is_complete() {
                e.stage = MapStage::Building;
                return Next::Build(e.kind);
            }
        }
        let built = self.emissions.iter().all(|e| matches!(e.stage, MapStage::Built(_)));
        if self.stage == JobStage::Emitting && built {
            self.stage = JobStage::Gathering;
        }
        if self.stage == JobStage::Gathering && self.gather.is_complete() {
            self.stage = JobStage::Assembling;
            return Next::Assemble;
        }
        Next::Nothing
    }
    /// Notes that a map is built. Returns whether that was awaited.
    pub fn map_built(&mut self, map: MapRef) -> bool {
        let awaited = self.emissions.iter_mut().find(|e| e.kind == map.kind && e.stage == MapStage::Building);
        awaited.map(|e| e.stage = MapStage::Built(map)).is_some()
    }
}

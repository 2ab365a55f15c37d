//! The workers that are there.

use super::work::Kind;
use core::time::Duration;
use gatherlight_proto::message::{LeaseId, WorkerId};
use gatherlight_proto::types::JobId;
use std::collections::{BTreeMap, BTreeSet};

/// Weight of the latest measurement in a worker's rate.
const RATE_WEIGHT: f64 = 0.5;
/// Shortest computing time believed of a result; keeps rates finite.
const MIN_BUSY_SECONDS: f64 = 1e-4;

/// One kind of phase of one job: rounds after the first begin with the rates of the one before.
pub type PhaseKey = (JobId, Kind);

/// A worker with an open session.
#[derive(Clone, Debug)]
pub struct Worker {
    /// Its compute threads.
    pub threads: u32,
    /// Memory it may use, bytes.
    pub memory_bytes: u64,
    /// When it joined.
    pub joined: Duration,
    /// When it was last heard.
    pub last_heard: Duration,
    /// Leases it holds.
    pub leases: BTreeSet<LeaseId>,
    /// Leases it had whose twins were faster, and of which it has not been heard since: it gets no others before.
    pub behind: BTreeSet<LeaseId>,
    /// Jobs it knows.
    pub prepared: BTreeSet<JobId>,
    /// Units per second, by kind of phase.
    rates: BTreeMap<PhaseKey, f64>,
    /// Tasks it failed, by job: phase and first index.
    failed: BTreeMap<JobId, BTreeSet<(usize, u64)>>,
    /// It wants no more leases.
    pub draining: bool,
    /// Leases it has completed.
    pub completed: u64,
}

impl Worker {
    /// A worker that joins now.
    pub fn new(now: Duration, threads: u32, memory_bytes: u64) -> Self {
        Worker {
            threads,
            memory_bytes,
            joined: now,
            last_heard: now,
            leases: BTreeSet::new(),
            behind: BTreeSet::new(),
            prepared: BTreeSet::new(),
            rates: BTreeMap::new(),
            failed: BTreeMap::new(),
            draining: false,
            completed: 0,
        }
    }
    /// Whether it may have more leases, if it has room.
    pub fn is_ready(&self) -> bool {
        !self.draining && self.behind.is_empty()
    }
    /// Whether it has kept up: it is outrun by nobody, and was heard within `quiet`. Others may then wait for what it passes on.
    pub fn is_prompt(&self, now: Duration, quiet: Duration) -> bool {
        self.behind.is_empty() && now.saturating_sub(self.last_heard) <= quiet
    }
    /// Units per second of a phase, where it was measured.
    pub fn rate(&self, phase: PhaseKey) -> Option<f64> {
        self.rates.get(&phase).copied()
    }
    /// Learns from a result.
    pub fn measured(&mut self, phase: PhaseKey, units: u64, busy: Duration) {
        let rate = units as f64 / busy.as_secs_f64().max(MIN_BUSY_SECONDS);
        let entry = self.rates.entry(phase).or_insert(rate);
        *entry += RATE_WEIGHT * (rate - *entry);
    }
    /// Notes a failed task; returns how many different ones of this job it has failed.
    pub fn failed(&mut self, job: JobId, phase: usize, first: u64) -> usize {
        let tasks = self.failed.entry(job).or_default();
        tasks.insert((phase, first));
        tasks.len()
    }
    /// Whether it has failed `limit` tasks of `job`.
    pub fn is_set_aside(&self, job: JobId, limit: usize) -> bool {
        self.failed.get(&job).is_some_and(|tasks| tasks.len() >= limit)
    }
    /// Whether it is set aside for any job.
    pub fn is_set_aside_somewhere(&self, limit: usize) -> bool {
        self.failed.values().any(|tasks| tasks.len() >= limit)
    }
    /// Drops what is known of an ended job; returns whether the worker knew it.
    pub fn forget(&mut self, job: JobId) -> bool {
        self.rates.retain(|&(j, _), _| j != job);
        self.failed.remove(&job);
        self.prepared.remove(&job)
    }
}

/// All workers, by id.
pub type Workers = BTreeMap<WorkerId, Worker>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nobody_waits_for_one_that_is_silent_or_outrun() {
        let at = Duration::from_secs;
        let mut w = Worker::new(at(10), 1, 1 << 30);
        let is_prompt = |w: &Worker, now| w.is_prompt(now, at(3));
        assert!(is_prompt(&w, at(13)) && !is_prompt(&w, at(14)));
        w.last_heard = at(14);
        w.behind.insert(LeaseId(7));
        assert!(!is_prompt(&w, at(14)), "its twin was faster");
        w.behind.clear();
        // Who leaves passes on what it has until it is gone.
        w.draining = true;
        assert!(is_prompt(&w, at(14)));
    }
}

//! The workers that are there.

use super::work::Kind;
use core::ops::Deref;
use core::time::Duration;
use gatherlight_proto::message::{LeaseId, WorkerId};
use gatherlight_proto::types::JobId;
use std::collections::{BTreeMap, BTreeSet};

/// Weight of the latest measurement in a worker's rate.
const RATE_WEIGHT: f64 = 0.5;
/// Shortest computing time believed of a result; keeps rates finite.
const MIN_BUSY_SECONDS: f64 = 1e-4;

/// Highest rate believed in sums, in units per second: far above what [`MIN_BUSY_SECONDS`] lets anybody reach.
const MAX_RATE: f64 = 1e15;
/// One unit per second in sums of rates: a power of two, for a thousandth of a unit a second to be exact enough.
const FIXED_ONE: f64 = (1_u64 << 40) as f64;

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
    /// Leases it had whose twins were faster, and of which it has not been heard since: it gets no others before. With each the time
    /// until which it may be as fast as half of the twin.
    pub behind: BTreeMap<LeaseId, Duration>,
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
            behind: BTreeMap::new(),
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
    /// Whether it keeps up: it was heard within `quiet`, and not outrun by somebody twice as fast. Others may then wait for what it passes on.
    pub fn is_prompt(&self, now: Duration, quiet: Duration) -> bool {
        let is_slow = self.behind.values().any(|&until| now > until);
        !is_slow && now.saturating_sub(self.last_heard) <= quiet
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

/// All workers, by id. What every event asks of all of them is kept up to date, so that nobody looks through a thousand.
#[derive(Clone, Debug, Default)]
pub struct Workers {
    by_id: BTreeMap<WorkerId, Worker>,
    index: Index,
}

/// What is known of all workers together.
#[derive(Clone, Debug, Default)]
struct Index {
    /// Those that may have more leases, by the number that they hold.
    ready: BTreeSet<(usize, WorkerId)>,
    /// Those that take leases, or would if they had room.
    staying: usize,
    /// Of those, what they do of a kind of phase: the sum of their rates, and how many were measured.
    rates: BTreeMap<PhaseKey, (u128, usize)>,
}

/// A rate as a whole number, so that sums have no rounding and come back to 0.
fn fixed(rate: f64) -> u128 {
    (rate.clamp(0.0, MAX_RATE) * FIXED_ONE) as u128
}

impl Index {
    fn add(&mut self, id: WorkerId, w: &Worker) {
        if w.is_ready() {
            self.ready.insert((w.leases.len(), id));
        }
        if !w.draining {
            self.staying += 1;
            for (&phase, &rate) in &w.rates {
                let (sum, count) = self.rates.entry(phase).or_default();
                (*sum, *count) = (*sum + fixed(rate), *count + 1);
            }
        }
    }
    fn remove(&mut self, id: WorkerId, w: &Worker) {
        self.ready.remove(&(w.leases.len(), id));
        if !w.draining {
            self.staying -= 1;
            for (phase, &rate) in &w.rates {
                if let Some((sum, count)) = self.rates.get_mut(phase) {
                    (*sum, *count) = (*sum - fixed(rate), *count - 1);
                }
            }
        }
    }
}

impl Workers {
    /// A worker that joins.
    pub fn insert(&mut self, id: WorkerId, worker: Worker) {
        self.remove(id);
        self.index.add(id, &worker);
        self.by_id.insert(id, worker);
    }
    /// A worker that is gone.
    pub fn remove(&mut self, id: WorkerId) -> Option<Worker> {
        let gone = self.by_id.remove(&id)?;
        self.index.remove(id, &gone);
        Some(gone)
    }
    /// Changes a worker, if it is there; what `change` returns.
    pub fn change<R>(&mut self, id: WorkerId, change: impl FnOnce(&mut Worker) -> R) -> Option<R> {
        let Workers { by_id, index } = self;
        let worker = by_id.get_mut(&id)?;
        index.remove(id, worker);
        let changed = change(worker);
        index.add(id, worker);
        Some(changed)
    }
    /// A worker was heard.
    pub fn heard(&mut self, id: WorkerId, now: Duration) {
        // Nothing that the index knows of.
        if let Some(w) = self.by_id.get_mut(&id) {
            w.last_heard = now;
        }
    }
    /// Drops what is known of an ended job; returns the workers that knew it.
    pub fn forget(&mut self, job: JobId) -> Vec<WorkerId> {
        let all: Vec<WorkerId> = self.by_id.keys().copied().collect();
        let knew = all.into_iter().filter(|&id| self.change(id, |w| w.forget(job)) == Some(true)).collect();
        self.index.rates.retain(|&(j, _), _| j != job);
        knew
    }
    /// Those that may have more leases and hold `held`.
    pub fn ready(&self, held: usize) -> impl Iterator<Item = WorkerId> + '_ {
        self.index.ready.range((held, WorkerId(0))..=(held, WorkerId(u64::MAX))).map(|&(_, id)| id)
    }
    /// Those that are not about to leave.
    pub fn staying(&self) -> usize {
        self.index.staying
    }
    /// Units of a phase per second that one of those does on average, where any was measured.
    pub fn mean_rate(&self, phase: PhaseKey) -> Option<f64> {
        let &(sum, count) = self.index.rates.get(&phase)?;
        (count > 0).then(|| sum as f64 / FIXED_ONE / count as f64)
    }
}

impl Deref for Workers {
    type Target = BTreeMap<WorkerId, Worker>;

    fn deref(&self) -> &Self::Target {
        &self.by_id
    }
}

impl<'a> IntoIterator for &'a Workers {
    type Item = (&'a WorkerId, &'a Worker);
    type IntoIter = std::collections::btree_map::Iter<'a, WorkerId, Worker>;

    fn into_iter(self) -> Self::IntoIter {
        self.by_id.iter()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the index says, found by looking at everybody.
    fn counted(workers: &Workers, phase: PhaseKey) -> (Vec<Vec<WorkerId>>, usize, Option<f64>) {
        let ready =
            |held| workers.iter().filter(move |(_, w)| w.is_ready() && w.leases.len() == held).map(|(&id, _)| id);
        let staying = || workers.values().filter(|w| !w.draining);
        let rates: Vec<f64> = staying().filter_map(|w| w.rate(phase)).collect();
        let mean = (!rates.is_empty()).then(|| rates.iter().sum::<f64>() / rates.len() as f64);
        ((0..3).map(|held| ready(held).collect()).collect(), staying().count(), mean)
    }

    #[test]
    fn the_index_knows_what_looking_at_everybody_would_find() {
        let (mut workers, mut drawn, phase) = (Workers::default(), 1_u64, (JobId(1), Kind::Gather));
        for step in 0..2_000_u64 {
            drawn = drawn.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(0x1405_7b7e_f767_814f);
            let (id, what) = (WorkerId(drawn >> 60), drawn >> 32 & 7);
            let lease = LeaseId(drawn >> 40 & 3);
            match what {
                0 => workers.insert(id, Worker::new(Duration::ZERO, 1, 1)),
                1 => drop(workers.remove(id)),
                2 => drop(workers.change(id, |w| w.draining = step % 2 == 0)),
                3 => drop(workers.change(id, |w| w.leases.insert(lease))),
                4 => drop(workers.change(id, |w| w.leases.pop_last())),
                5 => drop(workers.change(id, |w| w.behind.insert(lease, Duration::ZERO))),
                6 => drop(workers.change(id, |w| w.behind.clear())),
                _ => drop(workers.change(id, |w| w.measured(phase, step, Duration::from_millis(step % 700)))),
            }
            let (ready, staying, mean) = counted(&workers, phase);
            assert_eq!((0..3).map(|held| workers.ready(held).collect::<Vec<_>>()).collect::<Vec<_>>(), ready);
            assert_eq!(workers.staying(), staying);
            let close = |(a, b): (f64, f64)| (a - b).abs() <= 1e-9 * b.max(1.0);
            assert!(workers.mean_rate(phase).zip(mean).map_or(mean.is_none(), close));
        }
        assert!(workers.forget(JobId(1)).is_empty() && workers.mean_rate(phase).is_none());
    }

    #[test]
    fn nobody_waits_for_one_that_is_silent_or_outrun() {
        let at = Duration::from_secs;
        let mut w = Worker::new(at(10), 1, 1 << 30);
        let is_prompt = |w: &Worker, now| w.is_prompt(now, at(3));
        assert!(is_prompt(&w, at(13)) && !is_prompt(&w, at(14)));
        w.last_heard = at(14);
        w.behind.insert(LeaseId(7), at(15));
        assert!(is_prompt(&w, at(15)), "its twin was faster, but not by much");
        assert!(!is_prompt(&w, at(16)), "its twin was twice as fast");
        w.behind.clear();
        // Who leaves passes on what it has until it is gone.
        w.draining = true;
        assert!(is_prompt(&w, at(14)));
    }
}

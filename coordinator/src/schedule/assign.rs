//! Handing out leases.

use super::job::Job;
use super::policy::Situation;
use super::work::{History, Kind, Retry, Work};
use super::{Command, Event, OpenLease, Reason, Scheduler};
use core::time::Duration;
use gatherlight_proto::message::{Lease, LeaseId, WorkerId};
use gatherlight_proto::types::JobId;
use gatherlight_render::photon::EmissionRange;

/// SplitMix64's output function: a seed and a counter to 64 well-mixed bits (Steele, Lea and Flood 2014).
fn mix(seed: u64, counter: u64) -> u64 {
    let mut z = seed.wrapping_add(counter.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Who is there for certain, at the time of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Heard {
    /// The event is of no worker.
    Nobody,
    /// This one said something.
    One(WorkerId),
    /// Time passed: everybody is looked at.
    All,
}

impl Heard {
    pub(super) fn at(event: &Event) -> Self {
        match *event {
            Event::Joined { worker, .. }
            | Event::Heard { worker }
            | Event::Completed { worker, .. }
            | Event::Repeated { worker, .. }
            | Event::TaskFailed { worker, .. }
            | Event::Returned { worker, .. } => Heard::One(worker),
            Event::Tick => Heard::All,
            _ => Heard::Nobody,
        }
    }
}

impl Scheduler {
    /// Gives every worker with room its next leases: first one each, then the second ones. Of those who would have none, the ones
    /// that were `heard` repeat old ones.
    pub(super) fn assign_all(&mut self, now: Duration, heard: Heard, out: &mut Vec<Command>) {
        let has_work = self.jobs.values().any(|j| j.open_phases().next().is_some());
        if !has_work && self.leases.is_empty() {
            return;
        }
        if has_work {
            for held in 0..self.policy.leases_per_worker {
                let ready: Vec<WorkerId> = self.workers.ready(held).collect();
                for worker in ready {
                    self.assign(worker, out);
                }
            }
        }
        let idle: Vec<WorkerId> = match heard {
            Heard::Nobody => return,
            Heard::One(id) => {
                self.workers.get(&id).filter(|w| w.is_ready() && w.leases.is_empty()).map(|_| id).into_iter().collect()
            }
            Heard::All => self.workers.ready(0).collect(),
        };
        if idle.is_empty() {
            return;
        }
        let mut candidates = self.twin_candidates(now);
        for worker in idle {
            self.assign_twin(now, worker, &mut candidates, out);
        }
    }

    /// Gives `worker` one lease, of the first job in turn that has one for it.
    fn assign(&mut self, worker: WorkerId, out: &mut Vec<Command>) -> bool {
        for place in 0..self.turn.len() {
            let Some(&job) = self.turn.get(place) else { return false };
            let Some((phase, Retry { range, history, .. })) = self.next_task(job, worker) else { continue };
            self.turn.remove(place);
            self.queue(job);
            self.prepare(worker, job, out);
            let reason = if history.attempts == 0 { Reason::Fresh } else { Reason::Retry };
            self.open(worker, (job, phase), range, (reason, history), out);
            return true;
        }
        false
    }

    /// Puts a job behind all others of its priority: among those, each gets one lease in turn.
    pub(super) fn queue(&mut self, job: JobId) {
        let priority = |job: &JobId| self.jobs.get(job).map_or(0, |j| j.priority);
        let before = self.turn.iter().take_while(|other| priority(other) >= priority(&job)).count();
        self.turn.insert(before, job);
    }

    /// Announces `job` to `worker`, if that is new to it.
    pub(super) fn prepare(&mut self, worker: WorkerId, job: JobId, out: &mut Vec<Command>) {
        if self.workers.change(worker, |w| w.prepared.insert(job)) == Some(true) {
            self.jobs.entry(job).and_modify(|j| j.workers += 1);
            out.push(Command::Prepare { worker, job });
        }
    }

    /// Whether `worker` may have leases of `job`: it has the memory, and has not failed too often.
    pub(super) fn may_work(&self, worker: WorkerId, job: &Job) -> bool {
        let Some(w) = self.workers.get(&worker) else { return false };
        w.memory_bytes >= job.worker_bytes && !w.is_set_aside(job.id, self.policy.set_aside_after)
    }

    /// The next indices of `job` for `worker`: phase and task.
    fn next_task(&mut self, job: JobId, worker: WorkerId) -> Option<(usize, Retry)> {
        if !self.may_work(worker, self.jobs.get(&job)?) {
            return None;
        }
        let phases: Vec<usize> = self.jobs.get(&job)?.open_phases().collect();
        for phase in phases {
            let work = self.jobs.get(&job)?.work(phase)?;
            if let Some(i) = work.retries.iter().position(|r| self.may_retry(job, worker, r)) {
                let retry = self.jobs.get_mut(&job)?.work_mut(phase)?.retries.swap_remove(i);
                return Some((phase, retry));
            }
            if !work.fresh.is_empty() {
                let units = self.policy.lease_units(work.phase, self.situation(job, worker, work)?);
                let from = self.policy.shuffle.map_or(0, |seed| mix(seed, self.last_lease) % work.phase.units());
                let range = self.jobs.get_mut(&job)?.work_mut(phase)?.fresh.take_from(from, units)?;
                return Some((phase, Retry { range, history: Default::default(), since: self.now }));
            }
        }
        None
    }

    /// A task goes back to a worker that failed it only when nobody else has turned up for a while.
    fn may_retry(&self, job: JobId, worker: WorkerId, retry: &Retry) -> bool {
        let failed_by = |id: WorkerId| retry.history.failures.iter().any(|&(w, _)| w == id);
        let limit = self.policy.set_aside_after;
        let could =
            |(&id, w): (&WorkerId, &super::Worker)| !w.draining && !w.is_set_aside(job, limit) && !failed_by(id);
        let waited = self.now.saturating_sub(retry.since) >= self.policy.patience;
        !failed_by(worker) || (waited && !self.workers.iter().any(could))
    }

    fn situation(&self, job: JobId, worker: WorkerId, work: &Work) -> Option<Situation> {
        let w = self.workers.get(&worker)?;
        let key = (job, Kind::of(work.phase));
        let rate = w.rate(key);
        let staying = self.workers.staying() as f64;
        let share = match rate.zip(self.workers.mean_rate(key)) {
            // Workers not measured yet count as average ones.
            Some((own, mean)) => own / (mean * staying),
            None => 1.0 / staying,
        };
        let remaining = work.fresh.units();
        let stored_per_unit = self.jobs.get(&job)?.stored_per_unit(key.1);
        Some(Situation { threads: w.threads, rate, share: share.clamp(1e-6, 1.0), remaining, stored_per_unit })
    }

    /// Opens a lease of indices of a phase and sends it.
    pub(super) fn open(
        &mut self,
        worker: WorkerId,
        (job, phase): (JobId, usize),
        range: EmissionRange,
        (reason, mut history): (Reason, History),
        out: &mut Vec<Command>,
    ) -> Option<LeaseId> {
        let now = self.now;
        history.attempts += 1;
        self.last_lease += 1;
        let id = LeaseId(self.last_lease);
        let (task, phase_of) = self.jobs.get(&job).and_then(|j| Some((j.task(phase)?, j.work(phase)?.phase)))?;
        let lease = Lease { id, attempt: history.attempts, job, range, task };
        self.workers.change(worker, |w| w.leases.insert(id))?;
        let w = self.workers.get(&worker)?;
        // The lease may wait behind the others the worker holds.
        let rate = w.rate((job, Kind::of(phase_of)));
        let time = self.policy.lease_time(phase_of, range.len(), rate, history.attempts);
        let broadcast =
            if rate.is_none() { self.policy.broadcast_time(lease.task.input_bytes()) } else { Duration::ZERO };
        let deadline = now + time * w.leases.len() as u32 + broadcast;
        out.push(Command::Assign { worker, lease: lease.clone() });
        self.jobs.entry(job).and_modify(|j| j.handed_out(reason));
        self.leases.insert(id, OpenLease { lease, reason, phase, worker, opened: now, twin: None, deadline, history });
        Some(id)
    }
}

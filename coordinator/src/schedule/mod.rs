//! Who does what: a pure state machine. Events come in with the time they happened; commands go out, to be carried out
//! by the driver. No clock, no tasks, no channels, no payload: only ids, counts and digests. What an event costs does not
//! depend on the number of rounds.
//!
//! Every index of every phase is, at any time, in exactly one place: fresh, waiting for a retry, in one open lease or two that are
//! twins, or done. So an index counts once, whatever arrives twice, late or not at all.

mod assign;
pub mod event;
pub mod job;
pub mod policy;
pub mod pool;
pub mod saved;
#[cfg(test)]
mod tests;
pub mod twins;
pub mod work;
pub mod workers;

pub use event::{Command, Discarded, Event, Outcome};
pub use job::Terms;
pub use policy::Policy;
pub use saved::Saved;

use assign::Heard;
use core::time::Duration;
use gatherlight_proto::Digest;
use gatherlight_proto::message::{Lease, LeaseId, WorkerId};
use gatherlight_proto::types::JobId;
use gatherlight_render::job::Phase;
use gatherlight_render::photon::EmissionRange;
use job::{Job, Next};
use std::collections::{BTreeMap, VecDeque};
use twins::Settled;
use work::{History, Kind, Retry};
use workers::{Worker, Workers};

/// Why a lease was handed out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// Its indices were never out before.
    Fresh,
    /// Whoever had them was lost or late, failed, or gave them back.
    Retry,
    /// Somebody has them, and takes long.
    Repeat,
}

/// A lease that is out.
#[derive(Clone, Debug)]
pub struct OpenLease {
    /// As the worker got it.
    pub lease: Lease,
    /// Why.
    pub reason: Reason,
    /// Index of its phase within the job.
    pub phase: usize,
    /// Who has it.
    pub worker: WorkerId,
    /// When it was handed out.
    pub opened: Duration,
    /// Another one of the same indices.
    pub twin: Option<LeaseId>,
    /// When it is given up.
    pub deadline: Duration,
    /// The past of its indices, this attempt included.
    pub history: History,
}

/// What a worker says of a result.
#[derive(Clone, Copy)]
struct Completed {
    range: EmissionRange,
    busy: Duration,
    stored: u64,
    digest: Digest,
}

/// The scheduler's whole state.
#[derive(Debug, Default)]
pub struct Scheduler {
    policy: Policy,
    jobs: BTreeMap<JobId, Job>,
    /// Jobs in the order in which they get the next lease, those of the highest priority first.
    turn: VecDeque<JobId>,
    workers: Workers,
    leases: BTreeMap<LeaseId, OpenLease>,
    settled: BTreeMap<LeaseId, Settled>,
    last_lease: u64,
    now: Duration,
}

impl Scheduler {
    /// No jobs, no workers.
    pub fn new(policy: Policy) -> Self {
        Scheduler { policy, ..Scheduler::default() }
    }
    /// Takes in what happened at time `now` (from any origin, never going back); returns what to do about it.
    pub fn handle(&mut self, now: Duration, event: Event) -> Vec<Command> {
        self.now = now;
        let (heard, mut out) = (Heard::at(&event), Vec::new());
        match event {
            Event::Submitted { job, phases, terms } => self.submitted(job, phases, *terms, &mut out),
            Event::Cancelled { job } => self.end(job, Outcome::Cancelled, &mut out),
            Event::Joined { worker, threads, memory_bytes } => {
                self.workers.insert(worker, Worker::new(now, threads, memory_bytes));
            }
            Event::Heard { worker } => self.heard(now, worker),
            Event::Lost { worker } => self.lost(worker, &mut out),
            Event::Draining { worker } => self.draining(now, worker),
            Event::Completed { worker, lease, attempt, range, busy, stored, digest } => {
                self.heard(now, worker);
                self.compare((worker, lease, attempt), digest, &mut out);
                let result = Completed { range, busy, stored, digest };
                self.completed((worker, lease, attempt), result, &mut out);
            }
            Event::Repeated { worker, lease, attempt, digest } => {
                self.heard(now, worker);
                self.compare((worker, lease, attempt), digest, &mut out);
            }
            Event::TaskFailed { worker, lease, attempt, error } => {
                self.heard(now, worker);
                drop(self.answered(worker, lease, attempt));
                self.failed((worker, lease, attempt), error, &mut out);
            }
            Event::Returned { worker, lease, attempt } => {
                self.heard(now, worker);
                drop(self.answered(worker, lease, attempt));
                if self.is_open(worker, lease, attempt) {
                    self.take_back(lease, |_| {}, &mut out);
                }
            }
            Event::Built { job, round, input } => {
                if self.jobs.get_mut(&job).is_some_and(|j| j.built(round, input)) {
                    self.advance(job, &mut out);
                }
            }
            Event::Closed { job, round, is_good_enough } => {
                if self.jobs.get_mut(&job).is_some_and(|j| j.closed(round, is_good_enough)) {
                    self.advance(job, &mut out);
                }
            }
            Event::Assembled { job } => self.end(job, Outcome::Done, &mut out),
            Event::StepFailed { job, error } => self.end(job, Outcome::Failed(error), &mut out),
            Event::Tick => self.tick(now, &mut out),
        }
        self.assign_all(now, heard, &mut out);
        out
    }
    /// A job that has not ended.
    pub fn job(&self, job: JobId) -> Option<&Job> {
        self.jobs.get(&job)
    }
    /// Why no worker works on `job`, as a sentence; empty where there is no reason.
    pub fn waits_for(&self, job: &Job) -> String {
        let limit = self.policy.set_aside_after;
        let largest = self.workers.values().map(|w| w.memory_bytes).max();
        match largest {
            None => "no worker has joined".to_owned(),
            Some(largest) if largest < job.worker_bytes => format!(
                "it needs workers with {} MiB of memory, and the largest that is there has {} MiB: start one with a larger --memory",
                job.worker_bytes.div_ceil(1 << 20),
                largest >> 20,
            ),
            Some(_) if self.workers.values().all(|w| w.is_set_aside(job.id, limit)) => {
                format!("every worker failed {limit} of its tasks and was set aside")
            }
            Some(_) => String::new(),
        }
    }
    /// The workers.
    pub fn workers(&self) -> &Workers {
        &self.workers
    }
    /// The policy.
    pub fn policy(&self) -> &Policy {
        &self.policy
    }
    /// Open leases.
    pub fn leases(&self) -> impl Iterator<Item = &OpenLease> {
        self.leases.values()
    }
    /// Whether this worker holds this lease in this attempt.
    pub fn is_open(&self, worker: WorkerId, lease: LeaseId, attempt: u32) -> bool {
        self.leases.get(&lease).is_some_and(|l| l.worker == worker && l.lease.attempt == attempt)
    }
    /// The open lease of that name.
    pub fn lease(&self, lease: LeaseId) -> Option<&OpenLease> {
        self.leases.get(&lease)
    }

    fn submitted(&mut self, id: JobId, phases: Vec<Phase>, terms: Terms, out: &mut Vec<Command>) {
        let Some(job) = Job::new(id, phases, terms, self.now) else {
            let error = "the job's phases are not rounds of emissions and a gather, or of a splat".to_owned();
            out.push(Command::Finish { job: id, outcome: Outcome::Failed(error) });
            return;
        };
        self.jobs.insert(id, job);
        self.queue(id);
        self.advance(id, out);
    }

    fn heard(&mut self, now: Duration, worker: WorkerId) {
        self.workers.heard(worker, now);
    }

    fn draining(&mut self, now: Duration, worker: WorkerId) {
        self.heard(now, worker);
        self.workers.change(worker, |w| w.draining = true);
    }

    fn completed(
        &mut self,
        (worker, lease, attempt): (WorkerId, LeaseId, u32),
        Completed { range, busy, stored, digest }: Completed,
        out: &mut Vec<Command>,
    ) {
        if !self.is_open(worker, lease, attempt) {
            return out.push(Command::Discard { lease, reason: Discarded::Stale });
        }
        let leased = self.leases.get(&lease).map(|l| l.lease.range);
        if leased != Some(range) {
            out.push(Command::Discard { lease, reason: Discarded::WrongRange });
            let error = format!("returned {range:?} for a lease of {leased:?}");
            return self.failed((worker, lease, attempt), error, out);
        }
        let Some(open) = self.leases.remove(&lease) else { return };
        self.workers.change(worker, |w| {
            w.leases.remove(&lease);
            w.completed += 1;
        });
        self.settle(&open, digest, out);
        let Some(job) = self.jobs.get_mut(&open.lease.job) else { return };
        let kind = job.work(open.phase).map(|w| Kind::of(w.phase));
        if let Some(kind) = kind {
            self.workers.change(worker, |w| w.measured((open.lease.job, kind), range.len(), busy));
        }
        job.completed(open.phase, range, stored);
        out.push(Command::Accept { job: open.lease.job, lease });
        self.advance(open.lease.job, out);
    }

    /// Takes a job's due steps.
    fn advance(&mut self, id: JobId, out: &mut Vec<Command>) {
        while let Some(job) = self.jobs.get_mut(&id) {
            match job.advance(self.now) {
                Next::Nothing => return,
                Next::Build(phase) => out.push(Command::Build { job: id, phase }),
                Next::Retire(round) => out.push(Command::Retire { job: id, round }),
                Next::Assemble(done) => {
                    // What is out belongs to a round that a limit has cut off.
                    self.revoke(id, out);
                    out.push(Command::Assemble { job: id, done });
                }
            }
        }
    }

    /// A task failed on its worker: it is tried elsewhere, until that is hopeless.
    fn failed(&mut self, key: (WorkerId, LeaseId, u32), error: String, out: &mut Vec<Command>) {
        let (worker, lease, attempt) = key;
        if !self.is_open(worker, lease, attempt) {
            return;
        }
        let Some(open) = self.leases.get(&lease) else { return };
        let (job, phase, first) = (open.lease.job, open.phase, open.lease.range.first);
        self.workers.change(worker, |w| w.failed(job, phase, first));
        self.take_back(lease, |history| history.failures.push((worker, error)), out);
    }

    /// Fails the jobs that only have workers which were set aside, and had no other for a while.
    fn fail_stuck(&mut self, out: &mut Vec<Command>) {
        let (limit, patience, now) = (self.policy.set_aside_after, self.policy.patience, self.now);
        let mut hopeless = Vec::new();
        for (&id, job) in &mut self.jobs {
            let stuck = !self.workers.is_empty() && self.workers.values().all(|w| w.is_set_aside(id, limit));
            job.stuck_since = stuck.then(|| job.stuck_since.unwrap_or(now));
            hopeless.extend(job.stuck_since.filter(|&since| now.saturating_sub(since) >= patience).map(|_| id));
        }
        for job in hopeless {
            let text = format!("every worker failed {limit} tasks; {}", self.errors_of(job));
            self.end(job, Outcome::Failed(text), out);
        }
    }

    /// The latest errors of a job's waiting tasks.
    fn errors_of(&self, job: JobId) -> String {
        let Some(job) = self.jobs.get(&job) else { return String::new() };
        let last = job.steps().flat_map(|s| &s.work.retries).filter_map(|r| r.history.failures.last());
        last.take(3).map(|(w, e)| format!("worker {}: {e}", w.0)).collect::<Vec<_>>().join("; ")
    }

    /// A worker is gone: its leases are done by others.
    fn lost(&mut self, worker: WorkerId, out: &mut Vec<Command>) {
        let Some(gone) = self.workers.remove(worker) else { return };
        self.settled.retain(|_, s| s.open.worker != worker);
        for job in &gone.prepared {
            self.jobs.entry(*job).and_modify(|j| j.workers_lost += 1);
        }
        for lease in gone.leases {
            self.take_back(lease, |history| history.losses += 1, out);
        }
    }

    /// Puts an open lease's indices up for a retry, or fails their job when that is hopeless.
    fn take_back(&mut self, lease: LeaseId, note: impl FnOnce(&mut History), out: &mut Vec<Command>) {
        let Some(mut open) = self.leases.remove(&lease) else { return };
        self.workers.change(open.worker, |w| w.leases.remove(&lease));
        note(&mut open.history);
        if let Some(twin) = open.twin.and_then(|twin| self.leases.get_mut(&twin)) {
            // The other one is still out; what is known against these indices goes with it.
            twin.twin = None;
            twin.history.losses = twin.history.losses.max(open.history.losses);
            twin.history.failures.extend(open.history.failures);
            return;
        }
        let (id, range, history) = (open.lease.job, open.lease.range, open.history);
        let hopeless = self.hopeless(open.phase, range, &history);
        let Some(job) = self.jobs.get_mut(&id) else { return };
        job.take_back(open.phase, Retry { range, history, since: self.now });
        if let Some(error) = hopeless {
            self.end(id, Outcome::Failed(error), out);
        }
    }

    fn hopeless(&self, phase: usize, range: EmissionRange, history: &History) -> Option<String> {
        let task = format!("task [{}, {}) of phase {}", range.first, range.end, phase + 1);
        if history.failures.len() >= self.policy.max_failures {
            let errors: Vec<_> = history.failures.iter().map(|(w, e)| format!("worker {}: {e}", w.0)).collect();
            return Some(format!("{task} failed {} times: {}", errors.len(), errors.join("; ")));
        }
        (history.losses >= self.policy.max_losses)
            .then(|| format!("{task} was lost {} times with its worker: it may be what stops them", history.losses))
    }

    /// A job comes to its end; nothing of it stays here.
    fn end(&mut self, job: JobId, outcome: Outcome, out: &mut Vec<Command>) {
        if self.jobs.remove(&job).is_none() {
            return;
        }
        self.turn.retain(|&j| j != job);
        self.revoke(job, out);
        // Workers drop what waits there of a job that has ended, and say nothing.
        for (lease, s) in self.settled.iter().filter(|(_, s)| s.open.lease.job == job) {
            self.workers.change(s.open.worker, |w| w.behind.remove(lease));
        }
        out.extend(self.workers.forget(job).into_iter().map(|worker| Command::Forget { worker, job }));
        out.push(Command::Finish { job, outcome });
    }

    /// Takes back a job's open leases, which are not wanted any more.
    fn revoke(&mut self, job: JobId, out: &mut Vec<Command>) {
        let open: Vec<LeaseId> = self.leases.values().filter(|l| l.lease.job == job).map(|l| l.lease.id).collect();
        for lease in open {
            let Some(gone) = self.leases.remove(&lease) else { continue };
            self.workers.change(gone.worker, |w| w.leases.remove(&lease));
            out.push(Command::Revoke { worker: gone.worker, lease });
        }
    }

    /// Silent workers are dead, late leases are given up, and time limits are reached.
    fn tick(&mut self, now: Duration, out: &mut Vec<Command>) {
        let dead_after = self.policy.dead_after;
        let silent = |w: &Worker| now.saturating_sub(w.last_heard) > dead_after;
        let dead: Vec<WorkerId> = self.workers.iter().filter(|(_, w)| silent(w)).map(|(&id, _)| id).collect();
        for worker in dead {
            let reason = format!("no heartbeat for {} s", dead_after.as_secs());
            out.push(Command::Dismiss { worker, reason });
            self.lost(worker, out);
        }
        let late: Vec<(LeaseId, WorkerId)> =
            self.leases.values().filter(|l| now > l.deadline).map(|l| (l.lease.id, l.worker)).collect();
        for (lease, worker) in late {
            out.push(Command::Revoke { worker, lease });
            self.take_back(lease, |history| history.losses += 1, out);
        }
        self.forget_settled(now);
        self.fail_stuck(out);
        let jobs: Vec<JobId> = self.jobs.keys().copied().collect();
        jobs.into_iter().for_each(|job| self.advance(job, out));
    }
}

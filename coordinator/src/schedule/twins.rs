//! The tail of a phase, run twice: a worker that would be idle repeats the oldest leases, and the first result counts. A second
//! one that differs reveals a worker whose hardware cannot be trusted.

use super::work::{History, Kind};
use super::{Command, OpenLease, Reason, Scheduler};
use core::time::Duration;
use gatherlight_proto::Digest;
use gatherlight_proto::message::{LeaseId, WorkerId};

/// Leases that one worker is considered for at a time: with as many idle workers as slow ones, all pairs would be too many.
const MAX_TRIED: usize = 16;

/// A lease whose twin was faster; its result may still come, until its deadline.
#[derive(Clone, Debug)]
pub struct Settled {
    /// As it was.
    pub open: OpenLease,
    /// Whose result counts.
    pub winner: WorkerId,
    /// Digest of that result.
    digest: Digest,
}

impl Scheduler {
    /// The lease of that name and attempt that this worker had and whose twin was faster.
    pub fn settled(&self, worker: WorkerId, lease: LeaseId, attempt: u32) -> Option<&Settled> {
        self.settled.get(&lease).filter(|s| s.open.worker == worker && s.open.lease.attempt == attempt)
    }

    /// The leases that are worth repeating, the oldest last.
    pub(super) fn twin_candidates(&self, now: Duration) -> Vec<LeaseId> {
        // Leases are numbered as they are opened.
        let is_old = |l: &&OpenLease| now.saturating_sub(l.opened) >= self.policy.twin_after;
        let old = self.leases.values().take_while(is_old).filter(|l| l.twin.is_none()).map(|l| l.lease.id);
        let mut old: Vec<LeaseId> = old.collect();
        old.reverse();
        old
    }

    /// Gives `worker`, which has nothing to do, the oldest of the last [`MAX_TRIED`] `candidates` that it would have done by now.
    pub(super) fn assign_twin(
        &mut self,
        now: Duration,
        worker: WorkerId,
        candidates: &mut Vec<LeaseId>,
        out: &mut Vec<Command>,
    ) {
        let from = candidates.len().saturating_sub(MAX_TRIED);
        let oldest = candidates.get(from..).unwrap_or_default();
        let Some(place) = oldest.iter().rposition(|&id| self.may_repeat(now, worker, id)) else { return };
        let first = candidates.remove(from + place);
        let Some(open) = self.leases.get(&first) else { return };
        let (job, phase, range, attempts) = (open.lease.job, open.phase, open.lease.range, open.history.attempts);
        self.prepare(worker, job, out);
        let history = History { attempts, ..History::default() };
        let Some(second) = self.open(worker, (job, phase), range, (Reason::Repeat, history), out) else { return };
        for (one, other) in [(first, second), (second, first)] {
            self.leases.entry(one).and_modify(|l| l.twin = Some(other));
        }
    }

    fn may_repeat(&self, now: Duration, worker: WorkerId, id: LeaseId) -> bool {
        let Some((open, w)) = self.leases.get(&id).zip(self.workers.get(&worker)) else { return false };
        let Some(job) = self.jobs.get(&open.lease.job) else { return false };
        let Some(work) = job.work(open.phase) else { return false };
        let rate = w.rate((job.id, Kind::of(work.phase)));
        let expected = rate.map_or(0.0, |r| open.lease.range.len() as f64 / r);
        let failed = open.history.failures.iter().any(|&(by, _)| by == worker);
        open.worker != worker
            && !failed
            && self.may_work(worker, job)
            && now.saturating_sub(open.opened).as_secs_f64() >= expected
    }

    /// Whoever has not answered by the deadline never will.
    pub(super) fn forget_settled(&mut self, now: Duration) {
        for (lease, s) in self.settled.extract_if(.., |_, s| now > s.open.deadline) {
            self.workers.change(s.open.worker, |w| w.behind.remove(&lease));
        }
    }

    /// The result of one of two twins counts: the other is not wanted any more.
    pub(super) fn settle(&mut self, won: &OpenLease, digest: Digest, out: &mut Vec<Command>) {
        let Some(open) = won.twin.and_then(|twin| self.leases.remove(&twin)) else { return };
        let (worker, lease, now) = (open.worker, open.lease.id, self.now);
        self.workers.change(worker, |w| {
            w.leases.remove(&lease);
            w.behind.insert(lease, now + now.saturating_sub(won.opened));
        });
        out.push(Command::Revoke { worker, lease });
        self.settled.insert(lease, Settled { open, winner: won.worker, digest });
    }

    /// The slower worker has said what became of its lease; what was known of it.
    pub(super) fn answered(&mut self, worker: WorkerId, lease: LeaseId, attempt: u32) -> Option<Settled> {
        self.settled(worker, lease, attempt)?;
        self.workers.change(worker, |w| w.behind.remove(&lease));
        self.settled.remove(&lease)
    }

    /// The slower twin's result came too: it has to be the same.
    pub(super) fn compare(
        &mut self,
        (worker, lease, attempt): (WorkerId, LeaseId, u32),
        digest: Digest,
        out: &mut Vec<Command>,
    ) {
        let Some(settled) = self.answered(worker, lease, attempt) else { return };
        if settled.digest != digest {
            let Settled { open, winner, .. } = settled;
            let (job, range) = (open.lease.job, open.lease.range);
            self.jobs.entry(job).and_modify(|j| j.disputes += 1);
            out.push(Command::Dispute { job, phase: open.phase, range, workers: [winner, worker] });
        }
    }
}

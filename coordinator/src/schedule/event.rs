//! What can happen, and what is to be done about it.

use super::job::{Done, Terms};
use core::time::Duration;
use gatherlight_proto::Digest;
use gatherlight_proto::message::{InputRef, Lease, LeaseId, WorkerId};
use gatherlight_proto::types::JobId;
use gatherlight_render::job::Phase;
use gatherlight_render::photon::EmissionRange;

/// Something happened.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A client submitted a job; its scene is there and prepared.
    Submitted {
        /// Its new id.
        job: JobId,
        /// Its phases, in order.
        phases: Vec<Phase>,
        /// What else it brings.
        terms: Box<Terms>,
    },
    /// A client wants it no more.
    Cancelled {
        /// The job.
        job: JobId,
    },
    /// A worker opened a session.
    Joined {
        /// Its new id.
        worker: WorkerId,
        /// Its compute threads.
        threads: u32,
        /// Memory it may use, bytes.
        memory_bytes: u64,
    },
    /// A worker's heartbeat, or any other message of it.
    Heard {
        /// The worker.
        worker: WorkerId,
    },
    /// A worker's session ended.
    Lost {
        /// The worker.
        worker: WorkerId,
    },
    /// A worker wants no more leases.
    Draining {
        /// The worker.
        worker: WorkerId,
    },
    /// A result arrived whole and valid.
    Completed {
        /// Who sent it.
        worker: WorkerId,
        /// For which lease.
        lease: LeaseId,
        /// And attempt.
        attempt: u32,
        /// The indices it covers.
        range: EmissionRange,
        /// Time the worker computed.
        busy: Duration,
        /// Photons in it.
        stored: u64,
        /// Digest of the result.
        digest: Digest,
    },
    /// The result of a lease whose twin was faster arrived, as far as its digest.
    Repeated {
        /// Who had it.
        worker: WorkerId,
        /// The lease.
        lease: LeaseId,
        /// Its attempt.
        attempt: u32,
        /// Digest of the result.
        digest: Digest,
    },
    /// A worker could not do a lease, or its result was invalid.
    TaskFailed {
        /// The worker.
        worker: WorkerId,
        /// The lease.
        lease: LeaseId,
        /// Its attempt.
        attempt: u32,
        /// Why.
        error: String,
    },
    /// A worker gave a lease back undone.
    Returned {
        /// The worker.
        worker: WorkerId,
        /// The lease.
        lease: LeaseId,
        /// Its attempt.
        attempt: u32,
    },
    /// [`Command::Build`] is done.
    Built {
        /// The job.
        job: JobId,
        /// The phase's round.
        round: u32,
        /// What was made, and where workers find it.
        input: InputRef,
    },
    /// [`Command::Build`] is done for a gather.
    Closed {
        /// The job.
        job: JobId,
        /// The round.
        round: u32,
        /// Whether the image is as good as was asked for: no further round is wanted.
        is_good_enough: bool,
    },
    /// [`Command::Assemble`] is done.
    Assembled {
        /// The job.
        job: JobId,
    },
    /// The coordinator's own part of a job failed.
    StepFailed {
        /// The job.
        job: JobId,
        /// Why.
        error: String,
    },
    /// Time passed.
    Tick,
}

/// Why a result does not count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Discarded {
    /// The lease is not, or no longer, this worker's.
    Stale,
    /// It covers other indices than the lease.
    WrongRange,
}

/// How a job ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The image is there.
    Done,
    /// It failed, for this reason.
    Failed(String),
    /// A client cancelled it.
    Cancelled,
}

/// Something to do. Commands are to be carried out in order.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
    /// Tell a worker about a job, before its first lease of it.
    Prepare {
        /// The worker.
        worker: WorkerId,
        /// The job.
        job: JobId,
    },
    /// Give a worker a lease.
    Assign {
        /// The worker.
        worker: WorkerId,
        /// The lease.
        lease: Lease,
    },
    /// Tell a worker that a lease is not wanted any more.
    Revoke {
        /// The worker.
        worker: WorkerId,
        /// The lease.
        lease: LeaseId,
    },
    /// Tell a worker that a job has ended.
    Forget {
        /// The worker.
        worker: WorkerId,
        /// The job.
        job: JobId,
    },
    /// The result that just completed counts: put it to use.
    Accept {
        /// The job.
        job: JobId,
        /// The lease.
        lease: LeaseId,
    },
    /// Two workers gave different results for the same indices: one of them cannot be trusted.
    Dispute {
        /// The job.
        job: JobId,
        /// Index of the phase within the job.
        phase: usize,
        /// The indices.
        range: EmissionRange,
        /// Whose result counts, and whose differs.
        workers: [WorkerId; 2],
    },
    /// The result that just completed does not count.
    Discard {
        /// The lease it claims.
        lease: LeaseId,
        /// Why.
        reason: Discarded,
    },
    /// All results of a phase are there. Of an emission or bootstrap: join them, and make of them what workers read; make the sample map;
    /// of a gather: close its round.
    Build {
        /// The job.
        job: JobId,
        /// The phase.
        phase: Phase,
    },
    /// All tiles of a round are there, and another round follows: nobody reads the round's maps any more.
    Retire {
        /// The job.
        job: JobId,
        /// The round.
        round: u32,
    },
    /// Everything is there: put the image together.
    Assemble {
        /// The job.
        job: JobId,
        /// What it is made of.
        done: Done,
    },
    /// The job has ended.
    Finish {
        /// The job.
        job: JobId,
        /// How.
        outcome: Outcome,
    },
    /// End a worker's session.
    Dismiss {
        /// The worker.
        worker: WorkerId,
        /// Why.
        reason: String,
    },
}

//! What a worker does, as a pure state machine: inputs in, actions out; no clock, no network, no threads.
//!
//! ```text
//!  Joining ──welcome──► Ready ──drain──► Draining ──nothing left──► Left
//! ```
//! One lease is computed at a time (its indices run in parallel); results travel while the next one is computed.

use gatherlight_proto::message::{FromWorker, Lease, LeaseId, Route, SceneManifest, SessionKey, ToWorker};
use gatherlight_proto::types::JobId;
use gatherlight_render::settings::RenderSettings;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// Leases a coordinator may have here at once; more are given back.
pub const MAX_LEASES: usize = 64;
/// Jobs a coordinator may announce here at once.
pub const MAX_JOBS: usize = 1_024;

/// Where the session stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// Not welcomed yet.
    Joining,
    /// Takes leases.
    Ready,
    /// Takes no more, finishes what it computes.
    Draining,
    /// Done.
    Left,
}

/// A job as it was announced.
#[derive(Clone, Debug, PartialEq)]
pub struct Announced {
    /// Its scene's files.
    pub scene: SceneManifest,
    /// Its settings.
    pub settings: RenderSettings,
}

/// Something happened.
#[derive(Clone, Debug, PartialEq)]
pub enum Input {
    /// The coordinator spoke.
    Message(ToWorker),
    /// The lease that was begun is computed, and its result is on its way.
    Computed(LeaseId),
    /// The lease that was begun could not be computed.
    ComputeFailed(LeaseId, String),
    /// A result arrived.
    Delivered(LeaseId),
    /// A result could not be handed in.
    DeliveryFailed(LeaseId, String),
    /// Somebody asked the worker to stop.
    Drain,
}

/// Something to do.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Begin heartbeats; `session` names this session in other calls.
    Welcomed {
        /// The session's secret name.
        session: SessionKey,
        /// Time between heartbeats.
        heartbeat: Duration,
    },
    /// Compute this lease of that job.
    Begin(Lease, Box<Announced>),
    /// Tell the coordinator.
    Send(FromWorker),
    /// Drop what is held for a job.
    Forget(JobId),
    /// Begin to get this payload, and to pass it on.
    Announce(Route),
    /// Close the session.
    Close,
}

/// The state machine.
#[derive(Debug)]
pub struct Session {
    state: State,
    jobs: BTreeMap<JobId, Announced>,
    waiting: VecDeque<Lease>,
    computing: Option<Lease>,
    /// Attempt numbers of leases whose results travel.
    delivering: BTreeMap<LeaseId, u32>,
}

impl Default for Session {
    fn default() -> Self {
        Session {
            state: State::Joining,
            jobs: BTreeMap::new(),
            waiting: VecDeque::new(),
            computing: None,
            delivering: BTreeMap::new(),
        }
    }
}

impl Session {
    /// Where it stands.
    pub fn state(&self) -> State {
        self.state
    }
    /// Takes in what happened; returns what to do, in order.
    pub fn handle(&mut self, input: Input) -> Vec<Action> {
        let mut out = Vec::new();
        if self.state == State::Left {
            return out;
        }
        match input {
            Input::Message(message) => self.message(message, &mut out),
            Input::Computed(lease) => {
                if let Some(done) = self.computing.take_if(|l| l.id == lease) {
                    self.delivering.insert(lease, done.attempt);
                }
            }
            Input::ComputeFailed(lease, error) => {
                if let Some(Lease { attempt, .. }) = self.computing.take_if(|l| l.id == lease) {
                    out.push(Action::Send(FromWorker::TaskFailed { lease, attempt, error }));
                }
            }
            Input::Delivered(lease) => drop(self.delivering.remove(&lease)),
            Input::DeliveryFailed(lease, error) => {
                if let Some(attempt) = self.delivering.remove(&lease) {
                    out.push(Action::Send(FromWorker::TaskFailed { lease, attempt, error }));
                }
            }
            Input::Drain => self.drain(&mut out),
        }
        self.begin_next(&mut out);
        if self.state == State::Draining && self.computing.is_none() && self.delivering.is_empty() {
            self.state = State::Left;
            out.push(Action::Close);
        }
        out
    }

    fn message(&mut self, message: ToWorker, out: &mut Vec<Action>) {
        match message {
            ToWorker::Welcome { session, heartbeat, .. } => {
                if self.state == State::Joining {
                    self.state = State::Ready;
                    out.push(Action::Welcomed { session, heartbeat });
                }
            }
            ToWorker::Prepare { job, scene, settings } => {
                if self.jobs.len() < MAX_JOBS {
                    self.jobs.insert(job, Announced { scene, settings: *settings });
                }
            }
            ToWorker::Lease(lease) => {
                if self.state == State::Ready && self.waiting.len() < MAX_LEASES {
                    self.waiting.push_back(lease);
                } else {
                    out.push(give_back(&lease));
                }
            }
            ToWorker::Revoke(lease) => {
                // One that is computed already is answered with its result.
                let place = self.waiting.iter().position(|l| l.id == lease);
                out.extend(place.and_then(|i| self.waiting.remove(i)).map(|l| give_back(&l)));
            }
            ToWorker::Route(route) => out.push(Action::Announce(route)),
            ToWorker::Forget(job) => {
                self.waiting.retain(|l| l.job != job);
                self.jobs.remove(&job);
                out.push(Action::Forget(job));
            }
        }
    }

    fn drain(&mut self, out: &mut Vec<Action>) {
        if self.state == State::Ready {
            out.push(Action::Send(FromWorker::Draining));
        }
        self.state = State::Draining;
        out.extend(self.waiting.drain(..).map(|l| give_back(&l)));
    }

    fn begin_next(&mut self, out: &mut Vec<Action>) {
        while self.computing.is_none() {
            let Some(lease) = self.waiting.pop_front() else { return };
            match self.jobs.get(&lease.job) {
                Some(job) => {
                    out.push(Action::Begin(lease.clone(), Box::new(job.clone())));
                    self.computing = Some(lease);
                }
                None => {
                    let error = "the job was not announced".to_owned();
                    let (lease, attempt) = (lease.id, lease.attempt);
                    out.push(Action::Send(FromWorker::TaskFailed { lease, attempt, error }));
                }
            }
        }
    }
}

fn give_back(lease: &Lease) -> Action {
    Action::Send(FromWorker::TaskReturned { lease: lease.id, attempt: lease.attempt })
}

#[cfg(test)]
mod tests {
    use super::*;
    use gatherlight_proto::Digest;
    use gatherlight_proto::message::{BlobRef, Task, WorkerId};
    use gatherlight_render::photon::{EmissionRange, MapKind};

    fn announced() -> Announced {
        let root = BlobRef { digest: Digest([1; 32]), bytes: 1 };
        let scene = SceneManifest { name: "a.glb".into(), root, externals: Vec::new() };
        Announced { scene, settings: RenderSettings::default() }
    }
    fn lease(id: u64) -> Lease {
        let range = EmissionRange { first: id * 10, end: id * 10 + 10 };
        Lease {
            id: LeaseId(id),
            attempt: 1,
            job: JobId(5),
            range,
            task: Task::Emission { round: 0, map: MapKind::Global },
        }
    }
    fn begin(id: u64) -> Action {
        Action::Begin(lease(id), Box::new(announced()))
    }
    fn returned(id: u64) -> Action {
        Action::Send(FromWorker::TaskReturned { lease: LeaseId(id), attempt: 1 })
    }
    fn give(session: &mut Session, id: u64) -> Vec<Action> {
        session.handle(Input::Message(ToWorker::Lease(lease(id))))
    }
    fn ready() -> Session {
        let mut session = Session::default();
        let (session_key, heartbeat) = (SessionKey([9; 16]), Duration::from_secs(1));
        let welcome = ToWorker::Welcome { worker: WorkerId(1), session: session_key, heartbeat };
        assert_eq!(session.handle(Input::Message(welcome)), [Action::Welcomed { session: session_key, heartbeat }]);
        let Announced { scene, settings } = announced();
        let prepare = ToWorker::Prepare { job: JobId(5), scene, settings: Box::new(settings) };
        assert_eq!(session.handle(Input::Message(prepare)), []);
        session
    }

    #[test]
    fn leases_are_computed_one_by_one_in_order() {
        let mut s = ready();
        assert_eq!(give(&mut s, 1), [begin(1)]);
        assert_eq!(give(&mut s, 2), []);
        assert_eq!(s.handle(Input::Computed(LeaseId(1))), [begin(2)]);
        assert_eq!(s.handle(Input::Delivered(LeaseId(1))), []);
    }

    #[test]
    fn failures_are_reported_and_the_next_lease_begins() {
        let mut s = ready();
        give(&mut s, 1);
        give(&mut s, 2);
        let failed = |id, error: &str| {
            Action::Send(FromWorker::TaskFailed { lease: LeaseId(id), attempt: 1, error: error.into() })
        };
        assert_eq!(s.handle(Input::ComputeFailed(LeaseId(1), "a".into())), [failed(1, "a"), begin(2)]);
        s.handle(Input::Computed(LeaseId(2)));
        assert_eq!(s.handle(Input::DeliveryFailed(LeaseId(2), "b".into())), [failed(2, "b")]);
        assert_eq!(s.handle(Input::DeliveryFailed(LeaseId(2), "b".into())), []);
    }

    #[test]
    fn revoked_and_forgotten_leases_are_not_begun() {
        let mut s = ready();
        (1..=3).for_each(|id| drop(give(&mut s, id)));
        assert_eq!(s.handle(Input::Message(ToWorker::Revoke(LeaseId(2)))), [returned(2)]);
        assert_eq!(s.handle(Input::Message(ToWorker::Revoke(LeaseId(1)))), [], "it is computed");
        assert_eq!(s.handle(Input::Computed(LeaseId(1))), [begin(3)]);
        assert_eq!(s.handle(Input::Message(ToWorker::Forget(JobId(5)))), [Action::Forget(JobId(5))]);
        s.handle(Input::Computed(LeaseId(3)));
        assert!(matches!(give(&mut s, 4)[..], [Action::Send(FromWorker::TaskFailed { .. })]));
    }

    #[test]
    fn draining_returns_what_waits_finishes_what_runs_and_leaves() {
        let mut s = ready();
        give(&mut s, 1);
        give(&mut s, 2);
        assert_eq!(s.handle(Input::Drain), [Action::Send(FromWorker::Draining), returned(2)]);
        assert_eq!(give(&mut s, 3), [returned(3)]);
        assert_eq!(s.handle(Input::Computed(LeaseId(1))), []);
        assert_eq!(s.handle(Input::Delivered(LeaseId(1))), [Action::Close]);
        assert_eq!((s.state(), give(&mut s, 4)), (State::Left, vec![]));
    }

    #[test]
    fn an_idle_worker_leaves_at_once() {
        assert_eq!(ready().handle(Input::Drain), [Action::Send(FromWorker::Draining), Action::Close]);
    }

    #[test]
    fn a_coordinator_cannot_pile_up_leases_or_jobs() {
        let mut s = ready();
        (0..=MAX_LEASES as u64).for_each(|id| drop(give(&mut s, id)));
        assert_eq!(give(&mut s, 99), [returned(99)]);
        for job in 0..2 * MAX_JOBS as u64 {
            let Announced { scene, settings } = announced();
            let prepare = ToWorker::Prepare { job: JobId(job), scene, settings: Box::new(settings) };
            s.handle(Input::Message(prepare));
        }
        assert_eq!(s.jobs.len(), MAX_JOBS);
    }
}

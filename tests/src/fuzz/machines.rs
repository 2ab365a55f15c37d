//! The state machines: whatever a peer says, in whatever order, their promises hold.

use super::Choices;
use gatherlight::schedule::pool::IntervalPool;
use gatherlight::schedule::{Command, Event, Policy, Scheduler, Terms};
use gatherlight::types::{JobId, Limits};
use gatherlight_proto::Digest;
use gatherlight_proto::message::{
    BlobRef, FromWorker, InputRef, Lease, LeaseId, MapRef, SceneManifest, SessionKey, Task, ToWorker, WorkerId,
};
use gatherlight_render::job::Phase;
use gatherlight_render::photon::{EmissionRange, MapKind};
use gatherlight_worker::session::{Action, Input, Session, State};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// A worker's session: leases are begun one at a time and answered once, and nothing happens after the end.
pub(super) fn session(bytes: &[u8]) {
    let mut choices = Choices(bytes);
    let (mut session, mut world) = (Session::default(), Answers::default());
    while !choices.is_empty() {
        let input = input(&mut choices, &mut world);
        let was_over = session.state() == State::Left;
        let actions = session.handle(input);
        assert!(!was_over || actions.is_empty(), "a session that has ended does something");
        actions.iter().for_each(|action| world.check(action));
    }
}

/// What is known of the leases from outside.
#[derive(Default)]
struct Answers {
    last: u64,
    begun: BTreeSet<LeaseId>,
    /// Returned, failed or delivered.
    answered: BTreeSet<LeaseId>,
    computing: Option<LeaseId>,
    /// Results on their way.
    travelling: BTreeSet<LeaseId>,
}

impl Answers {
    fn check(&mut self, action: &Action) {
        match action {
            Action::Begin(lease, _) => {
                assert!(self.computing.is_none(), "two leases are computed at once");
                assert!(self.begun.insert(lease.id) && !self.answered.contains(&lease.id), "a lease is begun again");
                self.computing = Some(lease.id);
            }
            Action::Send(FromWorker::TaskReturned { lease, .. } | FromWorker::TaskFailed { lease, .. }) => {
                assert!(self.answered.insert(*lease), "a lease is answered twice");
            }
            Action::Close => {
                assert!(self.computing.is_none() && self.travelling.is_empty(), "it leaves with work unfinished");
            }
            Action::Send(_) | Action::Welcomed { .. } | Action::Forget(_) | Action::Announce(_) => {}
        }
    }
    /// One of the latest leases.
    fn chosen(&self, choices: &mut Choices) -> LeaseId {
        LeaseId(self.last.saturating_sub(choices.below(8).into()))
    }
    /// Mostly the lease that is computed, which it is no more.
    fn computed(&mut self, choices: &mut Choices) -> (LeaseId, bool) {
        let id = self.computing.filter(|_| choices.below(4) > 0).unwrap_or_else(|| self.chosen(choices));
        (id, self.computing.take_if(|c| *c == id).is_some())
    }
}

fn input(choices: &mut Choices, world: &mut Answers) -> Input {
    let job = |c: &mut Choices| JobId(c.below(4).into());
    match choices.below(10) {
        0 => Input::Message(ToWorker::Welcome {
            worker: WorkerId(1),
            session: SessionKey([choices.byte(); 16]),
            heartbeat: Duration::from_secs(1),
        }),
        1 => {
            let root = BlobRef { digest: Digest([choices.byte(); 32]), bytes: 1 };
            let scene = SceneManifest { name: "x".into(), root, externals: Vec::new() };
            Input::Message(ToWorker::Prepare { job: job(choices), scene, settings: Box::default() })
        }
        2 | 3 => {
            world.last += 1;
            let (id, job) = (LeaseId(world.last), job(choices));
            let task = Task::Emission { round: 0, map: MapKind::Global };
            let range = EmissionRange { first: 0, end: 1 };
            Input::Message(ToWorker::Lease(Lease { id, attempt: 1, job, range, task }))
        }
        4 => Input::Message(ToWorker::Revoke(world.chosen(choices))),
        5 => Input::Message(ToWorker::Forget(job(choices))),
        6 => {
            let (id, was_computing) = world.computed(choices);
            if was_computing {
                world.travelling.insert(id);
            }
            Input::Computed(id)
        }
        7 => Input::ComputeFailed(world.computed(choices).0, "x".into()),
        8 => {
            let id = world.chosen(choices);
            let travelled = world.travelling.remove(&id);
            if choices.below(2) == 0 {
                return Input::DeliveryFailed(id, "x".into());
            }
            if travelled {
                world.answered.insert(id);
            }
            Input::Delivered(id)
        }
        _ => Input::Drain,
    }
}

/// The scheduler: an index counts once, a lease has one holder, and ended jobs leave nothing behind.
pub(super) fn schedule(bytes: &[u8]) {
    let mut choices = Choices(bytes);
    let policy = Policy { probe_paths: 3, min_paths: 2, max_paths: 5, max_tiles: 2, ..Policy::default() };
    let mut world = Cluster { scheduler: Scheduler::new(policy), ..Cluster::default() };
    let mut now = Duration::ZERO;
    while !choices.is_empty() {
        // Time passes in steps of up to 16 s, most of them short.
        now += Duration::from_millis(1 << choices.below(15));
        let event = event(&mut choices, &mut world);
        let commands = world.scheduler.handle(now, event);
        commands.into_iter().for_each(|command| world.carry_out(command));
        world.check();
    }
}

#[derive(Default)]
struct Cluster {
    scheduler: Scheduler,
    last_job: u64,
    last_worker: u64,
    /// Every lease that was handed out: to whom, and as what.
    leases: BTreeMap<LeaseId, (WorkerId, Lease)>,
    counted: BTreeMap<(JobId, String), IntervalPool>,
    /// Phases to build, of whose making nothing was said yet.
    builds: Vec<(JobId, Phase)>,
    assembling: Vec<JobId>,
    ended: BTreeSet<JobId>,
}

impl Cluster {
    fn carry_out(&mut self, command: Command) {
        match command {
            Command::Assign { worker, lease } => {
                assert!(!lease.range.is_empty() && !self.ended.contains(&lease.job));
                let before = self.leases.insert(lease.id, (worker, lease));
                assert!(before.is_none(), "a lease's name is used again");
            }
            Command::Accept { job, lease } => {
                let (_, lease) = &self.leases[&lease];
                assert_eq!(lease.job, job);
                let kind = match &lease.task {
                    Task::Emission { round, map } => format!("emission {round} {map:?}"),
                    Task::Bootstrap => "bootstrap".to_owned(),
                    Task::Splat { round, .. } => format!("splat {round}"),
                    Task::Gather { round, .. } => format!("gather {round}"),
                };
                let fresh = self.counted.entry((job, kind)).or_default().insert(lease.range);
                assert!(fresh, "an index counts twice");
            }
            Command::Build { job, phase } => self.builds.push((job, phase)),
            Command::Assemble { job, .. } => self.assembling.push(job),
            Command::Finish { job, .. } => assert!(self.ended.insert(job), "a job ends twice"),
            _ => {}
        }
    }
    fn check(&self) {
        for open in self.scheduler.leases() {
            assert!(self.scheduler.workers().contains_key(&open.worker), "a lease is with nobody");
            assert!(self.scheduler.job(open.lease.job).is_some(), "a lease of no job");
        }
        for (id, worker) in self.scheduler.workers() {
            assert!(worker.leases.iter().all(|l| self.scheduler.lease(*l).is_some_and(|o| o.worker == *id)));
        }
        assert!(self.ended.iter().all(|job| self.scheduler.job(*job).is_none()), "an ended job is still there");
    }
}

fn event(choices: &mut Choices, world: &mut Cluster) -> Event {
    let worker = |c: &mut Choices, w: &Cluster| WorkerId(w.last_worker.saturating_sub(c.below(6).into()));
    let job = |c: &mut Choices, w: &Cluster| JobId(w.last_job.saturating_sub(c.below(3).into()));
    match choices.below(16) {
        0 => {
            world.last_job += 1;
            let limits = Limits { time: (choices.below(4) == 0).then_some(Duration::from_secs(5)), error: None };
            let (priority, worker_bytes) = (choices.below(3).into(), choices.below(3).into());
            let terms = Box::new(Terms { limits, priority, worker_bytes, ..Terms::default() });
            Event::Submitted { job: JobId(world.last_job), phases: phases(choices), terms }
        }
        1 => Event::Cancelled { job: job(choices, world) },
        2 | 3 => {
            world.last_worker += 1;
            let (threads, memory_bytes) = (1 + u32::from(choices.below(4)), 1 + u64::from(choices.below(2)));
            Event::Joined { worker: WorkerId(world.last_worker), threads, memory_bytes }
        }
        4 => Event::Heard { worker: worker(choices, world) },
        5 => Event::Lost { worker: worker(choices, world) },
        6 => Event::Draining { worker: worker(choices, world) },
        7..=10 => answer(choices, world),
        11 | 12 => match world.builds.pop() {
            Some((job, phase)) => built(job, phase, choices),
            None => Event::Tick,
        },
        13 => match world.assembling.pop() {
            Some(job) if choices.below(8) > 0 => Event::Assembled { job },
            _ => Event::StepFailed { job: job(choices, world), error: "x".into() },
        },
        _ => Event::Tick,
    }
}

/// One of the latest leases is answered, mostly by its holder.
fn answer(choices: &mut Choices, world: &Cluster) -> Event {
    let behind = choices.below(8).into();
    let Some((&lease, (holder, given))) = world.leases.iter().rev().nth(behind) else { return Event::Tick };
    let worker = if choices.below(8) > 0 { *holder } else { WorkerId(choices.byte().into()) };
    let attempt = given.attempt + u32::from(choices.below(16) == 1);
    // Mostly the same result of the same indices.
    let (error, digest) = ("x".to_owned(), Digest([choices.below(32) / 31; 32]));
    match choices.below(8) {
        0 => Event::TaskFailed { worker, lease, attempt, error },
        1 => Event::Returned { worker, lease, attempt },
        2 => Event::Repeated { worker, lease, attempt, digest },
        wrong => {
            let first = given.range.first + u64::from(wrong == 7);
            let range = EmissionRange { first: first.min(given.range.end), end: given.range.end };
            let busy = Duration::from_micros(choices.byte().into());
            Event::Completed { worker, lease, attempt, range, busy, stored: 1, digest }
        }
    }
}

fn built(job: JobId, phase: Phase, choices: &mut Choices) -> Event {
    let blob = BlobRef { digest: Digest([choices.byte(); 32]), bytes: 1 };
    let round = phase.round();
    match phase {
        Phase::Emission { map, .. } => {
            let input = InputRef::Map(MapRef { kind: map, digest: blob.digest, bytes: 1 });
            Event::Built { job, round, input }
        }
        Phase::Bootstrap { .. } => Event::Built { job, round, input: InputRef::Bootstrap(blob) },
        Phase::SampleMap { .. } => Event::Built { job, round, input: InputRef::SampleMap(blob) },
        Phase::Gather { .. } | Phase::Splat { .. } => {
            Event::Closed { job, round, is_good_enough: choices.below(8) == 0 }
        }
    }
}

/// Phases of some method, or senseless ones.
fn phases(choices: &mut Choices) -> Vec<Phase> {
    let rounds = 1 + u32::from(choices.below(3));
    let paths = u64::from(choices.below(20));
    let gather = |round| Phase::Gather { round, tiles: 5 };
    let emission = move |round, map| Phase::Emission { round, map, paths };
    match choices.below(5) {
        0 => (0..rounds).map(gather).collect(),
        1 => (0..rounds).flat_map(|r| [emission(r, MapKind::Global), gather(r)]).collect(),
        2 => {
            let both = |r| [emission(r, MapKind::Global), emission(r, MapKind::Caustic), gather(r)];
            (0..rounds).flat_map(both).collect()
        }
        3 => {
            let splats = (0..rounds).map(|round| Phase::Splat { round, units: 4 });
            std::iter::once(Phase::Bootstrap { paths: paths + 1 }).chain(splats).collect()
        }
        _ => vec![gather(1), emission(0, MapKind::Caustic)],
    }
}

//! A virtual cluster around the real scheduler: virtual workers, network and clock, all drawn from one seed.

mod checks;
mod costs;

pub use costs::Costs;

use crate::random::Random;
use checks::Counted;
use gatherlight::schedule::job::Done;
use gatherlight::schedule::{Command, Event, Policy, Reason, Scheduler, Terms};
use gatherlight::types::{JobId, Limits};
use gatherlight_proto::Digest;
use gatherlight_proto::message::{Lease, Task, WorkerId};
use gatherlight_render::job::Phase;
use gatherlight_render::photon::MapKind;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};
use std::time::{Duration, Instant};

/// Virtual time after which a job that has not ended never will.
const FOREVER: u64 = 200_000_000_000;
/// Time between two ticks of the scheduler, and between two heartbeats.
const TICK: u64 = 500_000;
const BEAT: u64 = 1_000_000;

/// What a run is made of. Probabilities are per message or per task.
#[derive(Clone, Debug)]
pub struct Conditions {
    /// Workers there from the start.
    pub workers: usize,
    /// Of them, workers that fail every task.
    pub broken_workers: usize,
    /// Jobs submitted at random times.
    pub jobs: usize,
    /// Photon paths of each map of each job, at most.
    pub paths: u64,
    /// Tiles of each job, at most.
    pub tiles: u32,
    /// Rounds of each job, at most; with more than one, some jobs have a bootstrap and a splat phase instead.
    pub rounds: u32,
    /// Time limit of the jobs, in microseconds.
    pub time_limit: Option<u64>,
    /// Rounds after which an image is as good as was asked for.
    pub good_after: Option<u32>,
    /// Probability that a worker crashes at a task, to come back as a new session a while later.
    pub crash: f64,
    /// Probability that a worker stalls at a task for up to a minute, heartbeats included.
    pub stall: f64,
    /// Probability that a task fails.
    pub fail: f64,
    /// Probability that a message is lost (with its connection: the session ends).
    pub lose: f64,
    /// Probability that a result arrives twice.
    pub repeat: f64,
    /// Longest delay of a message, in microseconds; messages overtake each other.
    pub delay: u64,
    /// Whether jobs may end as failed.
    pub may_fail: bool,
    /// What things cost, where the run is to be timed.
    pub costs: Option<Costs>,
    /// The scheduler's constants.
    pub policy: Policy,
    /// Phases of every job, instead of some drawn at random.
    pub phases: Vec<Phase>,
}

impl Conditions {
    /// Nothing goes wrong.
    pub fn fair() -> Self {
        Conditions {
            workers: 8,
            broken_workers: 0,
            jobs: 2,
            paths: 2_000_000,
            tiles: 400,
            rounds: 1,
            time_limit: None,
            good_after: None,
            crash: 0.0,
            stall: 0.0,
            fail: 0.0,
            lose: 0.0,
            repeat: 0.0,
            delay: 1_000,
            may_fail: false,
            costs: None,
            policy: Policy::default(),
            phases: Vec::new(),
        }
    }
    /// Everything goes wrong now and then.
    pub fn stormy() -> Self {
        Conditions { crash: 0.05, stall: 0.02, fail: 0.003, lose: 0.02, repeat: 0.1, delay: 300_000, ..Self::fair() }
    }
}

/// What came of a run.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// The seed.
    pub seed: u64,
    /// Jobs.
    pub jobs: usize,
    /// Jobs that failed.
    pub failed: usize,
    /// Jobs that a limit ended.
    pub cut_off: usize,
    /// Gather rounds in images.
    pub rounds: u64,
    /// Most phases in progress at once in one job.
    pub widest_window: usize,
    /// Leases handed out again.
    pub retried: u64,
    /// Leases run twice, on a worker that had nothing else to do.
    pub repeated: u64,
    /// Results that did not count, beside those of such leases.
    pub discarded: u64,
    /// Workers that crashed.
    pub crashes: u64,
    /// Part of the workers' time, from the first lease to the end, in which they computed nothing.
    pub idle_fraction: f64,
    /// Virtual microseconds until the last job ended.
    pub elapsed: u64,
    /// Bytes of results sent by workers.
    pub result_bytes: u64,
    /// Bytes of maps, counted once each.
    pub broadcast_bytes: u64,
    /// Events that the scheduler took in.
    pub events: u64,
    /// Real time that it took for them.
    pub scheduler_time: Duration,
}

/// Something that will happen.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Due {
    Submit(usize),
    Join {
        speed: u64,
        broken: bool,
    },
    Beat(WorkerId),
    /// A command arrives at a worker.
    Arrive(WorkerId, u64),
    Compute(WorkerId),
    /// An event arrives at the scheduler.
    Report(u64),
    Tick,
}

/// A worker as it is, whatever the scheduler thinks.
struct Virtual {
    speed: u64,
    broken: bool,
    queue: Vec<Lease>,
    computing: Option<Lease>,
    stalled_until: u64,
    busy: u64,
}

/// The world of one run.
struct World<'c> {
    seed: u64,
    conditions: &'c Conditions,
    random: Random,
    now: u64,
    agenda: BinaryHeap<Reverse<(u64, u64, Due)>>,
    next_entry: u64,
    scheduler: Scheduler,
    workers: BTreeMap<WorkerId, Virtual>,
    last_worker: u64,
    /// Messages under way, by number.
    to_worker: BTreeMap<u64, Command>,
    to_scheduler: BTreeMap<u64, Event>,
    phases: Vec<Vec<Phase>>,
    counted: BTreeMap<(JobId, usize), Counted>,
    /// What the images are made of, as it was said when they were put together.
    made_of: BTreeMap<JobId, Done>,
    /// Rounds that were told to be closed.
    closed: BTreeMap<JobId, u32>,
    open: BTreeSet<JobId>,
    report: Report,
    first_lease: Option<u64>,
    capacity: u64,
    /// Until when the coordinator's link is busy receiving.
    received_until: u64,
    /// When the maps of a round are at all workers.
    maps_ready: BTreeMap<(JobId, u32), u64>,
}

/// Runs one cluster until all its jobs have ended.
///
/// # Panics
/// When an index counts twice or not at all, a job does not end, or it fails where it may not: with the seed.
pub fn simulate(seed: u64, conditions: &Conditions) -> Report {
    let mut world = World {
        seed,
        conditions,
        random: Random(seed.wrapping_mul(0x2545_f491_4f6c_dd1d)),
        now: 0,
        agenda: BinaryHeap::new(),
        next_entry: 0,
        scheduler: Scheduler::new(conditions.policy.clone()),
        workers: BTreeMap::new(),
        last_worker: 0,
        to_worker: BTreeMap::new(),
        to_scheduler: BTreeMap::new(),
        phases: Vec::new(),
        counted: BTreeMap::new(),
        made_of: BTreeMap::new(),
        closed: BTreeMap::new(),
        open: BTreeSet::new(),
        report: Report { seed, jobs: conditions.jobs, ..Report::default() },
        first_lease: None,
        capacity: 0,
        received_until: 0,
        maps_ready: BTreeMap::new(),
    };
    world.populate();
    while world.report.elapsed == 0 {
        let Some(Reverse((at, _, due))) = world.agenda.pop() else { panic!("seed {seed}: nothing is left to happen") };
        assert!(at < FOREVER, "seed {seed}: jobs {:?} never end", world.open);
        world.now = at;
        world.happen(due);
    }
    world.finish()
}

impl World<'_> {
    fn populate(&mut self) {
        for i in 0..self.conditions.jobs {
            if !self.conditions.phases.is_empty() {
                self.phases.push(self.conditions.phases.clone());
                self.open.insert(JobId(i as u64));
                self.plan(0, Due::Submit(i));
                continue;
            }
            let paths = |r: &mut Random, most| r.below(most) + most / 8;
            let (global, caustic) = (paths(&mut self.random, self.conditions.paths), self.conditions.paths / 3);
            let tiles = self.random.below(u64::from(self.conditions.tiles)) as u32 + self.conditions.tiles / 4 + 1;
            let all = |round| {
                let emission = move |map, paths| Phase::Emission { round, map, paths };
                [emission(MapKind::Global, global), emission(MapKind::Caustic, caustic), Phase::Gather { round, tiles }]
            };
            // With both maps, with one, or without photons.
            let skip = if self.conditions.jobs == 1 { 0 } else { self.random.below(3) as usize };
            let most = self.conditions.rounds;
            let rounds = if most > 1 { 1 + self.random.below(u64::from(most)) as u32 } else { 1 };
            let chains = most > 1 && self.random.chance(0.3);
            let bootstrap = (skip < 2).then_some(Phase::Bootstrap { paths: global });
            let splats = (0..rounds).map(|round| Phase::Splat { round, units: u64::from(tiles) });
            self.phases.push(match chains {
                true => bootstrap.into_iter().chain(splats).collect(),
                // Rounds with maps of their own, or passes that read the first round's.
                false => {
                    let passes = most > 1 && self.random.chance(0.3);
                    let of = |r| all(r)[if passes && r > 0 { 2 } else { skip }..].to_vec();
                    // Some of them go where the error is from some round on.
                    let decides = |r| (passes && r > 0 && r == rounds / 2).then_some(Phase::SampleMap { round: r });
                    (0..rounds).flat_map(|r| decides(r).into_iter().chain(of(r)).collect::<Vec<_>>()).collect()
                }
            });
            self.open.insert(JobId(i as u64));
            let at = self.random.below(3_000_000) * u64::from(self.conditions.jobs > 1);
            self.plan(at, Due::Submit(i));
        }
        for i in 0..self.conditions.workers {
            let speed = 5_000 << self.random.below(5);
            let at = if self.conditions.costs.is_some() { 0 } else { self.random.below(2_000_000) };
            self.plan(at, Due::Join { speed, broken: i < self.conditions.broken_workers });
        }
        self.plan(0, Due::Tick);
    }

    fn plan(&mut self, at: u64, due: Due) {
        self.next_entry += 1;
        self.agenda.push(Reverse((at, self.next_entry, due)));
    }

    fn delay(&mut self) -> u64 {
        1 + self.random.below(self.conditions.delay)
    }

    /// Sends an event to the scheduler. A lost message takes its connection along.
    fn send(&mut self, event: Event, worker: WorkerId) {
        self.send_after(0, event, worker);
    }

    /// The same, with bytes that take `time` to arrive.
    fn send_after(&mut self, time: u64, event: Event, worker: WorkerId) {
        if self.random.chance(self.conditions.lose) {
            return self.disconnect(worker);
        }
        let number = self.next_entry;
        let at = self.now + time + self.delay();
        self.to_scheduler.insert(number, event);
        self.plan(at, Due::Report(number));
    }

    /// The session breaks: the worker forgets its leases and comes back under a new number.
    fn disconnect(&mut self, worker: WorkerId) {
        let Some(gone) = self.workers.remove(&worker) else { return };
        let at = self.now + self.delay();
        // The coordinator sees a broken connection at once, or only misses heartbeats.
        if self.random.chance(0.5) {
            let number = self.next_entry;
            self.to_scheduler.insert(number, Event::Lost { worker });
            self.plan(at, Due::Report(number));
        }
        let back = self.now + 1_000_000 + self.random.below(20_000_000);
        self.plan(back, Due::Join { speed: gone.speed, broken: gone.broken });
        self.report.crashes += 1;
    }

    fn happen(&mut self, due: Due) {
        match due {
            Due::Submit(i) => {
                let phases = self.phases[i].clone();
                let limits = Limits { time: self.conditions.time_limit.map(Duration::from_micros), error: None };
                let terms = Box::new(Terms { limits, ..Terms::default() });
                self.event(Event::Submitted { job: JobId(i as u64), phases, terms });
            }
            Due::Join { speed, broken } => {
                self.last_worker += 1;
                let id = WorkerId(self.last_worker);
                let new = Virtual { speed, broken, queue: Vec::new(), computing: None, stalled_until: 0, busy: 0 };
                self.workers.insert(id, new);
                self.event(Event::Joined { worker: id, threads: 4, memory_bytes: u64::MAX });
                self.plan(self.now + BEAT, Due::Beat(id));
            }
            Due::Beat(worker) => {
                let Some(w) = self.workers.get(&worker) else { return };
                if w.stalled_until <= self.now {
                    self.send(Event::Heard { worker }, worker);
                }
                self.plan(self.now + BEAT, Due::Beat(worker));
            }
            Due::Arrive(worker, number) => {
                let Some(command) = self.to_worker.remove(&number) else { return };
                self.arrive(worker, command);
            }
            Due::Compute(worker) => self.computed(worker),
            Due::Report(number) => {
                if let Some(event) = self.to_scheduler.remove(&number) {
                    self.event(event);
                }
            }
            Due::Tick => {
                self.event(Event::Tick);
                self.plan(self.now + TICK, Due::Tick);
            }
        }
    }

    fn arrive(&mut self, worker: WorkerId, command: Command) {
        let Some(w) = self.workers.get_mut(&worker) else { return };
        match command {
            Command::Assign { lease, .. } => w.queue.push(lease),
            Command::Revoke { lease, .. } => {
                if let Some(place) = w.queue.iter().position(|l| l.id == lease) {
                    let Lease { id: lease, attempt, .. } = w.queue.remove(place);
                    self.send(Event::Returned { worker, lease, attempt }, worker);
                }
            }
            Command::Forget { job, .. } => w.queue.retain(|l| l.job != job),
            _ => {}
        }
        self.begin(worker);
    }

    fn begin(&mut self, worker: WorkerId) {
        let Some(w) = self.workers.get_mut(&worker) else { return };
        if w.computing.is_some() || w.queue.is_empty() {
            return;
        }
        let (lease, speed) = (w.queue.remove(0), w.speed);
        let (time, waits) = (self.compute_time(&lease, speed), self.ready_at(&lease).saturating_sub(self.now));
        let Some(w) = self.workers.get_mut(&worker) else { return };
        w.busy += time;
        w.computing = Some(lease);
        if self.random.chance(self.conditions.crash) {
            return self.disconnect(worker);
        }
        let stall = if self.random.chance(self.conditions.stall) { self.random.below(60_000_000) } else { 0 };
        if let Some(w) = self.workers.get_mut(&worker) {
            w.stalled_until = self.now + stall;
        }
        self.first_lease.get_or_insert(self.now);
        self.plan(self.now + waits + time + stall, Due::Compute(worker));
    }

    fn computed(&mut self, worker: WorkerId) {
        let Some(w) = self.workers.get_mut(&worker) else { return };
        let Some(done) = w.computing.take() else { return };
        let (broken, speed) = (w.broken, w.speed);
        let busy = Duration::from_micros(self.compute_time(&done, speed));
        let Lease { id: lease, attempt, range, task, .. } = done;
        if broken || self.random.chance(self.conditions.fail) {
            let error = "virtual failure".to_owned();
            self.send(Event::TaskFailed { worker, lease, attempt, error }, worker);
        } else {
            let stored = self.stored(&task, range.len());
            let time = self.deliver_time(&task, range.len());
            let done = Event::Completed { worker, lease, attempt, range, busy, stored, digest: Digest([0; 32]) };
            if self.random.chance(self.conditions.repeat) {
                self.send_after(time, done.clone(), worker);
            }
            self.send_after(time, done, worker);
        }
        self.begin(worker);
    }

    /// Gives the scheduler an event, checks what it says, and passes it on.
    fn event(&mut self, event: Event) {
        let completed = match &event {
            Event::Completed { lease, range, .. } => {
                self.scheduler.lease(*lease).map(|l| (*lease, l.lease.job, l.phase, *range))
            }
            _ => None,
        };
        let slower = match &event {
            Event::Completed { worker, lease, attempt, .. } => {
                self.scheduler.settled(*worker, *lease, *attempt).is_some()
            }
            _ => false,
        };
        let begin = Instant::now();
        let commands = self.scheduler.handle(Duration::from_micros(self.now), event);
        self.report.scheduler_time += begin.elapsed();
        self.report.events += 1;
        for command in commands {
            match &command {
                Command::Accept { lease, .. } => self.accept(*lease, completed.as_ref()),
                Command::Discard { .. } => self.report.discarded += u64::from(!slower),
                Command::Build { job, phase } => self.build(*job, *phase),
                Command::Retire { job, round } => self.assert_round_complete(*job, *round),
                Command::Assemble { job, done } => {
                    self.made_of.insert(*job, *done);
                    let time = self.conditions.costs.map_or(0, |c| costs::micros(c.close));
                    let at = self.now + time + self.delay();
                    let number = self.next_entry;
                    self.to_scheduler.insert(number, Event::Assembled { job: *job });
                    self.plan(at, Due::Report(number));
                }
                Command::Finish { job, outcome } => self.ended(*job, outcome),
                Command::Prepare { worker, .. }
                | Command::Assign { worker, .. }
                | Command::Revoke { worker, .. }
                | Command::Forget { worker, .. } => {
                    let (worker, number, at) = (*worker, self.next_entry, self.now + self.delay());
                    if let Command::Assign { lease, .. } = &command {
                        let reason = self.scheduler.lease(lease.id).map(|l| l.reason);
                        self.report.repeated += u64::from(reason == Some(Reason::Repeat));
                        self.report.retried += u64::from(reason == Some(Reason::Retry));
                    }
                    self.to_worker.insert(number, command.clone());
                    self.plan(at, Due::Arrive(worker, number));
                }
                Command::Dispute { .. } => panic!("seed {}: virtual workers all compute the same", self.seed),
                // Whoever is dismissed notices, and comes back.
                Command::Dismiss { worker, .. } => self.disconnect(*worker),
            }
        }
    }

    fn finish(mut self) -> Report {
        assert_eq!(self.scheduler.leases().count(), 0, "seed {}: leases without a job", self.seed);
        let span = self.now - self.first_lease.unwrap_or(0);
        self.capacity = span * self.workers.len() as u64;
        let busy: u64 = self.workers.values().map(|w| w.busy).sum();
        self.report.idle_fraction = 1.0 - busy as f64 / self.capacity.max(1) as f64;
        self.report
    }
}

/// What an index costs: a tile as much as some thousand photon paths, a Markov chain as much as some tiles.
fn cost(task: &Task) -> u64 {
    match task {
        Task::Emission { .. } | Task::Bootstrap => 1,
        Task::Gather { .. } => 1_000,
        Task::Splat { .. } => 3_000,
    }
}

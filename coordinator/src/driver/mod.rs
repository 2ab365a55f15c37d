//! The one loop: an input becomes an event, the scheduler answers with commands, the driver carries them out.
//!
//! The driver owns the scheduler, the sessions and the jobs' heavy parts, and never waits: computing goes to the
//! compute threads, which report back through the same queue.

mod broadcast;
mod handle;
mod job;
mod keep;
mod live;
mod resume;
mod sessions;
mod steps;

pub use handle::{Delivery, Handle, Joined, NoImage, Offered, Payload, Source, SubmitError, Ticket};
pub use job::Spec;

pub(crate) use handle::{Built, Image, Made};
pub(crate) use live::StatedError;

use crate::broadcast::Broadcasts;
use crate::compute::Compute;
use crate::counters::Counters;
use crate::random::random_u64;
use crate::room::Room;
use crate::schedule::job::closes_rounds;
use crate::schedule::{Command, Event, Outcome, Policy, Reason, Scheduler, Terms};
use crate::store::Store;
use crate::store::journal::{Change, SavedResult};
use crate::types::{JobId, JobStats};
use gatherlight_proto::Digest;
use gatherlight_proto::collective::{Transfer, Transfers};
use gatherlight_proto::message::{DeliverHeader, FromWorker, ToWorker, WorkerId};
use gatherlight_render::film::SampleMap;
use gatherlight_render::integrator::Bootstrap;
use gatherlight_render::job::{Phase, PhotonMap};
use handle::{Input, Reply};
use job::JobRecord;
use resume::Start;
use sessions::Sessions;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use steps::collective;
use tokio::sync::mpsc;
use tokio::time::{Instant, MissedTickBehavior, interval};

/// Time between two looks at deadlines and snapshots.
const TICK: Duration = Duration::from_millis(100);
/// Ended jobs that are still listed; the oldest are forgotten first.
const MAX_ENDED_JOBS: usize = 1_000;

/// What happens to a finished film.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KeepImage {
    /// It stays in memory until the caller takes it.
    Film,
    /// It becomes an EXR file in the store.
    Exr,
}

/// Takes what workers of this process read, under the digest that leases name.
pub trait Sink: Send + Sync {
    /// A photon map.
    fn offer_map(&self, digest: Digest, map: Arc<PhotonMap>);
    /// A bootstrap.
    fn offer_bootstrap(&self, digest: Digest, bootstrap: Arc<Bootstrap>);
    /// Offers a sample map.
    fn offer_sample_map(&self, digest: Digest, map: Arc<SampleMap>);
    /// What was offered under this digest is not read any more; to be called once for each offer.
    fn withdraw(&self, digest: Digest);
}

/// How a driver runs.
#[derive(Clone)]
pub struct DriverConfig {
    /// The scheduler's constants.
    pub policy: Policy,
    /// Most jobs that have not ended.
    pub max_live_jobs: usize,
    /// Most memory one job may need of this process, by its plan.
    pub max_job_bytes: u64,
    /// What to do with finished films.
    pub keep: KeepImage,
    /// What is counted of it.
    pub counters: Arc<Counters>,
    /// Heartbeats asked of workers.
    pub heartbeat: Duration,
    /// Where maps and bootstraps go when every worker is in this process; otherwise they are encoded for the broadcast.
    pub sink: Option<Arc<dyn Sink>>,
}

/// The loop's state.
pub struct Driver {
    config: DriverConfig,
    scheduler: Scheduler,
    jobs: BTreeMap<JobId, JobRecord>,
    /// Jobs by age.
    order: Vec<JobId>,
    sessions: Sessions,
    broadcasts: Broadcasts,
    compute: Compute,
    store: Arc<Store>,
    /// To itself, for compute threads; weak, so that the driver ends with its last user.
    own: mpsc::WeakSender<Input>,
    origin: Instant,
    /// Age of the oldest job that an earlier driver left: time here began before the driver.
    before: Duration,
    /// When old blobs were last collected.
    collected: Duration,
}

impl Driver {
    /// Starts a driver on the current tokio runtime. Jobs that an earlier one left in the store go on.
    pub fn start(config: DriverConfig, compute: Compute, store: Arc<Store>) -> Handle {
        let (handle, inputs) = Handle::channel();
        let mut driver = Driver {
            scheduler: Scheduler::new(config.policy.clone()),
            sessions: Sessions::new(config.heartbeat),
            broadcasts: Broadcasts::default(),
            config,
            jobs: BTreeMap::new(),
            order: Vec::new(),
            compute,
            store,
            own: handle.downgrade(),
            origin: Instant::now(),
            before: Duration::ZERO,
            collected: Duration::ZERO,
        };
        driver.take_over();
        tokio::spawn(driver.run(inputs));
        handle
    }

    async fn run(mut self, mut inputs: mpsc::Receiver<Input>) {
        let mut ticks = interval(TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                input = inputs.recv() => match input {
                    None | Some(Input::Shutdown) => return,
                    Some(input) => self.take(input),
                },
                _ = ticks.tick() => {
                    self.event(Event::Tick);
                    self.collect_now_and_then();
                    self.refresh_all();
                }
            }
        }
    }

    fn now(&self) -> Duration {
        self.before + self.origin.elapsed()
    }

    fn take(&mut self, input: Input) {
        match input {
            Input::Submit(spec, reply) => self.submit(*spec, reply),
            Input::Find(owner, key, reply) => {
                let found = self.jobs.values().find(|j| j.is(&owner, &key)).map(|j| j.id);
                let _ = reply.send(found);
            }
            Input::List(reply) => {
                let jobs = self.order.iter().filter_map(|id| self.jobs.get(id)).map(JobRecord::progress).collect();
                drop(reply.send(jobs));
            }
            Input::Watch(id, reply) => drop(reply.send(self.jobs.get(&id).map(JobRecord::watch))),
            Input::Cancel(id, reply) => {
                self.cancel(id);
                drop(reply.send(self.jobs.get(&id).map(JobRecord::progress)));
            }
            Input::Image(id, reply) => {
                drop(reply.send(self.jobs.get(&id).ok_or(NoImage::NoJob).and_then(JobRecord::image)));
            }
            Input::Film(id, reply) => drop(reply.send(self.jobs.get_mut(&id).and_then(|j| j.kept_film.take()))),
            Input::Workers(reply) => drop(reply.send(self.sessions.list(self.now(), &self.scheduler))),
            Input::Join(hello, reply) => {
                let (threads, memory_bytes) = (hello.threads, hello.memory_bytes);
                let joined = self.sessions.open(hello);
                let worker = joined.worker;
                self.event(Event::Joined { worker, threads, memory_bytes });
                if reply.send(joined).is_err() {
                    self.event(Event::Lost { worker });
                }
            }
            Input::Message(worker, message) => self.message(worker, message),
            Input::Left(worker) => self.left(worker),
            Input::Offer(header, reply) => {
                let worker = self.sessions.worker(header.session);
                drop(reply.send(worker.map_or(Offered::Stale, |w| self.offered(w, &header))));
            }
            Input::Repeated(worker, DeliverHeader { lease, attempt, .. }, digest) => {
                self.event(Event::Repeated { worker, lease, attempt, digest });
            }
            Input::Refuse(ticket, error) => self.refuse(&ticket, error),
            Input::Complete(delivery, reply) => self.complete(*delivery, reply),
            Input::Locate(session, digest, reply) => drop(reply.send(self.locate(session, digest))),
            Input::Pass(digest, ticket, reply) => drop(reply.send(self.pass(digest, &ticket))),
            Input::Built(id, phase, built) => self.built(id, phase, built),
            Input::Closed(id, closed) => self.closed(id, closed),
            Input::Assembled(id, image) => self.assembled(id, image),
            Input::Resumed(id, resumed) => self.resumed(id, resumed),
            Input::MakeRoom(bytes, reply) => self.make_room(bytes, reply),
            // The loop has ended before it gets here.
            Input::Shutdown => {}
        }
    }

    /// Starts a job; `reply` hears of it once it would survive this process.
    fn submit(&mut self, spec: Spec, reply: Reply<Result<JobId, SubmitError>>) {
        if let Some(job) = self.jobs.values().find(|j| j.is(&spec.owner, &spec.submission.request_key)) {
            return drop(reply.send(Ok(job.id)));
        }
        let phases = spec.prepared.phases();
        if let Err(error) = self.may_start(&spec, &phases) {
            return drop(reply.send(Err(error)));
        }
        let mut id = JobId(random_u64());
        while self.jobs.contains_key(&id) {
            id = JobId(random_u64());
        }
        tracing::info!(job = %id, name = spec.submission.name, phases = phases.len(), "submitted");
        let stored = spec.stored();
        let record = stored.encode();
        let start = Start::new(&spec, phases, self.config.sink.clone());
        self.jobs.insert(id, JobRecord::new(id, stored, Duration::ZERO, self.now()));
        self.order.push(id);
        self.begin(id, spec, start);
        self.forget_old_jobs();
        let own = self.own.clone();
        self.note_then(id, Change::Job(record), move |noted| match noted {
            Ok(()) => drop(reply.send(Ok(id))),
            Err(error) => {
                drop(reply.send(Err(SubmitError::Store(error.clone()))));
                if let Some(handle) = Handle::upgrade(&own) {
                    handle.report(Input::Assembled(id, Err(error)));
                }
            }
        });
    }

    fn may_start(&self, spec: &Spec, phases: &[Phase]) -> Result<(), SubmitError> {
        let (limits, method) = (spec.submission.limits, spec.submission.settings.method.name());
        if limits.time.is_some() && !closes_rounds(phases) {
            return Err(SubmitError::TimeLimit(method));
        }
        if limits.error.is_some() && !closes_rounds(phases) {
            return Err(SubmitError::ErrorLimit(method));
        }
        let (needed, limit) = (spec.prepared.plan().coordinator_bytes, self.config.max_job_bytes);
        if needed > limit {
            return Err(SubmitError::Memory { needed, limit });
        }
        let live = self.jobs.values().filter(|j| !j.is_final()).count();
        if live >= self.config.max_live_jobs {
            return Err(SubmitError::Full(live));
        }
        Ok(())
    }

    /// Begins the work of a job that is listed already, or goes on with it.
    fn begin(&mut self, id: JobId, spec: Spec, start: Start) {
        let Some(job) = self.jobs.get_mut(&id) else { return };
        let Start { live, saved, kept, later } = start;
        let phases = live.phases.to_vec();
        job.begin(live, spec.prepared.rounds(), kept, later);
        let terms = Terms {
            limits: spec.submission.limits,
            priority: spec.submission.priority,
            worker_bytes: spec.prepared.plan().worker_bytes,
            age: job.age,
            saved,
        };
        self.event(Event::Submitted { job: id, phases, terms: Box::new(terms) });
        self.refresh(id);
    }

    fn cancel(&mut self, id: JobId) {
        self.event(Event::Cancelled { job: id });
        // One that has not come back from the store is none of the scheduler's.
        if self.jobs.get(&id).is_some_and(|j| !j.is_final()) {
            self.finish(id, Outcome::Cancelled);
        }
    }

    fn finish(&mut self, id: JobId, outcome: Outcome) {
        tracing::info!(job = %id, ?outcome, "ended");
        let now = self.now();
        let Some(job) = self.jobs.get_mut(&id) else { return };
        job.finish(now, outcome);
        let record = job.stored.encode();
        self.note(id, Change::Ended(record));
        self.end_broadcasts();
    }

    fn forget_old_jobs(&mut self) {
        let ended = |id: &JobId| self.jobs.get(id).is_some_and(JobRecord::is_final);
        let excess = self.order.iter().filter(|id| ended(id)).count().saturating_sub(MAX_ENDED_JOBS);
        let old: Vec<JobId> = self.order.iter().filter(|id| ended(id)).take(excess).copied().collect();
        self.order.retain(|id| !old.contains(id));
        self.jobs.retain(|id, _| !old.contains(id));
        old.into_iter().for_each(|id| self.note(id, Change::Forgotten));
    }

    fn message(&mut self, worker: WorkerId, message: FromWorker) {
        let event = match message {
            FromWorker::Hello(_) | FromWorker::Heartbeat => Event::Heard { worker },
            FromWorker::TaskFailed { lease, attempt, error } => {
                self.config.counters.leases_failed.add(1);
                tracing::warn!(worker = worker.0, lease = lease.0, attempt, error, "task failed");
                Event::TaskFailed { worker, lease, attempt, error }
            }
            FromWorker::TaskReturned { lease, attempt } => Event::Returned { worker, lease, attempt },
            FromWorker::Draining => Event::Draining { worker },
        };
        self.event(event);
    }

    fn left(&mut self, worker: WorkerId) {
        if self.sessions.close(worker) {
            tracing::info!(worker = worker.0, "left");
            self.event(Event::Lost { worker });
        }
    }

    /// What is to be done with a result that `worker` offers.
    fn offered(&self, worker: WorkerId, header: &DeliverHeader) -> Offered {
        if self.scheduler.settled(worker, header.lease, header.attempt).is_some() {
            return Offered::Repeated(worker);
        }
        self.ticket(worker, header).map_or(Offered::Stale, |ticket| Offered::Wanted(Box::new(ticket)))
    }

    fn ticket(&self, worker: WorkerId, header: &DeliverHeader) -> Option<Ticket> {
        let open = self.scheduler.lease(header.lease)?;
        if !self.scheduler.is_open(worker, header.lease, header.attempt) {
            return None;
        }
        let (job, phase) = (open.lease.job, open.phase);
        let live = self.jobs.get(&job)?.live.as_ref()?;
        let phase = (phase, self.scheduler.job(job)?.work(phase)?.phase);
        Some(Ticket {
            worker,
            lease: header.lease,
            attempt: header.attempt,
            range: header.range,
            busy: header.busy,
            fetched: header.fetched,
            phase,
            shape: live.shape.clone(),
            is_early: live.is_early(phase.1),
        })
    }

    fn refuse(&mut self, ticket: &Ticket, error: String) {
        let &Ticket { worker, lease, attempt, .. } = ticket;
        self.config.counters.leases_failed.add(1);
        tracing::warn!(worker = worker.0, lease = lease.0, error, "result refused");
        self.event(Event::TaskFailed { worker, lease, attempt, error: format!("result refused: {error}") });
    }

    /// Offers a result to the scheduler and, where it counts, puts it to use. `reply` hears that it counts once it is safe.
    fn complete(&mut self, delivery: Delivery, reply: Reply<bool>) {
        let Delivery { ticket, payload, raw, digest, room, transfer } = delivery;
        let Ticket { worker, lease, attempt, range, busy, mut fetched, phase: (index, phase), .. } = ticket;
        fetched.record(collective(phase), Transfer { count: 1, bytes: raw.len() as u64, time: transfer });
        let stored = payload.stored();
        let completed = Event::Completed { worker, lease, attempt, range, busy, stored, digest };
        let commands = self.scheduler.handle(self.now(), completed);
        let accepted = commands.iter().find_map(|c| match c {
            Command::Accept { job, lease: l } if *l == lease => Some(*job),
            _ => None,
        });
        let result = SavedResult { phase: index, range, busy, payload: raw };
        let used = accepted.map(|job| (job, self.put_to_use(job, phase, (payload, room.clone()), &result, fetched)));
        self.carry_out(commands);
        match used {
            Some((job, Err(error))) => {
                self.event(Event::StepFailed { job, error });
                let _ = reply.send(true);
            }
            Some((job, Ok(()))) => {
                self.config.counters.leases_done.add(1);
                self.add_light(job);
                self.refresh(job);
                self.note_result(job, result, room, reply);
            }
            None => {
                tracing::debug!(worker = worker.0, lease = lease.0, "stale result discarded");
                let _ = reply.send(false);
            }
        }
    }

    fn put_to_use(
        &mut self,
        id: JobId,
        phase: Phase,
        payload: (Payload, Room),
        result: &SavedResult,
        transfers: Transfers,
    ) -> Result<(), String> {
        let job = self.jobs.get_mut(&id).ok_or("the job is gone")?;
        let (busy, result_bytes) = (result.busy, result.payload.len() as u64);
        let mut part = JobStats { busy, result_bytes, transfers, ..JobStats::default() };
        let live = job.live.as_mut().ok_or("the job has ended")?;
        let used = live.put_to_use(payload, phase, &mut part);
        job.add_stats(phase.round(), &part);
        used
    }

    fn event(&mut self, event: Event) {
        let commands = self.scheduler.handle(self.now(), event);
        self.carry_out(commands);
    }

    fn carry_out(&mut self, commands: Vec<Command>) {
        for command in commands {
            match command {
                Command::Prepare { worker, job } => {
                    if let Some(j) = self.jobs.get(&job) {
                        let (scene, settings) =
                            (j.stored.submission.manifest.clone(), Box::new(j.stored.submission.settings.clone()));
                        self.send(worker, ToWorker::Prepare { job, scene, settings });
                    }
                }
                Command::Assign { worker, lease } => {
                    match self.scheduler.lease(lease.id).map(|l| l.reason) {
                        Some(Reason::Retry) => self.config.counters.leases_retried.add(1),
                        Some(Reason::Repeat) => self.config.counters.leases_repeated.add(1),
                        Some(Reason::Fresh) | None => {}
                    }
                    self.send(worker, ToWorker::Lease(lease));
                }
                Command::Revoke { worker, lease } => self.send(worker, ToWorker::Revoke(lease)),
                Command::Forget { worker, job } => self.send(worker, ToWorker::Forget(job)),
                Command::Accept { .. } | Command::Discard { .. } => {}
                Command::Build { job, phase } => self.build(job, phase),
                Command::Retire { job, round } => self.retire(job, round),
                Command::Assemble { job, done } => self.assemble(job, done),
                Command::Finish { job, outcome } => self.finish(job, outcome),
                Command::Dispute { job, phase, range, workers } => {
                    let names = workers.map(|w| self.sessions.name(w));
                    tracing::error!(
                        %job, phase, first = range.first, end = range.end, ?names,
                        "two workers computed different bits for the same indices: one of them has bad hardware"
                    );
                }
                Command::Dismiss { worker, reason } => {
                    tracing::warn!(worker = worker.0, reason, "dismissed");
                    self.sessions.close(worker);
                }
            }
        }
    }

    fn send(&mut self, worker: WorkerId, message: ToWorker) {
        if !self.sessions.send(worker, message) {
            // It does not read, or is gone: the queue is the place to say so, since we are amid commands.
            let own = self.own.clone();
            tokio::spawn(async move {
                if let Some(handle) = Handle::upgrade(&own) {
                    handle.left(worker).await;
                }
            });
        }
    }

    fn refresh(&mut self, id: JobId) {
        let now = self.now();
        if let Some(job) = self.jobs.get_mut(&id) {
            job.refresh(now, &self.scheduler);
        }
    }

    fn refresh_all(&mut self) {
        let now = self.now();
        for job in self.jobs.values_mut().filter(|j| !j.is_final()) {
            job.refresh(now, &self.scheduler);
        }
    }
}

//! The one loop: an input becomes an event, the scheduler answers with commands, the driver carries them out.
//!
//! The driver owns the scheduler, the sessions and the jobs' heavy parts, and never waits: computing goes to the
//! compute threads, which report back through the same queue.

mod handle;
mod job;
mod sessions;

pub use handle::{Delivery, Handle, Joined, NoImage, Payload, Source, SubmitError, Ticket};
pub use job::Spec;

pub(crate) use handle::{BuiltMap, Image};

use crate::compute::{Compute, Panicked};
use crate::random::random_u64;
use crate::schedule::{Command, Event, Policy, Scheduler};
use crate::store::Store;
use crate::types::JobId;
use crate::{assemble, merge};
use gatherlight_proto::Digest;
use gatherlight_proto::message::{FromWorker, Task, ToWorker, WorkerId};
use gatherlight_render::film::Film;
use gatherlight_render::job::PhotonMap;
use gatherlight_render::photon::MapKind;
use handle::Input;
use job::{JobRecord, ServedMap};
use sessions::Sessions;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
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

/// Takes a map that is searched in this process, under the digest that leases name.
pub type MapSink = Arc<dyn Fn(Digest, PhotonMap) + Send + Sync>;

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
    /// Heartbeats asked of workers.
    pub heartbeat: Duration,
    /// Where maps go when every worker is in this process; otherwise they are encoded for the broadcast.
    pub map_sink: Option<MapSink>,
}

/// The loop's state.
pub struct Driver {
    config: DriverConfig,
    scheduler: Scheduler,
    jobs: BTreeMap<JobId, JobRecord>,
    /// Jobs by age.
    order: Vec<JobId>,
    sessions: Sessions,
    compute: Compute,
    store: Arc<Store>,
    /// To itself, for compute threads; weak, so that the driver ends with its last user.
    own: mpsc::WeakSender<Input>,
    origin: Instant,
}

impl Driver {
    /// Starts a driver on the current tokio runtime.
    pub fn start(config: DriverConfig, compute: Compute, store: Arc<Store>) -> Handle {
        let (handle, inputs) = Handle::channel();
        let driver = Driver {
            scheduler: Scheduler::new(config.policy.clone()),
            sessions: Sessions::new(config.heartbeat),
            config,
            jobs: BTreeMap::new(),
            order: Vec::new(),
            compute,
            store,
            own: handle.downgrade(),
            origin: Instant::now(),
        };
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
                    self.refresh_all();
                }
            }
        }
    }

    fn now(&self) -> Duration {
        self.origin.elapsed()
    }

    fn take(&mut self, input: Input) {
        match input {
            Input::Submit(spec, reply) => drop(reply.send(self.submit(*spec))),
            Input::Find(key, reply) => {
                let found = self.jobs.values().find(|j| j.request_key == key).map(|j| j.id);
                let _ = reply.send(found);
            }
            Input::List(reply) => {
                let jobs = self.order.iter().filter_map(|id| self.jobs.get(id)).map(JobRecord::progress).collect();
                drop(reply.send(jobs));
            }
            Input::Watch(id, reply) => drop(reply.send(self.jobs.get(&id).map(JobRecord::watch))),
            Input::Cancel(id, reply) => {
                self.event(Event::Cancelled { job: id });
                drop(reply.send(self.jobs.get(&id).map(JobRecord::progress)));
            }
            Input::Image(id, reply) => {
                drop(reply.send(self.jobs.get(&id).ok_or(NoImage::NoJob).and_then(JobRecord::image)));
            }
            Input::Film(id, reply) => drop(reply.send(self.jobs.get_mut(&id).and_then(|j| j.kept_film.take()))),
            Input::Workers(reply) => drop(reply.send(self.sessions.list(self.now(), &self.scheduler))),
            Input::Join(hello, reply) => {
                let threads = hello.threads;
                let joined = self.sessions.open(hello);
                let worker = joined.worker;
                self.event(Event::Joined { worker, threads });
                if reply.send(joined).is_err() {
                    self.event(Event::Lost { worker });
                }
            }
            Input::Message(worker, message) => self.message(worker, message),
            Input::Left(worker) => self.left(worker),
            Input::Offer(header, reply) => {
                let worker = self.sessions.worker(header.session);
                drop(reply.send(worker.and_then(|w| self.ticket(w, &header))));
            }
            Input::Refuse(ticket, error) => self.refuse(&ticket, error),
            Input::Complete(delivery, reply) => drop(reply.send(self.complete(*delivery))),
            Input::Source(session, digest, reply) => {
                let known = self.sessions.worker(session).is_some();
                drop(reply.send(known.then(|| self.source(digest)).flatten()));
            }
            Input::MapBuilt(id, built) => self.map_built(id, built),
            Input::Assembled(id, image) => self.assembled(id, image),
            // The loop has ended before it gets here.
            Input::Shutdown => {}
        }
    }

    fn submit(&mut self, spec: Spec) -> Result<JobId, SubmitError> {
        if let Some(job) = self.jobs.values().find(|j| j.request_key == spec.request_key) {
            return Ok(job.id);
        }
        let (needed, limit) = (spec.prepared.plan().coordinator_bytes, self.config.max_job_bytes);
        if needed > limit {
            return Err(SubmitError::Memory { needed, limit });
        }
        let live = self.jobs.values().filter(|j| !j.is_final()).count();
        if live >= self.config.max_live_jobs {
            return Err(SubmitError::Full(live));
        }
        let mut id = JobId(random_u64());
        while self.jobs.contains_key(&id) {
            id = JobId(random_u64());
        }
        let phases = spec.prepared.phases();
        tracing::info!(job = %id, name = spec.name, ?phases, "submitted");
        self.jobs.insert(id, JobRecord::new(id, spec, self.now()));
        self.order.push(id);
        self.event(Event::Submitted { job: id, phases });
        self.forget_old_jobs();
        Ok(id)
    }

    fn forget_old_jobs(&mut self) {
        let ended = |id: &JobId| self.jobs.get(id).is_some_and(JobRecord::is_final);
        let excess = self.order.iter().filter(|id| ended(id)).count().saturating_sub(MAX_ENDED_JOBS);
        let old: Vec<JobId> = self.order.iter().filter(|id| ended(id)).take(excess).copied().collect();
        self.order.retain(|id| !old.contains(id));
        self.jobs.retain(|id, _| !old.contains(id));
    }

    fn message(&mut self, worker: WorkerId, message: FromWorker) {
        let event = match message {
            FromWorker::Hello(_) | FromWorker::Heartbeat => Event::Heard { worker },
            FromWorker::TaskFailed { lease, attempt, error } => {
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

    fn ticket(&self, worker: WorkerId, header: &gatherlight_proto::message::DeliverHeader) -> Option<Ticket> {
        let open = self.scheduler.lease(header.lease)?;
        if !self.scheduler.is_open(worker, header.lease, header.attempt) {
            return None;
        }
        let job = self.jobs.get(&open.lease.job)?;
        Some(Ticket {
            worker,
            lease: header.lease,
            attempt: header.attempt,
            range: header.range,
            busy: header.busy,
            task: open.lease.task.clone(),
            grid: job.grid,
            channels: job.channels.len(),
            directions: match open.lease.task {
                Task::Emission(kind) => job.directions.contains(&kind),
                Task::Gather(_) => false,
            },
        })
    }

    fn refuse(&mut self, ticket: &Ticket, error: String) {
        let &Ticket { worker, lease, attempt, .. } = ticket;
        tracing::warn!(worker = worker.0, lease = lease.0, error, "result refused");
        self.event(Event::TaskFailed { worker, lease, attempt, error: format!("result refused: {error}") });
    }

    /// Offers a result to the scheduler and, where it counts, puts it to use.
    fn complete(&mut self, delivery: Delivery) -> bool {
        let Delivery { ticket, payload, bytes } = delivery;
        let Ticket { worker, lease, attempt, range, busy, task, .. } = ticket;
        let stored = match &payload {
            Payload::Photons(batch) => batch.len() as u64,
            Payload::Tiles(_) => 0,
        };
        let completed = Event::Completed { worker, lease, attempt, range, busy, stored };
        let commands = self.scheduler.handle(self.now(), completed);
        let accepted = commands.iter().find_map(|c| match c {
            Command::Accept { job, lease: l } if *l == lease => Some(*job),
            _ => None,
        });
        let used = accepted.map(|job| (job, self.put_to_use(job, &task, payload, busy, bytes)));
        self.carry_out(commands);
        match used {
            Some((job, Err(error))) => self.event(Event::StepFailed { job, error }),
            Some((job, Ok(()))) => self.refresh(job),
            None => tracing::debug!(worker = worker.0, lease = lease.0, "stale result discarded"),
        }
        accepted.is_some()
    }

    fn put_to_use(
        &mut self,
        id: JobId,
        task: &Task,
        payload: Payload,
        busy: Duration,
        bytes: u64,
    ) -> Result<(), String> {
        let job = self.jobs.get_mut(&id).ok_or("the job is gone")?;
        job.stats.busy += busy;
        job.stats.result_bytes += bytes;
        let live = job.live.as_mut().ok_or("the job has ended")?;
        match (payload, task) {
            (Payload::Photons(batch), Task::Emission(kind)) => {
                let merger = live.mergers.get_mut(kind).ok_or("its map is built already")?;
                merger.insert(batch).map_err(|e| e.to_string())
            }
            (Payload::Tiles(tiles), Task::Gather(_)) => {
                let film =
                    live.film.get_or_insert_with(|| Film::new(job.grid.width, job.grid.height, job.channels.clone()));
                for tile in &tiles {
                    film.insert(tile).map_err(|e| e.to_string())?;
                    job.stats.rays += tile.rays;
                    job.stats.non_finite += tile.non_finite;
                }
                Ok(())
            }
            _ => Err("a result is of another kind than its task".into()),
        }
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
                        let (scene, settings) = (j.manifest.clone(), Box::new(j.settings.clone()));
                        self.send(worker, ToWorker::Prepare { job, scene, settings });
                    }
                }
                Command::Assign { worker, lease } => self.send(worker, ToWorker::Lease(lease)),
                Command::Revoke { worker, lease } => self.send(worker, ToWorker::Revoke(lease)),
                Command::Forget { worker, job } => self.send(worker, ToWorker::Forget(job)),
                Command::Accept { .. } | Command::Discard { .. } => {}
                Command::BuildMap { job, kind } => self.build_map(job, kind),
                Command::Assemble { job } => self.assemble(job),
                Command::Finish { job, outcome } => {
                    tracing::info!(%job, ?outcome, "ended");
                    let now = self.now();
                    if let Some(j) = self.jobs.get_mut(&job) {
                        j.finish(now, outcome);
                    }
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

    fn build_map(&mut self, id: JobId, kind: MapKind) {
        let Some(live) = self.jobs.get_mut(&id).and_then(|j| j.live.as_mut()) else { return };
        let (Some(merger), Some(prepared)) = (live.mergers.remove(&kind), live.prepared.clone()) else { return };
        if live.mergers.is_empty() {
            live.prepared = None;
        }
        let (own, sink) = (self.own.clone(), self.config.map_sink.clone());
        self.compute.spawn(
            move || merge::build(kind, merger, &prepared, sink.as_ref()),
            move |built| report(&own, Input::MapBuilt(id, flat(built))),
        );
        self.refresh(id);
    }

    fn map_built(&mut self, id: JobId, built: Result<BuiltMap, String>) {
        let built = match built {
            Ok(built) => built,
            Err(error) => return self.event(Event::StepFailed { job: id, error }),
        };
        let Some(job) = self.jobs.get_mut(&id) else { return };
        let BuiltMap { map, bytes, stored_count, gather_radius } = built;
        job.about.gather_radii.insert(map.kind, gather_radius);
        job.stats.gather_radius = job.about.gather_radii.values().copied().reduce(f32::max);
        if let Some(stats) = job.map_stats(map.kind) {
            (stats.bytes, stats.stored_count) = (map.bytes, stored_count);
        }
        let Some(live) = job.live.as_mut() else { return };
        live.maps.push(ServedMap { digest: map.digest, bytes, sent: Arc::default() });
        tracing::info!(job = %id, map = map.kind.name(), bytes = map.bytes, photons = stored_count, "map built");
        self.event(Event::MapBuilt { job: id, map });
        self.refresh(id);
    }

    fn assemble(&mut self, id: JobId) {
        let Some(job) = self.jobs.get_mut(&id) else { return };
        let Some(live) = job.live.as_mut() else { return };
        let Some(film) = live.film.take() else { return };
        let metadata = job.about.metadata(&job.settings, &job.stats);
        let (own, store, keep) = (self.own.clone(), self.store.clone(), self.config.keep);
        self.compute.spawn(
            move || assemble::finish(film, &metadata, keep, &store),
            move |image| report(&own, Input::Assembled(id, flat(image))),
        );
        self.refresh(id);
    }

    fn assembled(&mut self, id: JobId, image: Result<Image, String>) {
        let Some(job) = self.jobs.get_mut(&id) else { return };
        match image {
            Ok(Image::Film(film, metadata)) => job.kept_film = Some((film, *metadata)),
            Ok(Image::Stored(blob)) => job.image = Some(blob),
            Err(error) => return self.event(Event::StepFailed { job: id, error }),
        }
        self.event(Event::Assembled { job: id });
    }

    /// Where this digest is: a map of a live job, or a blob of a live job's scene. Anything else is nobody's business.
    fn source(&self, digest: Digest) -> Option<Source> {
        let mut live = self.jobs.values().filter_map(|j| j.live.as_ref());
        live.find_map(|l| {
            let map = l.maps.iter().find(|m| m.digest == digest);
            let map = map.map(|m| Source::Map { bytes: m.bytes.clone(), sent: m.sent.clone() });
            map.or_else(|| l.blobs.contains(&digest).then_some(Source::Blob(digest)))
        })
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

/// From a compute thread to the driver, if it is still there.
fn report(own: &mpsc::WeakSender<Input>, input: Input) {
    if let Some(handle) = Handle::upgrade(own) {
        handle.report(input);
    }
}

/// A panic is a failure like others.
fn flat<T>(result: Result<Result<T, String>, Panicked>) -> Result<T, String> {
    result.unwrap_or_else(|panic| Err(panic.to_string()))
}

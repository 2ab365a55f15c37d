//! One session: carries out what the state machine says.

use super::{Connector, Remote};
use crate::cache::Cache;
use crate::config::{Faults, WorkerConfig};
use crate::counters::Counters;
use crate::error::{TaskError, is_final};
use crate::executor::Executor;
use crate::relay::{Listen, Relay};
use crate::session::{Action, Announced, Input, Session};
use crate::{emission, gather};
use bytes::Bytes;
use gatherlight_proto::Digest;
use gatherlight_proto::collective::Transfers;
use gatherlight_proto::connect::{Stamp, reason};
use gatherlight_proto::message::{DeliverHeader, FromWorker, Hello, Lease, RelayAddress, SessionKey, Task, ToWorker};
use gatherlight_render::job::Inputs;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Mutex, mpsc};
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, interval};
use tonic::{Status, Streaming};

/// Messages to the coordinator that may wait.
const QUEUE: usize = 64;

/// How a session ended.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Ended {
    /// As asked.
    Left,
    /// The coordinator will not have us.
    Refused(String),
    /// It was there and broke.
    Broken(String),
    /// It never began.
    NotReached(String),
}

/// What a worker keeps from session to session.
pub(super) struct Life {
    config: WorkerConfig,
    executor: Executor,
    cache: Arc<Mutex<Cache>>,
    relay: Relay,
    /// Where others reach it, once it listens.
    relay_address: Option<RelayAddress>,
    /// Emission, bootstrap, splat and gather tasks begun, for tests that kill by number.
    begun: [u64; 4],
}

/// One session's moving parts.
struct Joined {
    remote: Remote,
    outbound: mpsc::Sender<FromWorker>,
    inputs: mpsc::Sender<Input>,
    /// Heartbeats, computations, deliveries; they end with the session.
    tasks: JoinSet<()>,
}

impl Life {
    pub(super) fn new(config: WorkerConfig, executor: Executor) -> Self {
        let cache = Arc::new(Mutex::new(Cache::new(config.memory_bytes, config.shared.clone())));
        let relay = Relay::new(config.memory_bytes, config.versions.clone());
        Life { config, executor, cache, relay, relay_address: None, begun: [0; 4] }
    }

    /// Begins to listen for other workers, unless it does or should not. A worker that cannot fetches from the coordinator.
    async fn listen(&mut self, connector: &Connector) {
        let (Some(host), None) = (&connector.host, self.relay_address) else { return };
        // What others fetch from here is not encrypted: where the coordinator's connections are, only on request.
        if connector.credentials.tls().is_some() && self.config.relay == Listen::Auto {
            return;
        }
        match self.relay.listen(self.config.relay, host, self.config.counters.clone()).await {
            Ok(address) => self.relay_address = address,
            Err(error) => tracing::warn!(%error, "cannot listen for other workers"),
        }
    }

    /// Connects, joins and works until the session ends.
    pub(super) async fn session(
        &mut self,
        connector: &Connector,
        mut shutdown: Pin<&mut (impl Future<Output = ()> + Send)>,
    ) -> Ended {
        self.listen(connector).await;
        let (outbound, messages) = mpsc::channel(QUEUE);
        let hello = Hello {
            name: self.config.name.clone(),
            threads: self.executor.threads() as u32,
            memory_bytes: self.config.memory_bytes,
            relay: self.relay_address,
        };
        drop(outbound.try_send(FromWorker::Hello(hello)));
        let stamp = Stamp::new(self.config.versions.clone(), &connector.credentials);
        let relay = self.relay.clone();
        let joining = async {
            let channel = (connector.open)().await.map_err(|e| Ended::NotReached(reason(&e)))?;
            let mut remote = Remote::new(channel, stamp, relay, self.config.counters.clone());
            match remote.join(messages).await {
                Ok(inbound) => Ok((remote, inbound)),
                Err(status) if is_final(&status) => Err(Ended::Refused(status.message().into())),
                Err(status) => Err(Ended::NotReached(status.message().into())),
            }
        };
        let (remote, inbound) = tokio::select! {
            joined = joining => match joined {
                Ok(joined) => joined,
                Err(ended) => return ended,
            },
            // Nothing is begun yet, so nothing has to be finished.
            () = &mut shutdown => return Ended::Left,
        };
        let (inputs, events) = mpsc::channel(QUEUE);
        let joined = Joined { remote, outbound, inputs, tasks: JoinSet::new() };
        let ended = self.work(joined, inbound, events, shutdown).await;
        self.config.counters.set_joined(false);
        // Another session's coordinator announces its jobs again; scene files stay.
        self.cache.lock().await.forget_all();
        self.relay.end_session();
        ended
    }

    async fn work(
        &mut self,
        mut joined: Joined,
        mut inbound: Streaming<gatherlight_proto::wire::CoordinatorMessage>,
        mut events: mpsc::Receiver<Input>,
        mut shutdown: Pin<&mut (impl Future<Output = ()> + Send)>,
    ) -> Ended {
        let mut session = Session::default();
        let mut draining = false;
        loop {
            let input = tokio::select! {
                message = inbound.message() => match received(message) {
                    Ok(message) => Input::Message(message),
                    // Whoever is asked to stop and is let go has left.
                    Err(_) if draining => return Ended::Left,
                    Err(ended) => return ended,
                },
                Some(event) = events.recv() => event,
                () = &mut shutdown, if !draining => {
                    draining = true;
                    Input::Drain
                }
            };
            for action in session.handle(input) {
                if let Some(ended) = self.carry_out(action, &mut joined).await {
                    return ended;
                }
            }
        }
    }

    async fn carry_out(&mut self, action: Action, joined: &mut Joined) -> Option<Ended> {
        match action {
            Action::Welcomed { session, heartbeat } => {
                tracing::info!(name = self.config.name, "joined");
                self.config.counters.set_joined(true);
                joined.remote = joined.remote.in_session(session);
                joined.tasks.spawn(beat(joined.outbound.clone(), heartbeat));
            }
            Action::Begin(lease, job) => {
                if self.dies_at(&lease) {
                    return Some(Ended::Left);
                }
                joined.tasks.spawn(task(
                    Tools {
                        remote: joined.remote.clone(),
                        executor: self.executor.clone(),
                        cache: self.cache.clone(),
                        counters: self.config.counters.clone(),
                        faults: self.config.faults.clone(),
                    },
                    lease,
                    *job,
                    joined.inputs.clone(),
                ));
                // Finished tasks are collected now and then, so that they do not pile up.
                while joined.tasks.try_join_next().is_some() {}
            }
            Action::Send(message) => {
                if joined.outbound.send(message).await.is_err() {
                    return Some(Ended::Broken("the coordinator stopped listening".into()));
                }
            }
            Action::Forget(job) => {
                let cache = self.cache.clone();
                joined.tasks.spawn(async move { cache.lock().await.forget(job) });
            }
            Action::Announce(route) => joined.remote.announce(route),
            Action::Close => return Some(Ended::Left),
        }
        None
    }

    fn dies_at(&mut self, lease: &Lease) -> bool {
        let faults = &self.config.faults;
        let (kind, limit) = match lease.task {
            Task::Emission { .. } => (0, faults.die_at_emission),
            Task::Bootstrap => (1, faults.die_at_bootstrap),
            Task::Splat { .. } => (2, faults.die_at_splat),
            Task::Gather { .. } => (3, faults.die_at_gather),
        };
        let number = self.begun[kind];
        self.begun[kind] += 1;
        limit == Some(number)
    }
}

fn received(message: Result<Option<gatherlight_proto::wire::CoordinatorMessage>, Status>) -> Result<ToWorker, Ended> {
    match message {
        Ok(Some(message)) => ToWorker::try_from(message).map_err(|e| Ended::Broken(e.to_string())),
        Ok(None) => Err(Ended::Broken("the coordinator ended the session".into())),
        Err(status) if is_final(&status) => Err(Ended::Refused(status.message().into())),
        Err(status) => Err(Ended::Broken(status.message().into())),
    }
}

async fn beat(outbound: mpsc::Sender<FromWorker>, period: Duration) {
    let mut ticks = interval(period);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        if outbound.send(FromWorker::Heartbeat).await.is_err() {
            return;
        }
    }
}

/// What a task works with.
struct Tools {
    remote: Remote,
    executor: Executor,
    cache: Arc<Mutex<Cache>>,
    counters: Arc<Counters>,
    faults: Faults,
}

/// One lease, from beginning to receipt.
async fn task(tools: Tools, lease: Lease, job: Announced, inputs: mpsc::Sender<Input>) {
    let id = lease.id;
    let (payload, busy, fetched) = match compute(&tools, &lease, &job).await {
        Ok((payload, busy, fetched)) => {
            let slowness = tools.faults.slowness(&lease);
            tokio::time::sleep(slowness).await;
            (payload, busy + slowness, fetched)
        }
        Err(error) => {
            tracing::warn!(lease = id.0, %error, "task failed");
            tools.counters.tasks_failed.add(1);
            drop(inputs.send(Input::ComputeFailed(id, error.to_string())).await);
            return;
        }
    };
    tools.counters.tasks_done.add(1);
    tools.counters.add_busy(busy);
    // From here on the next lease may be computed.
    drop(inputs.send(Input::Computed(id)).await);
    let (bytes, digest) = (payload.len() as u64, Digest::of(&payload));
    let (session, attempt, range) = (SessionKey([0; 16]), lease.attempt, lease.range);
    let header = DeliverHeader { session, lease: id, attempt, range, busy, bytes, digest, fetched };
    let input = match deliver(&tools, header, payload).await {
        Ok(accepted) => {
            tracing::debug!(lease = id.0, accepted, "delivered");
            tools.counters.results_delivered.add(1);
            tools.counters.delivered_bytes.add(bytes);
            Input::Delivered(id)
        }
        Err(error) => {
            tracing::warn!(lease = id.0, %error, "result not delivered");
            tools.counters.results_failed.add(1);
            Input::DeliveryFailed(id, error.to_string())
        }
    };
    drop(inputs.send(input).await);
}

/// A lease's result, the time it was computed for, and what was fetched for it.
async fn compute(tools: &Tools, lease: &Lease, job: &Announced) -> Result<(Bytes, Duration, Transfers), TaskError> {
    let Tools { remote, executor, cache, faults, .. } = tools;
    if faults.delay > Duration::ZERO {
        tokio::time::sleep(faults.delay).await;
    }
    if let Some(text) = &faults.fail {
        return Err(TaskError::Panicked(text.clone()));
    }
    // Held while loading, so that nothing is loaded twice; not while computing.
    let mut held = cache.lock().await;
    let prepared = held.prepared(lease.job, job, remote, executor).await?;
    let mut inputs = Inputs::default();
    match &lease.task {
        Task::Emission { .. } | Task::Bootstrap => {}
        Task::Splat { bootstrap, .. } => {
            if let Some(wanted) = *bootstrap {
                inputs.bootstrap = Some(held.bootstrap(lease.job, wanted, &prepared, remote, executor).await?);
            }
        }
        Task::Gather { maps, sample_map, .. } => {
            inputs.maps = held.maps(lease.job, maps, remote, executor).await?;
            if let Some(wanted) = *sample_map {
                inputs.sample_map = Some(held.sample_map(lease.job, wanted, &prepared, remote).await?);
            }
        }
    }
    let fetched = held.take_fetched();
    drop(held);
    let range = lease.range;
    let (payload, busy) = match lease.task {
        Task::Emission { round, map } => executor.run(move || emission::compute(&prepared, round, map, range)).await?,
        Task::Bootstrap => executor.run(move || emission::compute_bootstrap(&prepared, range)).await?,
        Task::Splat { round, .. } => {
            executor.run(move || gather::compute_splat(&prepared, &inputs, round, range)).await??
        }
        Task::Gather { round, .. } => executor.run(move || gather::compute(&prepared, &inputs, round, range)).await?,
    };
    Ok((payload, busy, fetched))
}

async fn deliver(tools: &Tools, header: DeliverHeader, payload: Bytes) -> Result<bool, TaskError> {
    let sent = match tools.faults.corrupt {
        false => payload,
        true => {
            let mut bytes = payload.to_vec();
            bytes.iter_mut().take(1).for_each(|b| *b ^= 1);
            bytes.into()
        }
    };
    let accepted = tools.remote.deliver(header, sent.clone()).await?;
    if tools.faults.deliver_twice {
        tools.remote.deliver(header, sent).await?;
    }
    Ok(accepted)
}

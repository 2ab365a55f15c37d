//! Open sessions of workers: who they are and how to reach them. What they do is the scheduler's.

use super::handle::Joined;
use crate::random::random_bytes;
use crate::schedule::Scheduler;
use crate::types::WorkerInfo;
use gatherlight_proto::message::{Hello, SessionKey, ToWorker, WorkerId};
use std::collections::{BTreeMap, HashMap};
use std::net::SocketAddr;
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};

/// Messages waiting for one worker before it is taken for stuck. It holds two leases at most, so this many never wait
/// for one that reads.
const QUEUE: usize = 1_024;

struct Session {
    secret: SessionKey,
    hello: Hello,
    messages: mpsc::Sender<ToWorker>,
    /// Dropped with the session, which tells the service to end the stream.
    _alive: oneshot::Sender<()>,
}

/// All open sessions.
pub(super) struct Sessions {
    heartbeat: Duration,
    by_worker: BTreeMap<WorkerId, Session>,
    by_secret: HashMap<SessionKey, WorkerId>,
    last: u64,
}

impl Sessions {
    pub(super) fn new(heartbeat: Duration) -> Self {
        Sessions { heartbeat, by_worker: BTreeMap::new(), by_secret: HashMap::new(), last: 0 }
    }
    /// Opens a session and sends the welcome.
    pub(super) fn open(&mut self, hello: Hello) -> Joined {
        self.last += 1;
        let worker = WorkerId(self.last);
        let secret = SessionKey(random_bytes());
        let (messages, receiver) = mpsc::channel(QUEUE);
        let (alive, dismissed) = oneshot::channel();
        tracing::info!(worker = worker.0, name = hello.name, threads = hello.threads, "joined");
        self.by_secret.insert(secret, worker);
        self.by_worker.insert(worker, Session { secret, hello, messages, _alive: alive });
        self.send(worker, ToWorker::Welcome { worker, session: secret, heartbeat: self.heartbeat });
        Joined { worker, messages: receiver, dismissed }
    }
    /// Ends a session; returns whether it was open.
    pub(super) fn close(&mut self, worker: WorkerId) -> bool {
        let gone = self.by_worker.remove(&worker);
        gone.map(|s| self.by_secret.remove(&s.secret)).is_some()
    }
    /// Queues a message; returns whether there is room for it.
    pub(super) fn send(&mut self, worker: WorkerId, message: ToWorker) -> bool {
        self.by_worker.get(&worker).is_none_or(|s| s.messages.try_send(message).is_ok())
    }
    /// The worker whose session has this secret name.
    pub(super) fn worker(&self, secret: SessionKey) -> Option<WorkerId> {
        self.by_secret.get(&secret).copied()
    }
    /// The name a worker gave itself.
    pub(super) fn name(&self, worker: WorkerId) -> String {
        self.by_worker.get(&worker).map_or_else(|| format!("worker {}", worker.0), |s| s.hello.name.clone())
    }
    /// Whether this session is open.
    pub(super) fn is_open(&self, worker: WorkerId) -> bool {
        self.by_worker.contains_key(&worker)
    }
    /// Workers that relay and may use at least `bytes` of memory, in the order in which they joined.
    pub(super) fn relays(&self, bytes: u64) -> Vec<(WorkerId, SocketAddr)> {
        let can = self.by_worker.iter().filter(|(_, s)| s.hello.memory_bytes >= bytes);
        can.filter_map(|(&id, s)| Some((id, s.hello.relay?.address))).collect()
    }
    /// Whether this worker relays.
    pub(super) fn relays_itself(&self, worker: WorkerId) -> bool {
        self.by_worker.get(&worker).is_some_and(|s| s.hello.relay.is_some())
    }
    /// For listings.
    pub(super) fn list(&self, now: Duration, scheduler: &Scheduler) -> Vec<WorkerInfo> {
        let limit = scheduler.policy().set_aside_after;
        let info = |(&id, session): (&WorkerId, &Session)| {
            let worker = scheduler.workers().get(&id)?;
            let state = match worker {
                w if w.draining => "draining",
                w if w.is_set_aside_somewhere(limit) => "set aside",
                w if w.leases.is_empty() => "idle",
                _ => "working",
            };
            Some(WorkerInfo {
                id: id.0,
                name: session.hello.name.clone(),
                threads: session.hello.threads,
                memory_bytes: session.hello.memory_bytes,
                state: state.to_owned(),
                leases: worker.leases.len() as u32,
                completed: worker.completed,
                last_heard: now.saturating_sub(worker.last_heard),
                joined: now.saturating_sub(worker.joined),
            })
        };
        self.by_worker.iter().filter_map(info).collect()
    }
}

//! A real coordinator and real workers in this process, over TCP.

use gatherlight::client::{self, Client, SubmitRequest};
use gatherlight::schedule::Policy;
use gatherlight::server::{ServeConfig, Server};
use gatherlight::types::{JobId, JobProgress, JobState, Limits};
use gatherlight_render::import::SceneBundle;
use gatherlight_render::settings::RenderSettings;
use gatherlight_worker::{Connector, Faults, WorkerConfig, WorkerError};
use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio_stream::StreamExt;

/// Longest time any of these tests waits for anything.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// Leases of a few milliseconds, so that every worker gets some of every phase of a small job.
pub fn small_leases() -> Policy {
    Policy {
        target_lease: Duration::from_millis(5),
        probe_paths: 300,
        min_paths: 100,
        max_paths: 1_000,
        max_tiles: 2,
        ..Policy::default()
    }
}

/// A job of a second or so.
pub fn small_settings() -> RenderSettings {
    RenderSettings {
        width: 72,
        height: 56,
        samples: 2,
        photons: 20_000,
        caustic_photons: 30_000,
        k: 20,
        ..RenderSettings::default()
    }
}

/// A running coordinator. Dropped, it goes without a word, as if killed.
pub struct Coordinator {
    /// Where it listens.
    pub address: SocketAddr,
    /// Where it serves metrics, if it does.
    pub metrics: Option<SocketAddr>,
    stop: Option<oneshot::Sender<()>>,
    task: JoinHandle<()>,
}

impl Coordinator {
    /// On a free port of this machine, with its store in `directory`.
    ///
    /// # Panics
    /// When it cannot be started.
    pub async fn start(directory: &Path, policy: Policy) -> Self {
        Self::start_on("127.0.0.1:0".parse().expect("an address"), directory, policy).await
    }
    /// On a given address.
    ///
    /// # Panics
    /// When it cannot be started.
    pub async fn start_on(address: SocketAddr, directory: &Path, policy: Policy) -> Self {
        Self::start_with(ServeConfig { threads: 1, policy, ..ServeConfig::new(address, directory.to_owned()) }).await
    }
    /// As configured.
    ///
    /// # Panics
    /// When it cannot be started.
    pub async fn start_with(config: ServeConfig) -> Self {
        let server = Server::bind(config).await.unwrap_or_else(|e| panic!("{e}"));
        let (address, metrics) = (server.local_addr(), server.metrics_addr());
        let (stop, stopped) = oneshot::channel::<()>();
        let task = tokio::spawn(async move {
            let shutdown = async { drop(stopped.await) };
            server.run(shutdown).await.unwrap_or_else(|e| panic!("{e}"));
        });
        Coordinator { address, metrics, stop: Some(stop), task }
    }
    /// Its URL.
    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }
    /// Its URL, where connections are encrypted.
    pub fn encrypted_url(&self) -> String {
        format!("https://localhost:{}", self.address.port())
    }
    /// A client of it.
    ///
    /// # Panics
    /// When it does not answer.
    pub async fn client(&self) -> Client {
        client::connect(&self.url(), 3).await.unwrap_or_else(|e| panic!("{e}"))
    }
    /// Adds a worker with one thread.
    pub fn worker(&self, name: &str, faults: Faults) -> Worker {
        let config = WorkerConfig { threads: 1, faults, ..WorkerConfig::new(name) };
        self.worker_with(config)
    }
    /// Adds a worker.
    ///
    /// # Panics
    /// When the URL makes no sense.
    pub fn worker_with(&self, config: WorkerConfig) -> Worker {
        let connector = Connector::url(&self.url()).unwrap_or_else(|e| panic!("{e}"));
        Worker::start(config, connector)
    }
    /// Asks it to stop and waits until it has.
    ///
    /// # Panics
    /// When it failed.
    pub async fn stop(mut self) {
        drop(self.stop.take());
        let ended = tokio::time::timeout(PATIENCE, &mut self.task).await;
        ended.expect("stops in time").expect("did not panic");
    }
}

impl Drop for Coordinator {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// A running worker. Dropped, it goes without a word.
pub struct Worker {
    stop: Option<oneshot::Sender<()>>,
    task: JoinHandle<Result<(), WorkerError>>,
}

impl Worker {
    /// Lets it join wherever `connector` leads.
    pub fn start(config: WorkerConfig, connector: Connector) -> Self {
        let (stop, stopped) = oneshot::channel::<()>();
        let shutdown = async { drop(stopped.await) };
        let task = tokio::spawn(gatherlight_worker::run(config, connector, shutdown));
        Worker { stop: Some(stop), task }
    }
    /// Asks it to leave, and waits until it has.
    ///
    /// # Errors
    /// Why it had stopped.
    ///
    /// # Panics
    /// When it takes too long.
    pub async fn leave(mut self) -> Result<(), WorkerError> {
        drop(self.stop.take());
        self.ended().await
    }
    /// Waits until it stops by itself.
    ///
    /// # Errors
    /// Why it stopped.
    ///
    /// # Panics
    /// When it takes too long.
    pub async fn ended(&mut self) -> Result<(), WorkerError> {
        let ended = tokio::time::timeout(PATIENCE, &mut self.task).await;
        ended.expect("ends in time").expect("did not panic")
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// A request to render `bundle`.
pub fn request(bundle: &SceneBundle, settings: &RenderSettings) -> SubmitRequest {
    let limits = Limits::default();
    SubmitRequest { name: bundle.name.clone(), bundle: bundle.clone(), settings: settings.clone(), limits, priority: 0 }
}

/// Watches a job until `enough` is seen.
///
/// # Panics
/// When the job ends before, or it takes too long.
pub async fn watch_until(client: &Client, id: JobId, enough: impl Fn(&JobProgress) -> bool) -> JobProgress {
    let watching = async {
        let mut stream = client.watch(id).await.unwrap_or_else(|e| panic!("{e}"));
        let mut last = None;
        while let Some(snapshot) = stream.next().await {
            let snapshot = snapshot.unwrap_or_else(|e| panic!("{e}"));
            if enough(&snapshot) {
                return snapshot;
            }
            last = Some(snapshot);
        }
        panic!("the job ended before: {last:?}");
    };
    tokio::time::timeout(PATIENCE, watching).await.expect("is seen in time")
}

/// Waits for a job's final state.
///
/// # Panics
/// When it takes too long.
pub async fn final_state(client: &Client, id: JobId) -> JobProgress {
    watch_until(client, id, |p| p.state.is_final()).await
}

/// Waits until a job is done and fetches its EXR.
///
/// # Panics
/// When it ends otherwise, or takes too long.
pub async fn finished_exr(client: &Client, id: JobId) -> Vec<u8> {
    let last = final_state(client, id).await;
    assert_eq!(last.state, JobState::Done);
    let image = client.fetch(id, |_, _| {}).await.unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(Some(image.digest), last.result_digest.map(|d| d.to_string()));
    image.exr.to_vec()
}

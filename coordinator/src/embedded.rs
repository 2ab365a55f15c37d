//! A whole job in this process: the cluster's own coordinator and workers, joined by in-memory streams. The only file
//! here that knows the worker.

use crate::access::Access;
use crate::compute::Compute;
use crate::counters::Counters;
use crate::driver::{Driver, DriverConfig, Handle, KeepImage, Sink, Spec};
use crate::manifest;
use crate::random::random_bytes;
use crate::room::Rooms;
use crate::schedule::Policy;
use crate::server::DEFAULT_RESULT_BYTES;
use crate::service::{self, Context};
use crate::store::Store;
use crate::types::{JobId, JobProgress, JobResult, JobState, Limits};
use gatherlight_proto::Digest;
use gatherlight_proto::connect::tuned;
use gatherlight_proto::limits::HEARTBEAT;
use gatherlight_proto::message::Submission;
use gatherlight_render::film::SampleMap;
use gatherlight_render::import::SceneBundle;
use gatherlight_render::integrator::Bootstrap;
use gatherlight_render::job::{PhotonMap, PreparedJob};
use gatherlight_render::settings::RenderSettings;
use gatherlight_worker::{Connector, Faults, Shared, WorkerConfig};
use hyper_util::rt::TokioIo;
use std::io;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::DuplexStream;
use tokio::runtime::Runtime;
use tokio::sync::mpsc;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::Endpoint;
use tower::service_fn;

/// Bytes in flight between coordinator and worker, each way: half a chunk.
const PIPE_BYTES: usize = 1 << 20;
/// Least time between two calls of a progress callback.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(100);

/// Where and how long to compute; cannot change the image but for the rounds or units that a limit leaves out.
#[derive(Clone, Debug)]
pub struct Config {
    /// Compute threads of each worker; 0: one per core.
    pub threads: usize,
    /// Workers, ≥ 1.
    pub workers: usize,
    /// The scheduler's constants.
    pub policy: Policy,
    /// When to end the job early.
    pub limits: Limits,
    /// Misbehaviour of the workers, by number, for tests.
    pub faults: Vec<Faults>,
}

/// What workers of this process read, shared with them.
struct InProcess(Shared);

impl Sink for InProcess {
    fn offer_map(&self, digest: Digest, map: Arc<PhotonMap>) {
        self.0.offer_map(digest, map);
    }
    fn offer_bootstrap(&self, digest: Digest, bootstrap: Arc<Bootstrap>) {
        self.0.offer_bootstrap(digest, bootstrap);
    }
    fn offer_sample_map(&self, digest: Digest, map: Arc<SampleMap>) {
        self.0.offer_sample_map(digest, map);
    }
    fn withdraw(&self, digest: Digest) {
        self.0.withdraw(digest);
    }
}

impl Default for Config {
    fn default() -> Self {
        let (policy, limits) = (Policy::default(), Limits::default());
        Config { threads: 0, workers: 1, policy, limits, faults: Vec::new() }
    }
}

/// Why an embedded render did not finish.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The scene or a setting is at fault.
    #[error(transparent)]
    Job(#[from] gatherlight_render::job::JobError),
    /// The job was not taken; the text says why.
    #[error("{0}")]
    Refused(String),
    /// The job failed; the text says why.
    #[error("{0}")]
    Failed(String),
    /// Threads or the in-memory cluster could not be started.
    #[error("cannot start: {0}")]
    Start(String),
}

/// Renders `bundle` with `settings` and blocks until done. `progress` is called at most ten times a second, on the
/// caller's thread, and last with the final state. Not to be called from async code.
///
/// # Errors
/// When the scene or the settings make no sense, or the work failed.
pub fn render(
    bundle: &SceneBundle,
    settings: &RenderSettings,
    config: &Config,
    progress: impl FnMut(&JobProgress) + Send,
) -> Result<JobResult, RenderError> {
    let prepared = Arc::new(PreparedJob::prepare(bundle, settings)?);
    render_prepared(bundle, prepared, config, progress)
}

/// As [`render`], with the scene prepared from `bundle` already.
///
/// # Errors
/// When the work failed.
pub fn render_prepared(
    bundle: &SceneBundle,
    prepared: Arc<PreparedJob>,
    config: &Config,
    progress: impl FnMut(&JobProgress) + Send,
) -> Result<JobResult, RenderError> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        // For waiting and copying; the compute threads are others.
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(|e| RenderError::Start(e.to_string()))?;
    let result = runtime.block_on(rendered(&runtime, bundle, prepared, config, progress));
    runtime.shutdown_background();
    result
}

async fn rendered(
    runtime: &Runtime,
    bundle: &SceneBundle,
    prepared: Arc<PreparedJob>,
    config: &Config,
    progress: impl FnMut(&JobProgress) + Send,
) -> Result<JobResult, RenderError> {
    let compute = Compute::new(config.threads).map_err(RenderError::Start)?;
    let counters = Arc::new(Counters::default());
    let shared = Shared::default();
    let driver_config = DriverConfig {
        // Nobody else will turn up in this process.
        policy: Policy { patience: Duration::ZERO, ..config.policy.clone() },
        max_live_jobs: 1,
        // It is the caller's own memory, and `plan` has told what it takes.
        max_job_bytes: u64::MAX,
        keep: KeepImage::Film,
        counters: counters.clone(),
        heartbeat: HEARTBEAT,
        sink: Some(Arc::new(InProcess(shared.clone()))),
    };
    let store = Arc::new(Store::memory());
    let driver = Driver::start(driver_config, compute.clone(), store.clone());
    let spec = spec(bundle, prepared, config.limits);
    shared.offer_scene(spec.submission.manifest.clone(), spec.submission.settings.clone(), spec.prepared.clone());
    let job = driver.submit(spec).await.map_err(|e| RenderError::Refused(e.to_string()))?;
    let rooms = Rooms::new(DEFAULT_RESULT_BYTES);
    let context = Context { driver: driver.clone(), compute, store, rooms, access: Access::Open, counters };
    start_cluster(runtime, context, config, &shared).await;
    let last = follow(&driver, job, progress).await?;
    match last.state {
        JobState::Done => {}
        JobState::Failed(error) => return Err(RenderError::Failed(error)),
        state => return Err(RenderError::Failed(format!("the job ended as {}", state.name()))),
    }
    let (film, metadata) = driver.film(job).await.ok_or_else(|| RenderError::Failed("the image is gone".into()))?;
    Ok(JobResult { film, metadata, stats: last.stats, elapsed: last.elapsed })
}

fn spec(bundle: &SceneBundle, prepared: Arc<PreparedJob>, limits: Limits) -> Spec {
    let (name, settings) = (bundle.name.clone(), prepared.settings().clone());
    let (manifest, _) = manifest::pack(bundle);
    let submission = Submission { name, request_key: random_bytes(), limits, ..Submission::new(manifest, settings) };
    Spec { submission, owner: String::new(), prepared }
}

/// The coordinator's services and the workers, joined by pipes.
async fn start_cluster(runtime: &Runtime, context: Context, config: &Config, shared: &Shared) {
    let (pipes, incoming) = mpsc::channel::<DuplexStream>(config.workers.max(1));
    let router = service::router(service::server(), context).await;
    let incoming = ReceiverStream::new(incoming).map(Ok::<_, io::Error>);
    runtime.spawn(async move {
        if let Err(error) = router.serve_with_incoming(incoming).await {
            tracing::error!(%error, "the in-process coordinator stopped");
        }
    });
    for number in 0..config.workers.max(1) {
        let worker = WorkerConfig {
            threads: config.threads,
            memory_bytes: u64::MAX,
            shared: shared.clone(),
            faults: config.faults.get(number).cloned().unwrap_or_default(),
            ..WorkerConfig::new(format!("local-{number}"))
        };
        let connector = in_memory(pipes.clone());
        runtime.spawn(async move {
            if let Err(error) = gatherlight_worker::run(worker, connector, std::future::pending()).await {
                tracing::error!(number, %error, "an in-process worker stopped");
            }
        });
    }
}

/// Connects by making a pipe and handing its other end to the coordinator.
fn in_memory(pipes: mpsc::Sender<DuplexStream>) -> Connector {
    Connector::custom("this process", move || {
        let pipes = pipes.clone();
        Box::pin(async move {
            let connect = service_fn(move |_| {
                let pipes = pipes.clone();
                async move {
                    let (near, far) = tokio::io::duplex(PIPE_BYTES);
                    let gone = |_| io::Error::new(io::ErrorKind::ConnectionRefused, "the coordinator is gone");
                    pipes.send(far).await.map_err(gone)?;
                    Ok::<_, io::Error>(TokioIo::new(near))
                }
            });
            tuned(Endpoint::from_static("http://in-memory")).connect_with_connector(connect).await
        })
    })
}

/// Reports progress until the job has ended.
async fn follow(
    driver: &Handle,
    job: JobId,
    mut progress: impl FnMut(&JobProgress) + Send,
) -> Result<JobProgress, RenderError> {
    let gone = || RenderError::Failed("the in-process coordinator is gone".into());
    let mut watched = driver.watch(job).await.ok_or_else(gone)?;
    loop {
        let snapshot = watched.borrow_and_update().clone();
        progress(&snapshot);
        if snapshot.state.is_final() {
            return Ok(snapshot);
        }
        // Fresh snapshots that come sooner are seen together; the last one is not waited for.
        let pause = tokio::time::sleep(PROGRESS_INTERVAL);
        let ended = watched.wait_for(|p| p.state.is_final());
        tokio::select! {
            ended = ended => drop(ended.map_err(|_| gone())?),
            () = pause => {}
        }
    }
}

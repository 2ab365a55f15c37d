//! A coordinator that listens for workers and clients.

use crate::access::AccessConfig;
use crate::compute::Compute;
use crate::counters::Counters;
use crate::driver::{Driver, DriverConfig, KeepImage};
use crate::metrics;
use crate::room::Rooms;
use crate::schedule::Policy;
use crate::service::{self, CONNECTIONS, Context};
use crate::store::Store;
use gatherlight_proto::connect::reason;
use gatherlight_proto::limits::HEARTBEAT;
use gatherlight_proto::serve::Incoming;
use std::future::Future;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tonic::transport::ServerTlsConfig;

/// Time open streams have to end once shutdown has begun.
const SHUTDOWN_GRACE: Duration = Duration::from_secs(2);

/// Memory for results that are not merged yet, unless told otherwise.
pub const DEFAULT_RESULT_BYTES: u64 = 1 << 30;

/// Where and how a coordinator runs; cannot change an image.
#[derive(Clone, Debug)]
pub struct ServeConfig {
    /// Address to listen on; port 0 takes a free one.
    pub listen: SocketAddr,
    /// Directory of scene blobs and finished images; made if missing.
    pub store: PathBuf,
    /// Whether jobs go on after a restart. Without, no result is written to the disk: to measure what that costs.
    pub journal: bool,
    /// Compute threads for merging and encoding; 0: one per core.
    pub threads: usize,
    /// Most bytes of scene blobs and results kept in the store.
    pub max_store_bytes: u64,
    /// Most jobs that are not yet finished.
    pub max_live_jobs: usize,
    /// Most memory one job may need of the coordinator, by its plan.
    pub max_job_bytes: u64,
    /// Most memory for results that have come in, or are coming, and are not merged yet; senders wait for room.
    pub max_result_bytes: u64,
    /// The scheduler's constants.
    pub policy: Policy,
    /// What workers and clients have to prove.
    pub access: AccessConfig,
    /// Address of the metrics; none: they are not served.
    pub metrics: Option<SocketAddr>,
}

impl ServeConfig {
    /// Defaults beside the two that have none.
    pub fn new(listen: SocketAddr, store: PathBuf) -> Self {
        ServeConfig {
            listen,
            store,
            journal: true,
            threads: 0,
            max_store_bytes: 64 << 30,
            max_live_jobs: 64,
            max_job_bytes: 16 << 30,
            max_result_bytes: DEFAULT_RESULT_BYTES,
            policy: Policy::default(),
            access: AccessConfig::default(),
            metrics: None,
        }
    }
}

/// Why a coordinator could not start or go on.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The address is taken, not ours, or not allowed.
    #[error("cannot listen on {address}: {source}")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The system's reason.
        source: std::io::Error,
    },
    /// Whoever connects would have to prove nothing, or a token file or certificate makes no sense.
    #[error("{0}")]
    Access(String),
    /// The store's directory cannot be used.
    #[error("cannot use {} as the store: {source}", path.display())]
    Store {
        /// The directory.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// Threads could not be started.
    #[error("cannot start: {0}")]
    Start(String),
    /// The transport failed while serving.
    #[error("serving failed: {0}")]
    Transport(String),
}

/// A coordinator bound to its address, not yet serving.
#[derive(Debug)]
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    tls: Option<ServerTlsConfig>,
    metrics: Option<TcpListener>,
    context: Context,
}

impl Server {
    /// Opens the store, binds the address and starts the driver.
    ///
    /// # Errors
    /// When store, address or threads cannot be had.
    pub async fn bind(config: ServeConfig) -> Result<Self, ServeError> {
        let (access, tls) = config.access.open(config.listen).map_err(ServeError::Access)?;
        let store_error = |source| ServeError::Store { path: config.store.clone(), source };
        let open = if config.journal { Store::open } else { Store::without_journal };
        let store = open(&config.store, config.max_store_bytes).map_err(store_error)?;
        let compute = Compute::new(config.threads).map_err(ServeError::Start)?;
        let (listener, address) = listen(config.listen).await?;
        let metrics = match config.metrics {
            Some(address) => Some(listen(address).await?.0),
            None => None,
        };
        let counters = Arc::new(Counters::default());
        let store = Arc::new(store);
        let driver_config = DriverConfig {
            policy: config.policy.clone(),
            max_live_jobs: config.max_live_jobs,
            max_job_bytes: config.max_job_bytes,
            keep: KeepImage::Exr,
            counters: counters.clone(),
            heartbeat: HEARTBEAT,
            sink: None,
        };
        let driver = Driver::start(driver_config, compute.clone(), store.clone());
        let rooms = Rooms::new(config.max_result_bytes);
        let context = Context { driver, compute, store, rooms, access, counters };
        Ok(Server { listener, address, tls, metrics, context })
    }
    /// The bound address, with the true port.
    pub fn local_addr(&self) -> SocketAddr {
        self.address
    }
    /// Whether connections are encrypted.
    pub fn is_encrypted(&self) -> bool {
        self.tls.is_some()
    }
    /// Where metrics are served, with the true port.
    pub fn metrics_addr(&self) -> Option<SocketAddr> {
        self.metrics.as_ref().and_then(|m| m.local_addr().ok())
    }
    /// Serves until `shutdown` is ready, then gives open streams a moment to end.
    ///
    /// # Errors
    /// When the transport fails.
    pub async fn run(self, shutdown: impl Future<Output = ()> + Send + 'static) -> Result<(), ServeError> {
        tracing::info!(address = %self.address, "listening");
        let (begun, begins) = oneshot::channel();
        let driver = self.context.driver.clone();
        let shutdown = async move {
            shutdown.await;
            tracing::info!("shutting down");
            // Sessions and watches would stay open for ever; workers join whoever comes next.
            driver.shutdown().await;
            drop(begun);
        };
        let server = match self.tls {
            Some(tls) => service::server().tls_config(tls).map_err(|e| ServeError::Access(reason(&e)))?,
            None => service::server(),
        };
        let _metrics = self.metrics.map(|listener| metrics::serve(listener, self.context.clone()));
        let incoming = Incoming::new(self.listener, CONNECTIONS, self.context.counters.clone());
        let serving = service::router(server, self.context).await.serve_with_incoming_shutdown(incoming, shutdown);
        let grace = async {
            drop::<Result<(), _>>(begins.await);
            tokio::time::sleep(SHUTDOWN_GRACE).await;
        };
        tokio::select! {
            served = serving => served.map_err(|e| ServeError::Transport(e.to_string())),
            () = grace => Ok(()),
        }
    }
}

async fn listen(address: SocketAddr) -> Result<(TcpListener, SocketAddr), ServeError> {
    let listen_error = |source| ServeError::Listen { address, source };
    let listener = TcpListener::bind(address).await.map_err(listen_error)?;
    let bound = listener.local_addr().map_err(listen_error)?;
    Ok((listener, bound))
}

/// [`Server::bind`] and [`Server::run`] in one. Runs on the caller's tokio runtime.
///
/// # Errors
/// As they do.
pub async fn serve(config: ServeConfig, shutdown: impl Future<Output = ()> + Send + 'static) -> Result<(), ServeError> {
    Server::bind(config).await?.run(shutdown).await
}

//! A coordinator that listens for workers and clients.

use std::future::Future;
use std::net::SocketAddr;
use std::path::PathBuf;

/// Where and how a coordinator runs; cannot change an image.
#[derive(Clone, Debug)]
pub struct ServeConfig {
    /// Address to listen on; port 0 takes a free one.
    pub listen: SocketAddr,
    /// Directory of scene blobs and finished images; made if missing.
    pub store: PathBuf,
    /// Compute threads for merging and encoding; 0: one per core.
    pub threads: usize,
    /// Most bytes of scene blobs and results kept in the store.
    pub max_store_bytes: u64,
    /// Most jobs that are not yet finished.
    pub max_live_jobs: usize,
}

impl ServeConfig {
    /// Defaults beside the two that have none.
    pub fn new(listen: SocketAddr, store: PathBuf) -> Self {
        ServeConfig { listen, store, threads: 0, max_store_bytes: 64 << 30, max_live_jobs: 64 }
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
    address: SocketAddr,
}

impl Server {
    /// Opens the store and binds the address.
    ///
    /// # Errors
    /// When either cannot be had.
    pub async fn bind(config: ServeConfig) -> Result<Self, ServeError> {
        Ok(Server { address: config.listen })
    }
    /// The bound address, with the true port.
    pub fn local_addr(&self) -> SocketAddr {
        self.address
    }
    /// Serves until `shutdown` is ready, then lets open streams end.
    ///
    /// # Errors
    /// When the transport fails.
    pub async fn run(self, shutdown: impl Future<Output = ()> + Send + 'static) -> Result<(), ServeError> {
        shutdown.await;
        Ok(())
    }
}

/// [`Server::bind`] and [`Server::run`] in one. Runs on the caller's tokio runtime.
///
/// # Errors
/// As they do.
pub async fn serve(config: ServeConfig, shutdown: impl Future<Output = ()> + Send + 'static) -> Result<(), ServeError> {
    Server::bind(config).await?.run(shutdown).await
}

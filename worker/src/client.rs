//! The connection to the coordinator: joining, heartbeats, fetching, delivering, and coming back after it broke.

mod joined;
mod remote;

pub use remote::Remote;

use crate::config::WorkerConfig;
use crate::error::WorkerError;
use crate::executor::Executor;
use gatherlight_proto::connect::{endpoint, pause};
use gatherlight_proto::credentials::Credentials;
use joined::{Ended, Life};
use std::future::Future;
use std::hash::{BuildHasher, Hasher};
use std::pin::Pin;
use std::sync::Arc;
use tonic::transport::{Channel, Error};

/// Port of a URL that has none.
const DEFAULT_HTTP_PORT: u16 = 80;

/// A connection in the making.
type Connecting = Pin<Box<dyn Future<Output = Result<Channel, Error>> + Send>>;

/// How to reach the coordinator, again and again.
#[derive(Clone)]
pub struct Connector {
    /// Its address, for messages.
    pub address: String,
    /// Its host and port, where it is reached over the network.
    host: Option<String>,
    credentials: Credentials,
    open: Arc<dyn Fn() -> Connecting + Send + Sync>,
}

impl Connector {
    /// Over the network, without a token or certificate.
    ///
    /// # Errors
    /// When the URL makes no sense.
    pub fn url(url: &str) -> Result<Self, WorkerError> {
        Self::with(url, Credentials::default())
    }
    /// Over the network, proving itself by `credentials`.
    ///
    /// # Errors
    /// When the URL or a certificate makes no sense.
    pub fn with(url: &str, credentials: Credentials) -> Result<Self, WorkerError> {
        let endpoint = endpoint(url, &credentials).map_err(|reason| WorkerError::Url { url: url.into(), reason })?;
        let uri = endpoint.uri();
        let host = uri.host().map(|host| format!("{host}:{}", uri.port_u16().unwrap_or(DEFAULT_HTTP_PORT)));
        let connector = Self::custom(url, move || {
            let endpoint = endpoint.clone();
            Box::pin(async move { endpoint.connect().await })
        });
        Ok(Connector { host, credentials, ..connector })
    }
    /// By any other means.
    pub fn custom(address: impl Into<String>, open: impl Fn() -> Connecting + Send + Sync + 'static) -> Self {
        let credentials = Credentials::default();
        Connector { address: address.into(), host: None, credentials, open: Arc::new(open) }
    }
}

/// Joins the coordinator and works, coming back whenever the connection breaks, until `shutdown` is ready: then it
/// finishes the lease it computes, returns the others, and leaves.
///
/// # Errors
/// When the coordinator cannot be reached, attempt after attempt, or refuses this worker for good.
pub async fn run(
    config: WorkerConfig,
    connector: Connector,
    shutdown: impl Future<Output = ()> + Send,
) -> Result<(), WorkerError> {
    let executor = Executor::new(config.threads).map_err(WorkerError::Threads)?;
    let address = connector.address.clone();
    let max_attempts = config.max_attempts.max(1);
    let mut life = Life::new(config, executor);
    let mut shutdown = std::pin::pin!(shutdown);
    let mut failures = 0;
    loop {
        let reason = match life.session(&connector, shutdown.as_mut()).await {
            Ended::Left => return Ok(()),
            Ended::Refused(reason) => return Err(WorkerError::Refused { address, reason }),
            Ended::Broken(reason) => {
                failures = 0;
                reason
            }
            Ended::NotReached(reason) => {
                failures += 1;
                if failures >= max_attempts {
                    return Err(WorkerError::Unreachable { address, attempts: failures, reason });
                }
                reason
            }
        };
        let wait = pause(failures, random());
        tracing::warn!(address, reason, attempt = failures, wait_ms = wait.as_millis() as u64, "no connection");
        tokio::select! {
            () = tokio::time::sleep(wait) => {}
            () = &mut shutdown => return Ok(()),
        }
    }
}

/// For jitter only.
fn random() -> u64 {
    std::collections::hash_map::RandomState::new().build_hasher().finish()
}

//! Speaks to a coordinator elsewhere.

use crate::types::{JobId, JobProgress, WorkerInfo};
use bytes::Bytes;
use gatherlight_render::import::SceneBundle;
use gatherlight_render::settings::RenderSettings;
use std::pin::Pin;
use tokio_stream::Stream;

/// Attempts to reach a coordinator before giving up, by default.
pub const DEFAULT_ATTEMPTS: u32 = 5;

/// Why a request was not answered.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The URL makes no sense.
    #[error("{url:?} is no coordinator URL: {reason}; write it like http://localhost:7420")]
    Url {
        /// As given.
        url: String,
        /// What is wrong.
        reason: String,
    },
    /// Nothing answers there.
    #[error(
        "cannot reach the coordinator at {url} ({attempts} attempts): {reason}; is `gatherlight serve` running there?"
    )]
    Unreachable {
        /// The address tried.
        url: String,
        /// How often.
        attempts: u32,
        /// The last failure.
        reason: String,
    },
    /// Both sides speak different protocol versions; the text names them.
    #[error("{0}")]
    Version(String),
    /// There is no such job, or its image is not there.
    #[error("{0}")]
    NotFound(String),
    /// The coordinator refused: scene, settings or a limit; the text says what and how to do better.
    #[error("{0}")]
    Refused(String),
    /// The connection broke, or the peer does not keep to the protocol.
    #[error("the coordinator at {url}: {reason}")]
    Transport {
        /// Its address.
        url: String,
        /// What happened.
        reason: String,
    },
}

/// A job to submit.
#[derive(Clone, Debug)]
pub struct SubmitRequest {
    /// Name for listings.
    pub name: String,
    /// The scene's files.
    pub bundle: SceneBundle,
    /// What determines the image.
    pub settings: RenderSettings,
}

/// A finished image.
#[derive(Clone, Debug)]
pub struct FetchedImage {
    /// The EXR file's bytes, digest checked.
    pub exr: Bytes,
    /// BLAKE3 digest, hexadecimal.
    pub digest: String,
}

/// Snapshots of a job, ending after the final one.
pub type ProgressStream = Pin<Box<dyn Stream<Item = Result<JobProgress, ClientError>> + Send>>;

/// A connection to a coordinator; clones share it.
#[derive(Clone, Debug)]
pub struct Client {
    url: String,
}

/// Connects to the coordinator at `url` (`http://HOST:PORT`), trying `attempts` times with growing pauses, and checks
/// that both sides speak the same protocol.
///
/// # Errors
/// When the URL makes no sense, nothing answers (the text has the address), or the versions differ (it has both).
pub async fn connect(url: &str, attempts: u32) -> Result<Client, ClientError> {
    Err(ClientError::Unreachable { url: url.into(), attempts, reason: "not there yet".into() })
}

impl Client {
    fn inert<T>(&self) -> Result<T, ClientError> {
        Err(ClientError::Transport { url: self.url.clone(), reason: "not there yet".into() })
    }
    /// The coordinator's address.
    pub fn url(&self) -> &str {
        &self.url
    }
    /// Uploads what the coordinator lacks of the scene and starts a job. `uploaded` hears (bytes sent, bytes to send).
    ///
    /// # Errors
    /// When the scene, the settings or a limit is at fault, or the connection breaks.
    pub async fn submit(
        &self,
        _request: &SubmitRequest,
        _uploaded: impl FnMut(u64, u64) + Send,
    ) -> Result<JobId, ClientError> {
        self.inert()
    }
    /// All jobs the coordinator knows, oldest first.
    ///
    /// # Errors
    /// When the connection breaks.
    pub async fn list(&self) -> Result<Vec<JobProgress>, ClientError> {
        self.inert()
    }
    /// One job.
    ///
    /// # Errors
    /// When there is no such job or the connection breaks.
    pub async fn get(&self, _id: JobId) -> Result<JobProgress, ClientError> {
        self.inert()
    }
    /// Snapshots of one job as it goes on, until its final state.
    ///
    /// # Errors
    /// When there is no such job or the connection breaks.
    pub async fn watch(&self, _id: JobId) -> Result<ProgressStream, ClientError> {
        self.inert()
    }
    /// The finished image. `received` hears (bytes received, bytes in all).
    ///
    /// # Errors
    /// When there is no such job, it is not done, or the connection breaks.
    pub async fn fetch(&self, _id: JobId, _received: impl FnMut(u64, u64) + Send) -> Result<FetchedImage, ClientError> {
        self.inert()
    }
    /// Cancels a job; one that has ended stays as it is. Returns its state afterwards.
    ///
    /// # Errors
    /// When there is no such job or the connection breaks.
    pub async fn cancel(&self, _id: JobId) -> Result<JobProgress, ClientError> {
        self.inert()
    }
    /// The workers that are there.
    ///
    /// # Errors
    /// When the connection breaks.
    pub async fn workers(&self) -> Result<Vec<WorkerInfo>, ClientError> {
        self.inert()
    }
}

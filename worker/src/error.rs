//! Why a worker stops.

use tonic::{Code, Status};

/// Why a worker gave up.
#[derive(Debug, thiserror::Error)]
pub enum WorkerError {
    /// The coordinator's URL makes no sense.
    #[error("{url:?} is no coordinator URL: {reason}; write it like http://localhost:7420")]
    Url {
        /// As given.
        url: String,
        /// What is wrong.
        reason: String,
    },
    /// Nothing answers, attempt after attempt.
    #[error("cannot reach the coordinator at {address} ({attempts} attempts): {reason}")]
    Unreachable {
        /// Its address.
        address: String,
        /// How often in a row.
        attempts: u32,
        /// The last failure.
        reason: String,
    },
    /// The coordinator will not have this worker, now or later; its text says why.
    #[error("the coordinator at {address} refused this worker: {reason}")]
    Refused {
        /// Its address.
        address: String,
        /// Its reason; names both versions where they differ.
        reason: String,
    },
    /// A token or certificate cannot be read or makes no sense.
    #[error("{0}")]
    Credentials(String),
    /// Metrics cannot be served.
    #[error("cannot serve metrics on {address}: {source}")]
    Metrics {
        /// Where.
        address: std::net::SocketAddr,
        /// The system's reason.
        source: std::io::Error,
    },
    /// Compute threads could not be started.
    #[error("cannot start compute threads: {0}")]
    Threads(String),
}

/// Why one lease could not be done; goes to the coordinator as text.
#[derive(Debug, thiserror::Error)]
pub enum TaskError {
    /// The job was never announced, or has ended.
    #[error("the job is not known here")]
    UnknownJob,
    /// A scene file or map could not be fetched.
    #[error("cannot fetch {what}: {reason}")]
    Fetch {
        /// What was wanted.
        what: String,
        /// Why it did not come.
        reason: String,
    },
    /// What came is not what was wanted.
    #[error(transparent)]
    Wire(#[from] gatherlight_proto::WireError),
    /// The scene or the settings are at fault.
    #[error(transparent)]
    Job(#[from] gatherlight_render::job::JobError),
    /// A map or bootstrap does not fit into this worker's memory.
    #[error(
        "the {what} of {bytes} bytes does not fit into this worker's {limit} bytes; give it more --memory or trace fewer paths"
    )]
    Memory {
        /// What it is.
        what: String,
        /// Its encoded size.
        bytes: u64,
        /// The worker's limit.
        limit: u64,
    },
    /// The method of the job splats nothing.
    #[error("the job's method has no light image, so it has no splat phase")]
    NoLightImage,
    /// The renderer panicked: a bug.
    #[error("the renderer panicked: {0}")]
    Panicked(String),
    /// The result could not be handed in.
    #[error("cannot deliver the result: {0}")]
    Deliver(String),
}

/// Whether the coordinator's answer will stay the same however often it is asked.
pub(crate) fn is_final(status: &Status) -> bool {
    matches!(
        status.code(),
        Code::FailedPrecondition
            | Code::InvalidArgument
            | Code::Unauthenticated
            | Code::PermissionDenied
            | Code::Unimplemented
    )
}

//! Why something from a peer was refused, and the one mapping of that to a gRPC status.

use crate::limits::PROTOCOL_VERSION;
use gatherlight_render::VERSION;
use tonic::{Code, Status};

/// What a peer sent makes no sense.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// A field is missing.
    #[error("{0} is missing")]
    Missing(&'static str),
    /// A field has a value it cannot have.
    #[error("{field}: {message}")]
    Invalid {
        /// Which field.
        field: &'static str,
        /// What is wrong, and what is valid.
        message: String,
    },
    /// A named limit was exceeded.
    #[error("{what} is {actual}, over the limit of {limit} ({name})")]
    Limit {
        /// The quantity.
        what: &'static str,
        /// Its value.
        actual: u64,
        /// The limit.
        limit: u64,
        /// The limit's name in the code or its flag.
        name: &'static str,
    },
    /// Chunks out of order, missing or repeated.
    #[error("chunk {actual} arrived where chunk {expected} was due")]
    Order {
        /// Index due.
        expected: u64,
        /// Index received.
        actual: u64,
    },
    /// The stream ended early or went on too long.
    #[error("the payload has {actual} bytes, announced were {expected}")]
    Length {
        /// Bytes announced.
        expected: u64,
        /// Bytes received.
        actual: u64,
    },
    /// The bytes are not those that were announced.
    #[error("the payload's digest is {actual}, announced was {expected}: damaged on the way")]
    Digest {
        /// Digest announced.
        expected: String,
        /// Digest of what arrived.
        actual: String,
    },
    /// A payload is not laid out as it should be.
    #[error("{what}: {message}")]
    Payload {
        /// Which payload.
        what: &'static str,
        /// What is wrong with it.
        message: String,
    },
    /// The two sides run different versions.
    #[error(
        "version mismatch: this coordinator is gatherlight {VERSION} with protocol {PROTOCOL_VERSION}, the {peer} is \
         gatherlight {version} with protocol {protocol}; install the same version on both"
    )]
    Version {
        /// `worker` or `client`.
        peer: &'static str,
        /// Its program version, `?` where it sent none.
        version: String,
        /// Its protocol version, `?` where it sent none.
        protocol: String,
    },
}

impl WireError {
    /// An [`WireError::Invalid`].
    pub fn invalid(field: &'static str, message: impl Into<String>) -> Self {
        WireError::Invalid { field, message: message.into() }
    }
    /// A [`WireError::Payload`].
    pub fn payload(what: &'static str, message: impl Into<String>) -> Self {
        WireError::Payload { what, message: message.into() }
    }
    /// Checks `actual` against a limit.
    ///
    /// # Errors
    /// When it is larger.
    pub fn check_limit(what: &'static str, actual: u64, limit: u64, name: &'static str) -> Result<(), Self> {
        if actual > limit { Err(WireError::Limit { what, actual, limit, name }) } else { Ok(()) }
    }
}

impl From<WireError> for Status {
    fn from(e: WireError) -> Self {
        let code = match &e {
            WireError::Limit { .. } => Code::ResourceExhausted,
            WireError::Digest { .. } | WireError::Length { .. } => Code::DataLoss,
            WireError::Version { .. } => Code::FailedPrecondition,
            WireError::Missing(_) | WireError::Invalid { .. } | WireError::Order { .. } | WireError::Payload { .. } => {
                Code::InvalidArgument
            }
        };
        Status::new(code, e.to_string())
    }
}

/// `text` cut to `limit` bytes, at a character's edge.
pub fn truncated(text: &str, limit: usize) -> &str {
    let mut end = limit.min(text.len());
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    text.get(..end).unwrap_or_default()
}

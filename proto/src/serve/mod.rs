//! What every server of ours lets its peers cost: connections, calls, bytes that wait, time.
//!
//! - `connection`: how many there are, and how long one may stay that proves nothing or does nothing;
//! - `refusals`: calls that were refused, counted by reason;
//! - `rate`: how often something may happen;
//! - `abreast`: streams of one payload, kept so.

mod abreast;
mod connection;
mod rate;
mod refusals;

pub use abreast::{Abreast, Place};
pub use connection::{Call, Connection, ConnectionLimits, Incoming, Peer};
pub use rate::Rate;
pub use refusals::CountRefusals;

use std::fmt::Debug;
use std::io;
use std::time::Duration;
use tonic::transport::Server;

/// Silence on a connection after which it is probed, and after which an unanswered probe ends it.
const KEEPALIVE: Duration = Duration::from_secs(10);
/// Longest headers of a call, together, in bytes.
const MAX_HEADER_BYTES: u32 = 16 << 10;
/// Streams a peer may open and reset before they are looked at.
const MAX_RESETS: usize = 20;

/// Where a server counts what its peers do.
pub trait Tally: Debug + Send + Sync {
    /// A connection was taken.
    fn connected(&self);
    /// So many bytes were read from a connection, encrypted where they are.
    fn received(&self, bytes: u64);
    /// So many bytes were written to a connection.
    fn sent(&self, bytes: u64);
    /// A peer was refused something, for this reason.
    fn refused(&self, reason: &'static str);
    /// The system gave no connection.
    fn not_taken(&self, error: &io::Error);
}

/// A server within this project's limits: a connection has at most `streams` calls open, and sends at most so many bytes of one of
/// them, or of all, before somebody reads them.
pub fn server(streams: u32, stream_window_bytes: u32, connection_window_bytes: u32) -> Server {
    Server::builder()
        .initial_stream_window_size(stream_window_bytes)
        .initial_connection_window_size(connection_window_bytes)
        .max_concurrent_streams(streams)
        .http2_max_header_list_size(MAX_HEADER_BYTES)
        .http2_max_pending_accept_reset_streams(Some(MAX_RESETS))
        .http2_keepalive_interval(Some(KEEPALIVE))
        .http2_keepalive_timeout(Some(KEEPALIVE))
        .tcp_nodelay(true)
}

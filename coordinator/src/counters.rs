//! What a coordinator counts of itself, for its metrics.

use gatherlight_proto::serve::Tally;
use gatherlight_telemetry::{Counter, Labelled};

/// Counts since the coordinator started.
#[derive(Debug, Default)]
pub struct Counters {
    /// Bytes read from connections, encrypted where they are.
    pub received_bytes: Counter,
    /// Bytes written to connections.
    pub sent_bytes: Counter,
    /// Connections taken.
    pub connections: Counter,
    /// Results that counted.
    pub leases_done: Counter,
    /// Leases handed out again, after those who had them were lost or late, failed or gave them back.
    pub leases_retried: Counter,
    /// Leases given to a second worker while the first one had them.
    pub leases_repeated: Counter,
    /// Tasks that workers reported as failed, and results that were refused.
    pub leases_failed: Counter,
    /// What peers were refused, by reason.
    pub refusals: Labelled,
}

impl Tally for Counters {
    fn connected(&self) {
        self.connections.add(1);
    }
    fn received(&self, bytes: u64) {
        self.received_bytes.add(bytes);
    }
    fn sent(&self, bytes: u64) {
        self.sent_bytes.add(bytes);
    }
    fn refused(&self, reason: &'static str) {
        self.refusals.add(reason, 1);
    }
    fn not_taken(&self, error: &std::io::Error) {
        tracing::warn!(%error, "a connection could not be taken");
        self.refusals.add("accept_failed", 1);
    }
}

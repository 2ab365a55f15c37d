//! What a coordinator counts of itself, for its metrics.

use gatherlight_telemetry::Counter;
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

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
    refusals: Mutex<BTreeMap<&'static str, u64>>,
}

impl Counters {
    /// A peer was refused something.
    pub fn refused(&self, reason: &'static str) {
        let mut refusals = self.refusals.lock().unwrap_or_else(PoisonError::into_inner);
        let count = refusals.entry(reason).or_default();
        *count = count.saturating_add(1);
    }
    /// How often, by reason.
    pub fn refusals(&self) -> BTreeMap<&'static str, u64> {
        self.refusals.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

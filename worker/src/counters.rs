//! What a worker counts of itself, for its metrics.

use gatherlight_proto::serve::Tally;
use gatherlight_telemetry::{Counter, Kind, Labelled, Page};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Counts since the worker started.
#[derive(Debug, Default)]
pub struct Counters {
    /// Tasks computed.
    pub tasks_done: Counter,
    /// Tasks that failed.
    pub tasks_failed: Counter,
    /// Results handed in, whether they counted or not.
    pub results_delivered: Counter,
    /// Results that could not be handed in.
    pub results_failed: Counter,
    /// Bytes of scene files, maps and bootstraps fetched.
    pub fetched_bytes: Counter,
    /// Bytes of results handed in.
    pub delivered_bytes: Counter,
    /// Times it joined a coordinator.
    pub sessions: Counter,
    /// Connections taken of other workers.
    pub connections: Counter,
    /// Bytes passed on to other workers, with what the network adds.
    pub passed_bytes: Counter,
    /// What other workers, or whoever reached this one's port, were refused, by reason.
    pub refusals: Labelled,
    busy_micros: Counter,
    is_joined: AtomicBool,
}

impl Counters {
    /// Time spent computing.
    pub fn add_busy(&self, busy: Duration) {
        self.busy_micros.add(u64::try_from(busy.as_micros()).unwrap_or(u64::MAX));
    }
    /// Whether it is joined now.
    pub fn set_joined(&self, is_joined: bool) {
        self.is_joined.store(is_joined, Ordering::Relaxed);
        self.sessions.add(is_joined.into());
    }
    /// As Prometheus reads it.
    pub fn page(&self) -> String {
        use Kind::{Counter, Gauge};
        let mut page = Page::default();
        let joined = f64::from(u8::from(self.is_joined.load(Ordering::Relaxed)));
        page.number(Gauge, "gatherlight_worker_joined", "1 while it is joined to a coordinator.", joined);
        let mut count = |name: &str, help: &str, value: f64| page.number(Counter, name, help, value);
        let number = |counter: &gatherlight_telemetry::Counter| counter.get() as f64;
        count("gatherlight_worker_sessions_total", "Times it joined.", number(&self.sessions));
        count("gatherlight_worker_tasks_done_total", "Tasks computed.", number(&self.tasks_done));
        count("gatherlight_worker_tasks_failed_total", "Tasks that failed.", number(&self.tasks_failed));
        count("gatherlight_worker_busy_seconds_total", "Time spent computing.", number(&self.busy_micros) * 1e-6);
        count("gatherlight_worker_results_delivered_total", "Results handed in.", number(&self.results_delivered));
        let failed = number(&self.results_failed);
        count("gatherlight_worker_results_failed_total", "Results that could not be handed in.", failed);
        count("gatherlight_worker_fetched_bytes_total", "Scene files and maps fetched.", number(&self.fetched_bytes));
        count("gatherlight_worker_delivered_bytes_total", "Results handed in.", number(&self.delivered_bytes));
        count("gatherlight_worker_connections_total", "Connections of other workers taken.", number(&self.connections));
        count("gatherlight_worker_passed_bytes_total", "Scene files and maps passed on.", number(&self.passed_bytes));
        let refusals = self.refusals.get();
        page.labelled(Counter, "gatherlight_worker_refusals_total", "What others were refused.", "reason", refusals);
        page.process();
        page.into_text()
    }
}

impl Tally for Counters {
    fn connected(&self) {
        self.connections.add(1);
    }
    fn received(&self, _bytes: u64) {}
    fn sent(&self, bytes: u64) {
        self.passed_bytes.add(bytes);
    }
    fn refused(&self, reason: &'static str) {
        self.refusals.add(reason, 1);
    }
    fn not_taken(&self, error: &std::io::Error) {
        tracing::warn!(%error, "a connection could not be taken");
        self.refusals.add("accept_failed", 1);
    }
}

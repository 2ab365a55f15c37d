//! The coordinator's metrics, for Prometheus.

use crate::service::Context;
use gatherlight_telemetry::{Kind, MakePage, Page};
use std::collections::BTreeMap;
use std::sync::Arc;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;

/// Ends the serving when dropped.
pub(crate) struct Serving(JoinHandle<()>);

impl Drop for Serving {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// Serves the metrics on `listener`.
pub(crate) fn serve(listener: TcpListener, context: Context) -> Serving {
    let make: MakePage = Arc::new(move || {
        let context = context.clone();
        Box::pin(async move { page(&context).await })
    });
    Serving(tokio::spawn(gatherlight_telemetry::serve(listener, make)))
}

/// How many there are of each name.
fn counted<'a>(names: impl Iterator<Item = &'a str>) -> BTreeMap<&'a str, f64> {
    let mut counts = BTreeMap::new();
    names.for_each(|name| *counts.entry(name).or_insert(0.0) += 1.0);
    counts
}

async fn page(context: &Context) -> String {
    use Kind::{Counter, Gauge};
    let Context { driver, compute, store, counters, .. } = context;
    let (workers, jobs) = (driver.workers().await, driver.list().await);
    let mut page = Page::default();
    let states = counted(workers.iter().map(|w| &*w.state));
    page.labelled(Gauge, "gatherlight_workers", "Workers that are there.", "state", states);
    let threads: u32 = workers.iter().map(|w| w.threads).sum();
    page.number(Gauge, "gatherlight_worker_threads", "Their compute threads.", threads.into());
    let states = counted(jobs.iter().map(|j| j.state.name()));
    page.labelled(Gauge, "gatherlight_jobs", "Jobs that are listed.", "state", states);
    let open: u32 = workers.iter().map(|w| w.leases).sum();
    page.number(Gauge, "gatherlight_leases_open", "Leases that workers hold.", open.into());
    let mut count = |name: &str, help: &str, value: u64| page.number(Counter, name, help, value as f64);
    count("gatherlight_leases_done_total", "Results that counted.", counters.leases_done.get());
    let (retried, repeated) = (counters.leases_retried.get(), counters.leases_repeated.get());
    count("gatherlight_leases_retried_total", "Leases lost, failed or given back, and handed out again.", retried);
    count("gatherlight_leases_repeated_total", "Leases of slow workers that another one did, too.", repeated);
    count("gatherlight_leases_failed_total", "Failed tasks and refused results.", counters.leases_failed.get());
    count("gatherlight_received_bytes_total", "Bytes read from connections.", counters.received_bytes.get());
    count("gatherlight_sent_bytes_total", "Bytes written to connections.", counters.sent_bytes.get());
    count("gatherlight_connections_total", "Connections taken.", counters.connections.get());
    page.labelled(Counter, "gatherlight_refusals_total", "What peers were refused.", "reason", counters.refusals.get());
    let mut gauge = |name: &str, help: &str, value: u64| page.number(Gauge, name, help, value as f64);
    gauge("gatherlight_driver_queue", "Inputs that wait for the driver.", driver.queued() as u64);
    gauge("gatherlight_compute_queue", "Merges, decodings and encodings that wait or run.", compute.open() as u64);
    gauge("gatherlight_store_bytes", "Bytes of the store that are used or reserved.", store.used_bytes());
    page.process();
    page.into_text()
}

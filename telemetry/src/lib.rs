//! What both programs tell of themselves while they run: logs, and metrics that Prometheus reads.
#![forbid(unsafe_code)]

pub mod log;
pub mod memory;
pub mod metrics;
pub mod serve;

pub use log::LogOptions;
pub use metrics::{Counter, Kind, Labelled, Page};
pub use serve::{MakePage, serve};

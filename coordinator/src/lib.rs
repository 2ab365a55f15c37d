//! The Gatherlight coordinator: plans, schedules, merges, broadcasts and assembles; and the client that speaks to it.
//!
//! Three ways in:
//! - [`embedded::render`]: a whole job on this machine; coordinator and workers in this process over in-memory streams;
//! - [`server::serve`]: a coordinator for a cluster;
//! - [`client::connect`]: submit, list, watch, fetch, cancel on a coordinator elsewhere.
//!
//! What they report is in [`types`].

pub mod access;
mod assemble;
pub mod broadcast;
pub mod cli;
pub mod client;
pub mod compute;
pub mod converge;
pub mod counters;
pub mod driver;
pub mod embedded;
mod intake;
mod manifest;
mod merge;
mod metrics;
mod random;
mod reduce;
pub mod report;
mod result;
mod room;
pub mod schedule;
pub mod server;
mod service;
pub mod stability;
pub mod store;
pub mod types;

pub use server::{ServeConfig, serve};
pub use types::{JobId, JobProgress, JobResult, JobState, JobStats, MapStats, WorkerInfo};

/// Port a coordinator listens on unless told otherwise.
pub const DEFAULT_PORT: u16 = 7420;

//! A Gatherlight worker: joins a coordinator, computes what it is leased, returns the results.
//!
//! - [`session`]: what a worker does, as a pure state machine;
//! - [`client`]: the connection: joining, heartbeats, fetching, delivering, coming back;
//! - [`executor`]: the compute threads, apart from the async ones, so that heartbeats flow while a tile renders;
//! - [`emission`] and [`gather`]: a lease's indices → a payload; bootstrap beside the one, splats beside the other;
//! - [`cache`]: scenes, bootstraps and the present round's maps of the present jobs, and scene files by digest;
//! - [`relay`]: scenes and maps on their way in from other workers and on to others;
//! - [`shared`]: what is in this process already, where the coordinator is too.
#![deny(unsafe_code)]

pub mod cache;
pub mod client;
pub mod config;
pub mod counters;
pub mod emission;
pub mod error;
pub mod executor;
pub mod gather;
pub mod relay;
pub mod session;
pub mod shared;

pub use client::{Connector, run};
pub use config::{Faults, WorkerConfig};
pub use error::WorkerError;
pub use shared::Shared;

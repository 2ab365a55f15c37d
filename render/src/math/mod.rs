//! Numbers, sampling and frames. Everything else imports from here; nothing here imports from elsewhere in the crate.

pub mod distribution;
pub mod frame;
pub mod heuristic;
pub mod numbers;
pub mod ops;
pub mod primary;
pub mod rgb;
pub mod rng;
pub mod roulette;
pub mod sobol;
pub mod warp;

pub use distribution::AliasTable;
pub use frame::Frame;
pub use numbers::Numbers;
pub use rgb::Rgb;
pub use rng::{Purpose, Stream};

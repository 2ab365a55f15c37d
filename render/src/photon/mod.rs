//! Photons: emission ranges, stored hits, batches, merging, the search structures and density estimates.

pub mod batch;
pub mod grid;
pub mod kdtree;
pub mod kernel;
pub mod merge;
pub mod pack;
pub mod query;
pub mod range;

pub use batch::{MapKind, PhotonBatch};
pub use range::EmissionRange;

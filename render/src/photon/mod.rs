//! Photons: emission ranges, stored hits, batches, merging, the search structures and density estimates.

pub mod aim;
pub mod batch;
pub mod estimate;
pub mod grid;
pub mod kdtree;
pub mod kernel;
pub mod map;
pub mod merge;
pub mod pack;
pub mod precomputed;
pub mod query;
pub mod range;
#[cfg(test)]
mod testing;
pub mod trace;

pub use batch::{LightVertices, MapKind, PhotonBatch};
pub use map::{PhotonMap, PhotonMaps};
pub use range::EmissionRange;

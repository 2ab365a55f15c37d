//! Photon batches, maps and tiles as bytes: little-endian, versioned, bounded before anything is allocated.

pub mod tiles;

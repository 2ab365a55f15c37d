//! Photon batches, maps and tiles as bytes: little-endian, versioned, bounded before anything is allocated.

mod columns;
#[cfg(test)]
mod fuzz;
mod header;
pub mod map;
pub mod photons;
pub mod tiles;

//! Photon batches, maps, bootstraps, sample maps, tiles and light images as bytes: little-endian, versioned, bounded before anything is
//! allocated.

pub mod bootstrap;
mod columns;
pub mod film;
#[cfg(test)]
mod fuzz;
pub mod gather;
mod header;
pub mod light;
pub mod map;
pub mod photons;
pub mod sample_map;
pub mod tiles;

//! Light transport for Gatherlight: pure computation shared by the coordinator and its workers.
//!
//! Bytes in, bytes out: no network, no clock, no logging, no environment. Every result is a function of
//! (scene digest, [`settings::RenderSettings`], index range), so that the image has the same bits for any number of
//! workers and threads.
//!
//! Units and conventions: scene-linear Rec.709 [`math::Rgb`]; lengths in *scene space* (centred on the origin, bounding
//! radius in [1, 2), an exact power of two from metres; see [`scene::normalise`]); `wo` and `wi` are unit vectors that
//! both point away from the surface; a BSDF value never contains the cosine. See ARCHITECTURE.md for the glossary.
#![deny(unsafe_code)]
#![cfg_attr(not(test), deny(clippy::disallowed_methods, clippy::disallowed_types))]

pub mod auto;
pub mod error;
pub mod export;
pub mod film;
pub mod geometry;
pub mod import;
pub mod integrator;
pub mod job;
pub mod light;
pub mod local;
pub mod material;
pub mod math;
pub mod photon;
pub mod plan;
pub mod scene;
pub mod settings;

/// Version of this renderer, written into images and checked between coordinator and workers.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

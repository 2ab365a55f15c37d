//! Integrators: estimators of the light that reaches the camera, and what they share.
//!
//! Every path from light to eye falls into one of three parts, the same for every method, so that layers can be compared
//! between methods (E eye, D diffuse lobe, G glossy lobe, S Dirac lobe, L light):
//! - *direct*: `E(S|G)*L` and `E(S|G)*DL`,
//! - *caustic*: `E(S|G)*D(S|G)⁺L`,
//! - *indirect*: everything else, `E(S|G)*D(S|G)*D…L`.
//!
//! The partition is by lobe, not by roughness: there is no threshold.

pub mod bdpt;
pub mod bootstrap;
pub mod connect;
pub mod direct;
pub mod map_error;
pub mod mlt;
pub mod path;
pub mod photon_map;
pub mod progressive;
pub mod radius;
pub mod sample;
pub mod tile;
pub mod vcm;
pub mod vertex;
pub mod whitted;

pub use bootstrap::Bootstrap;
pub use sample::{FirstHit, Sample};

//! Rays, meshes, the two-level acceleration structure and points on surfaces.

pub mod accelerator;
mod binary;
pub mod bounds;
mod bvh;
pub mod mesh;
pub mod ray;
mod simd;
pub mod surface;
mod traverse;
mod triangle;
mod wide;

pub use accelerator::Accelerator;
pub use bounds::Bounds;
pub use mesh::{Instance, Mesh, Transform};
pub use ray::{Hit, Ray};
pub use surface::{SurfacePoint, offset_origin};

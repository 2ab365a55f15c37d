//! Rays, meshes, the two-level acceleration structure and points on surfaces.

pub mod bvh;
pub mod mesh;
pub mod ray;
pub mod surface;

pub use bvh::Accelerator;
pub use mesh::{Instance, Mesh, Transform};
pub use ray::{Hit, Ray};
pub use surface::SurfacePoint;

//! Rays and hits.

use glam::Vec3;

/// A ray from `origin` along the unit `direction`; hits count for 0 < t < `t_max`.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Start, already moved off its surface (see [`super::SurfacePoint::spawn`]).
    pub origin: Vec3,
    /// Unit direction.
    pub direction: Vec3,
    /// End of the interval; `f32::INFINITY` for an unbounded ray.
    pub t_max: f32,
}

impl Ray {
    /// An unbounded ray.
    #[inline]
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        Ray { origin, direction, t_max: f32::INFINITY }
    }
    /// A ray that ends at distance `t_max`.
    #[inline]
    pub fn segment(origin: Vec3, direction: Vec3, t_max: f32) -> Self {
        Ray { origin, direction, t_max }
    }
}

/// Where a ray met a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance along the ray, in scene units.
    pub t: f32,
    /// Barycentric coordinate of the triangle's second vertex.
    pub b1: f32,
    /// Barycentric coordinate of the triangle's third vertex.
    pub b2: f32,
    /// Index of the instance.
    pub instance: u32,
    /// Index of the triangle within the instance's mesh.
    pub triangle: u32,
}

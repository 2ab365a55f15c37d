//! The body a path segment runs through, for Beer–Lambert attenuation.

use super::Scene;
use crate::geometry::SurfacePoint;
use crate::math::Rgb;
use glam::Vec3;

/// Which absorbing body a path is in: the index of the material that bounds it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Interior(Option<u32>);

impl Interior {
    /// Share of light that survives a segment of length `distance` that ends at `end`, seen from `wo` (back along the
    /// segment). A segment that meets the inner side of a body was inside it, wherever the path began.
    #[inline]
    pub fn transmittance_to(&self, scene: &Scene, end: &SurfacePoint, wo: Vec3, distance: f32) -> Rgb {
        if !scene.has_absorption {
            return Rgb::WHITE;
        }
        let body = self.0.or_else(|| (wo.dot(end.ng) < 0.0).then_some(end.material));
        scene.transmittance(body, distance)
    }
    /// Share of light that survives `distance` inside the current body.
    #[inline]
    pub fn transmittance(&self, scene: &Scene, distance: f32) -> Rgb {
        scene.transmittance(self.0, distance)
    }
    /// The body that a segment runs through which leaves `point` along `wi`, where this is the body of the segment that
    /// arrived from `wo`.
    #[inline]
    pub fn leaving(&self, scene: &Scene, point: &SurfacePoint, wo: Vec3, wi: Vec3) -> Interior {
        if !scene.has_absorption {
            return *self;
        }
        let inside = wi.dot(point.ng) < 0.0;
        if inside != (wo.dot(point.ng) < 0.0) {
            return self.crossed(scene, point, wi);
        }
        let inner = inside && scene.material(point).absorption().is_some();
        Interior(self.0.or_else(|| inner.then_some(point.material)))
    }
    /// This body, or where none is known the `other`.
    #[inline]
    pub fn or(self, other: Interior) -> Interior {
        Interior(self.0.or(other.0))
    }
    /// The body after crossing the surface at `point` into direction `wi`.
    #[inline]
    pub fn crossed(&self, scene: &Scene, point: &SurfacePoint, wi: Vec3) -> Interior {
        if !scene.has_absorption || scene.material(point).absorption().is_none() {
            return *self;
        }
        Interior((wi.dot(point.ng) < 0.0).then_some(point.material))
    }
}

//! Uniform directions in a spherical triangle (Arvo 1995), in double precision.

use crate::math::ops::{atan2_64, cos64, sin64};
use glam::DVec3;

/// Slivers whose angle at the first vertex has a smaller sine are refused: Arvo's map divides by it.
const MIN_SIN_ALPHA: f64 = 1e-4;

/// A spherical triangle seen from a point.
#[derive(Clone, Copy, Debug)]
pub struct SphericalTriangle {
    a: DVec3,
    b: DVec3,
    c: DVec3,
    cos_alpha: f64,
    sin_alpha: f64,
    /// Solid angle in steradians, > 0.
    pub solid_angle: f64,
}

impl SphericalTriangle {
    /// The triangle of three unit directions whose solid angle is known; `None` if it is too thin to sample.
    pub fn new(a: DVec3, b: DVec3, c: DVec3, solid_angle: f64) -> Option<SphericalTriangle> {
        let n_ab = a.cross(b).try_normalize()?;
        let n_ca = c.cross(a).try_normalize()?;
        let cos_alpha = (-n_ab.dot(n_ca)).clamp(-1.0, 1.0);
        let sin_alpha = n_ab.cross(n_ca).length();
        (sin_alpha > MIN_SIN_ALPHA).then_some(SphericalTriangle { a, b, c, cos_alpha, sin_alpha, solid_angle })
    }

    /// A direction uniform over the triangle; pdf 1/solid_angle.
    pub fn sample(&self, u: [f32; 2]) -> Option<DVec3> {
        let (a, b, c, cos_alpha, sin_alpha) = (self.a, self.b, self.c, self.cos_alpha, self.sin_alpha);
        // The sub-triangle of a, b and a point of the arc ac that has the share u₀ of the area; φ = area − α.
        let area = self.solid_angle * f64::from(u[0]);
        let (sin_area, cos_area) = (sin64(area), cos64(area));
        let sin_phi = sin_area * cos_alpha - cos_area * sin_alpha;
        let cos_phi = cos_area * cos_alpha + sin_area * sin_alpha;
        let k = cos_phi - cos_alpha;
        let v = sin_phi + sin_alpha * a.dot(b);
        // Cosine of the arc from a to that point.
        let q = ((v * cos_phi - k * sin_phi) * cos_alpha - v) / ((v * sin_phi + k * cos_phi) * sin_alpha);
        if !q.is_finite() {
            return None;
        }
        let corner = along(a, c, q.clamp(-1.0, 1.0))?;
        // Then a point on the arc from b to it, uniform in its cosine.
        along(b, corner, 1.0 - f64::from(u[1]) * (1.0 - corner.dot(b)))?.try_normalize()
    }
}

/// The point on the great circle from `from` towards `to` at the arc of cosine `cosine`.
fn along(from: DVec3, to: DVec3, cosine: f64) -> Option<DVec3> {
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    if sine == 0.0 {
        return Some(from * cosine);
    }
    let tangent = (to - from * to.dot(from)).try_normalize()?;
    Some(from * cosine + tangent * sine)
}

/// Solid angle of three unit directions (Van Oosterom and Strackee 1983), steradians in [0, 2π].
pub fn solid_angle(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    let triple = a.dot(b.cross(c)).abs();
    2.0 * atan2_64(triple, 1.0 + a.dot(b) + b.dot(c) + c.dot(a))
}

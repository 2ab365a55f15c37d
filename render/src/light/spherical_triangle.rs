//! Uniform directions in a spherical triangle, in double precision.
//!
//! Arvo's (1995) construction, with his dihedral angles replaced by half-angle tangents as in Peters (2021, "BRDF
//! Importance Sampling for Polygonal Lights"): nothing divides by the sine of an angle, so slivers are as good as any.

use crate::math::ops::{atan2_64, cos64, sin64};
use glam::DVec3;

/// A spherical triangle seen from a point.
#[derive(Clone, Copy, Debug)]
pub struct SphericalTriangle {
    a: DVec3,
    b: DVec3,
    c: DVec3,
    /// a·b and |det(a, b, c)|.
    cos_ab: f64,
    determinant: f64,
    /// Solid angle in steradians, in [0, 2π].
    pub solid_angle: f64,
}

impl SphericalTriangle {
    /// The triangle of three unit directions (solid angle after Van Oosterom and Strackee 1983).
    #[inline]
    pub fn new(a: DVec3, b: DVec3, c: DVec3) -> SphericalTriangle {
        let (cos_ab, determinant) = (a.dot(b), a.dot(b.cross(c)).abs());
        let solid_angle = 2.0 * atan2_64(determinant, 1.0 + cos_ab + b.dot(c) + c.dot(a));
        SphericalTriangle { a, b, c, cos_ab, determinant, solid_angle }
    }

    /// A direction uniform over the triangle; pdf 1/solid_angle. `None` where the triangle is degenerate.
    #[inline]
    pub fn sample(&self, u: [f32; 2]) -> Option<DVec3> {
        let (a, b) = (self.a, self.b);
        // Half the area of the sub-triangle a, b, q with q on the arc from a to c. With t the arc from a to q and τ the
        // tangent at a, tan(half area) = tan(t/2) det(a, b, τ) / (1 + a·b + tan(t/2) b·τ) gives tan(t/2).
        let half = 0.5 * self.solid_angle * f64::from(u[0]);
        let (sin, cos) = (sin64(half), cos64(half));
        let tangent = self.c - a * a.dot(self.c);
        let o = a * (self.determinant * cos - b.dot(tangent) * sin) + tangent * (sin * (1.0 + self.cos_ab));
        // q is a mirrored about the direction at half the arc.
        let q = o * (2.0 * a.dot(o) / o.length_squared()) - a;
        // Then a point on the arc from b to q, uniform in its cosine.
        let cos_bq = b.dot(q);
        let z = 1.0 - f64::from(u[1]) * (1.0 - cos_bq);
        let tangent = q - b * cos_bq;
        let scale = ((1.0 - z * z).max(0.0) / tangent.length_squared()).sqrt();
        let w = b * z + tangent * scale;
        w.is_finite().then_some(w)
    }
}

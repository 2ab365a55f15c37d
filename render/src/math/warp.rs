//! Maps from the unit square to directions, discs and triangles, each with its pdf.

use super::ops::{INV_PI, PI, cos, sin};
use glam::Vec3;

/// Concentric map of the unit square to the unit disc (Shirley and Chiu 1997). pdf 1/π per area.
#[inline]
pub fn disc(u: [f32; 2]) -> [f32; 2] {
    let (a, b) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    if a == 0.0 && b == 0.0 {
        return [0.0, 0.0];
    }
    let (r, phi) = if a.abs() > b.abs() { (a, (PI / 4.0) * (b / a)) } else { (b, PI / 2.0 - (PI / 4.0) * (a / b)) };
    [r * cos(phi), r * sin(phi)]
}

/// Cosine-weighted direction on the hemisphere around +z. pdf cosθ/π per solid angle.
#[inline]
pub fn cosine_hemisphere(u: [f32; 2]) -> Vec3 {
    let d = disc(u);
    Vec3::new(d[0], d[1], (1.0 - d[0] * d[0] - d[1] * d[1]).max(0.0).sqrt())
}

/// pdf of [`cosine_hemisphere`] per solid angle; 0 below the horizon.
#[inline]
pub fn cosine_hemisphere_pdf(cos_theta: f32) -> f32 {
    cos_theta.max(0.0) * INV_PI
}

/// Uniform direction on the sphere. pdf 1/(4π) per solid angle.
#[inline]
pub fn uniform_sphere(u: [f32; 2]) -> Vec3 {
    let z = 1.0 - 2.0 * u[0];
    let r = (4.0 * u[0] * (1.0 - u[0])).max(0.0).sqrt();
    let phi = 2.0 * PI * u[1];
    Vec3::new(r * cos(phi), r * sin(phi), z)
}

/// Uniform direction in the cone around +z whose half-angle θ has `one_minus_cos = 1 − cos θ` (given in that form so
/// that tiny cones keep their precision). pdf 1/(2π(1 − cos θ)) per solid angle.
#[inline]
pub fn uniform_cone(u: [f32; 2], one_minus_cos: f32) -> Vec3 {
    let h = u[0] * one_minus_cos;
    let r = (h * (2.0 - h)).max(0.0).sqrt();
    let phi = 2.0 * PI * u[1];
    Vec3::new(r * cos(phi), r * sin(phi), 1.0 - h)
}

/// pdf of [`uniform_cone`] per solid angle.
#[inline]
pub fn uniform_cone_pdf(one_minus_cos: f32) -> f32 {
    1.0 / (2.0 * PI * one_minus_cos)
}

/// Uniform barycentric coordinates (b1, b2) of a triangle (Heitz 2019). pdf 1/area per area.
#[inline]
pub fn triangle(u: [f32; 2]) -> [f32; 2] {
    if u[0] < u[1] {
        let b0 = u[0] * 0.5;
        [1.0 - b0 - (u[1] - b0), u[1] - b0]
    } else {
        let b1 = u[1] * 0.5;
        let b0 = u[0] - b1;
        [1.0 - b0 - b1, b1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{Purpose, Stream};

    #[test]
    fn directions_are_unit_and_have_their_mean_cosine() {
        let mut s = Stream::new(1, Purpose::Test, 0, 0);
        let n = 100_000;
        let (mut cosine, mut sphere, mut cone) = (0.0f64, 0.0f64, 0.0f64);
        for _ in 0..n {
            let u = s.next_2d();
            let (a, b, c) = (cosine_hemisphere(u), uniform_sphere(u), uniform_cone(u, 0.25));
            for v in [a, b, c] {
                assert!((v.length() - 1.0).abs() < 1e-5);
            }
            cosine += f64::from(a.z);
            sphere += f64::from(b.z);
            cone += f64::from(c.z);
        }
        let n = f64::from(n);
        assert!((cosine / n - 2.0 / 3.0).abs() < 4.5 * 0.236 / n.sqrt());
        assert!((sphere / n).abs() < 4.5 * 0.577 / n.sqrt());
        assert!((cone / n - 0.875).abs() < 4.5 * 0.0722 / n.sqrt());
    }

    #[test]
    fn triangle_points_are_inside_and_centred() {
        let mut s = Stream::new(2, Purpose::Test, 0, 0);
        let (n, mut m) = (100_000, [0.0f64; 2]);
        for _ in 0..n {
            let b = triangle(s.next_2d());
            assert!(b[0] >= 0.0 && b[1] >= 0.0 && b[0] + b[1] <= 1.0 + 1e-6);
            m[0] += f64::from(b[0]);
            m[1] += f64::from(b[1]);
        }
        for v in m {
            assert!((v / f64::from(n) - 1.0 / 3.0).abs() < 4.5 * 0.2357 / f64::from(n).sqrt());
        }
    }
}

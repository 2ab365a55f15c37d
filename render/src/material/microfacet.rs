//! The GGX (Trowbridge–Reitz) microfacet distribution with height-correlated Smith shadowing, isotropic.
//!
//! Forms are chosen so that nothing divides by a vanishing cosine and no half vector is normalised before its small
//! tangential part has been measured; α down to [`ALPHA_RESOLVED`] evaluates within a few per cent in f32.

use crate::math::ops::{INV_PI, PI, cos, safe_sqrt, sin};
use glam::Vec3;

/// The smallest α that f32 directions can resolve: their components carry rounding errors near 1e-7, so a narrower lobe
/// would be evaluated from noise. A rougher-than-zero surface below this limit (perceptual roughness 0.0032) is treated
/// as perfectly smooth, which moves no light by more than about 1e-5 radian but for the lobe's tail, α²/tan²θ of it.
pub const ALPHA_RESOLVED: f32 = 1e-5;

/// Normal distribution D of the half vector `h` (any length > 0) around the unit normal `n`, per solid angle.
#[inline]
pub fn distribution(h: Vec3, n: Vec3, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let hn = h.dot(n);
    let h2 = h.length_squared();
    // α²cos² + sin², with the sine from a cross product: 1 − cos² would lose it.
    let d = a2 * hn * hn + h.cross(n).length_squared();
    let q = h2 / d.max(f32::MIN_POSITIVE);
    a2 * INV_PI * q * q
}

/// √(α² + (1 − α²)c²): what Smith's Λ is made of.
#[inline]
fn smith_root(c: f32, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    (a2 + (1.0 - a2) * c * c).sqrt()
}

/// G2/(4 cos_o cos_i) of the height-correlated Smith function (Heitz 2014), cosines in [0, 1].
#[inline]
pub fn visibility(cos_o: f32, cos_i: f32, alpha: f32) -> f32 {
    let d = cos_o * smith_root(cos_i, alpha) + cos_i * smith_root(cos_o, alpha);
    0.5 / d.max(f32::MIN_POSITIVE)
}

/// G1(wo)/cos_o, cosine in [0, 1]: times D·max(0, wo·m) it is the density of visible normals.
#[inline]
pub fn masking_over_cosine(cos_o: f32, alpha: f32) -> f32 {
    2.0 / (cos_o + smith_root(cos_o, alpha))
}

/// Samples a visible normal for `wo` (local frame, z the normal, wo.z ≥ 0) by spherical caps (Dupuy and Benyoub 2023,
/// listing 3). pdf: D·G1·max(0, wo·m)/wo.z per solid angle of m.
#[inline]
pub fn sample_visible_normal(wo: Vec3, alpha: f32, u: [f32; 2]) -> Vec3 {
    let std = Vec3::new(wo.x * alpha, wo.y * alpha, wo.z).normalize_or(Vec3::Z);
    let phi = 2.0 * PI * u[0];
    let z = (1.0 - u[1]) * (1.0 + std.z) - std.z;
    let r = safe_sqrt(1.0 - z * z);
    let h = Vec3::new(r * cos(phi), r * sin(phi), z) + std;
    Vec3::new(h.x * alpha, h.y * alpha, h.z.max(0.0)).normalize_or(Vec3::Z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{Purpose, Stream};

    /// ∫ D cosθ dω = 1 by quadrature in t = tan²θ/α² (d(cos²)-form), for every α.
    #[test]
    fn distribution_is_normalised_over_projected_area() {
        for alpha in [1e-5f32, 1e-3, 0.1, 0.5, 1.0] {
            let n = 200_000;
            let mut sum = 0.0f64;
            for k in 0..n {
                // tan²θ = α² s/(1 − s) maps s in (0, 1) onto the hemisphere; dω cosθ = π d(sin²θ).
                let s = (k as f64 + 0.5) / n as f64;
                let a2 = f64::from(alpha).powi(2);
                let t2 = a2 * s / (1.0 - s);
                let cos2 = 1.0 / (1.0 + t2);
                let dsin2_ds = a2 / (1.0 - s).powi(2) * cos2 * cos2;
                let h = Vec3::new((t2 * cos2).sqrt() as f32, 0.0, cos2.sqrt() as f32);
                sum += f64::from(distribution(h, Vec3::Z, alpha)) * std::f64::consts::PI * dsin2_ds / n as f64;
            }
            assert!((sum - 1.0).abs() < 2e-3, "α {alpha}: {sum}");
        }
    }

    /// D from rounded f32 directions stays near f64 at the limit of resolution. A tangential error δ ≈ 2e-7 of the half
    /// vector, whose length is ≥ 2·0.5, changes D by at most 2·δ/α = 4 %.
    #[test]
    fn distribution_resolves_its_smallest_alpha() {
        let mut s = Stream::new(4, Purpose::Test, 0, 0);
        for _ in 0..10_000 {
            let v = s.next_2d();
            let wo = crate::math::warp::uniform_sphere(v);
            let wo = Vec3::new(wo.x, wo.y, wo.z.abs() + 0.6).normalize();
            let m = sample_visible_normal(wo, ALPHA_RESOLVED, s.next_2d());
            let wi = (m * (2.0 * wo.dot(m)) - wo).normalize();
            let exact = {
                let h = wo.as_dvec3().normalize() + wi.as_dvec3().normalize();
                let (a2, z2) = (f64::from(ALPHA_RESOLVED).powi(2), h.z * h.z);
                a2 * h.length_squared().powi(2) / (std::f64::consts::PI * (a2 * z2 + h.x * h.x + h.y * h.y).powi(2))
            };
            let got = f64::from(distribution(wo + wi, Vec3::Z, ALPHA_RESOLVED));
            assert!((got / exact - 1.0).abs() < 0.05, "{got} {exact}");
        }
    }

    #[test]
    fn everything_is_finite_at_the_extremes() {
        for alpha in [ALPHA_RESOLVED, 1e-3, 1.0] {
            for c in [0.0f32, 1e-30, 1e-10, 1e-3, 1.0] {
                for c2 in [0.0f32, 1e-30, 1e-3, 1.0] {
                    assert!(visibility(c, c2, alpha).is_finite());
                }
                assert!(masking_over_cosine(c, alpha).is_finite());
                let wo = Vec3::new((1.0 - c * c).sqrt(), 0.0, c);
                for u in [[0.0, 0.0], [0.999_999_9, 0.999_999_9], [0.5, 0.0], [0.0, 0.999_999_9]] {
                    let m = sample_visible_normal(wo, alpha, u);
                    assert!(m.is_finite() && (m.length() - 1.0).abs() < 1e-5, "{alpha} {c} {m}");
                }
            }
        }
    }
}

//! Fresnel reflectances.

use crate::math::Rgb;
use crate::math::ops::{pow5, safe_sqrt};

/// Weight of the grazing reflectance in Schlick's approximation, (1 − cosθ)⁵ (Schlick 1994), `cos_theta` in [0, 1].
#[inline]
pub fn schlick_weight(cos_theta: f32) -> f32 {
    pow5((1.0 - cos_theta).clamp(0.0, 1.0))
}

/// Schlick's reflectance between `f0` at normal and `f90` at grazing incidence.
#[inline]
pub fn schlick(f0: Rgb, f90: Rgb, cos_theta: f32) -> Rgb {
    f0.lerp(f90, schlick_weight(cos_theta))
}

/// Unpolarised Fresnel reflectance of a smooth dielectric boundary, in [0, 1].
///
/// `cos_i` in [0, 1] is the cosine on the incident side, `eta` > 0 the index of the far side divided by that of the near
/// side. 1 beyond the critical angle; exactly 0 for `eta` = 1.
#[inline]
pub fn dielectric(cos_i: f32, eta: f32) -> f32 {
    if eta == 1.0 {
        return 0.0;
    }
    let c = cos_i.clamp(0.0, 1.0);
    let Some(t) = refracted_cosine(c, eta) else { return 1.0 };
    let parallel = (eta * c - t) / (eta * c + t);
    let perpendicular = (c - eta * t) / (c + eta * t);
    (0.5 * (parallel * parallel + perpendicular * perpendicular)).min(1.0)
}

/// 1 − [`dielectric`] from the cosines on both sides, without the cancellation of Snell's law near the critical angle.
#[inline]
pub fn transmittance(cos_i: f32, cos_t: f32, eta: f32) -> f32 {
    let (s, p) = (cos_i + eta * cos_t, eta * cos_i + cos_t);
    let four = 4.0 * eta * cos_i * cos_t;
    (0.5 * (four / (s * s) + four / (p * p)).max(0.0)).min(1.0)
}

/// Cosine of the refracted direction (Snell), in [0, 1]; `None` at total internal reflection.
#[inline]
pub fn refracted_cosine(cos_i: f32, eta: f32) -> Option<f32> {
    // 1 − sin²i/η² = (η² − 1 + cos²i)/η², written so that η² − 1 keeps its digits when η is close to 1.
    let numerator = (eta - 1.0) * (eta + 1.0) + cos_i * cos_i;
    (numerator > 0.0).then(|| (safe_sqrt(numerator) / eta).min(1.0))
}

/// Reflectance of a thin slab with parallel faces of reflectance `r` each, all internal reflections summed
/// incoherently: 2r/(1 + r) (pbrt 4th ed. §9.5.3).
#[inline]
pub fn thin_slab(r: f32) -> f32 {
    2.0 * r / (1.0 + r)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dielectric_has_its_known_values() {
        // Normal incidence ((η − 1)/(η + 1))², Brewster's angle without the parallel part, grazing 1.
        assert!((dielectric(1.0, 1.5) - 0.04).abs() < 1e-6);
        assert!((dielectric(1.0, 1.0 / 1.5) - 0.04).abs() < 1e-6);
        let brewster = 1.0 / (1.0f32 + 1.5 * 1.5).sqrt();
        let s = (1.0f32 - 1.5 * 1.5) / (1.0 + 1.5 * 1.5);
        assert!((dielectric(brewster, 1.5) - 0.5 * s * s).abs() < 1e-6);
        assert_eq!(dielectric(0.0, 1.5), 1.0);
        // sin 60° > 1/1.5: total internal reflection.
        assert_eq!(dielectric(0.5, 1.0 / 1.5), 1.0);
        assert_eq!(dielectric(0.0, 1.0), 0.0);
    }

    #[test]
    fn dielectric_is_reciprocal_and_finite_at_the_extremes() {
        for eta in [1.0f32, 1.0 + 1e-6, 1.33, 1.5, 3.0] {
            for i in 0..=1000 {
                let c = i as f32 / 1000.0;
                let r = dielectric(c, eta);
                assert!((0.0..=1.0).contains(&r), "{eta} {c} {r}");
                let t = refracted_cosine(c, eta).unwrap_or(0.0);
                // Recovering c² from t costs η² 1e-7, which is 1e-5 in c at 0.05, and R changes by 6 per unit of c.
                if t > 0.05 && c > 0.05 {
                    assert!((transmittance(c, t, eta) - (1.0 - r)).abs() < 1e-5, "{eta} {c}");
                    assert!((dielectric(t, 1.0 / eta) - r).abs() < 1e-4, "{eta} {c} {r} {}", dielectric(t, 1.0 / eta));
                }
            }
        }
    }
}

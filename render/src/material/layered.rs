//! The opaque part of a glTF material: one Schlick reflection lobe (metal, dielectric coat or their mix, Dirac or GGX)
//! over a Lambertian base.
//!
//! The coat takes from the base what it reflects: f_d = base/π · (1 − E(wo))(1 − E(wi))/(1 − Ē), reciprocal and energy
//! conserving (Kelemen and Szirmay-Kalos 2001; Ashikhmin and Shirley 2000), with E the coat's directional albedo of its
//! strongest channel, so that the factor is separable.

use super::albedo::{self, Split};
use super::fresnel::schlick;
use super::microfacet::{distribution, masking_over_cosine, sample_visible_normal, visibility};
use crate::math::{Frame, Rgb};
use glam::Vec3;

/// A Schlick reflection lobe; both sides of the surface reflect.
#[derive(Clone, Copy, Debug)]
pub struct Reflection {
    /// Reflectance at normal incidence, each channel in [0, 1].
    pub f0: Rgb,
    /// Reflectance at grazing incidence, each channel in [0, 1].
    pub f90: Rgb,
    /// GGX α; 0 is a perfect mirror.
    pub alpha: f32,
}

impl Reflection {
    /// BSDF value of the rough lobe, 1/sr; `n` faces `wo` and `wi` (their cosines with it are positive).
    #[inline]
    pub fn eval(&self, wo: Vec3, wi: Vec3, n: Vec3) -> Rgb {
        let h = wo + wi;
        let half_cos = wo.dot(h) / h.length().max(f32::MIN_POSITIVE);
        let shape = distribution(h, n, self.alpha) * visibility(wo.dot(n), wi.dot(n), self.alpha);
        schlick(self.f0, self.f90, half_cos) * shape
    }
    /// pdf of [`Reflection::sample`] per solid angle.
    #[inline]
    pub fn pdf(&self, wo: Vec3, wi: Vec3, n: Vec3) -> f32 {
        reflection_pdf(wo, wi, n, self.alpha)
    }
    /// Direction for `wo` above the surface `n`; may point below it.
    #[inline]
    pub fn sample(&self, wo: Vec3, n: Vec3, u: [f32; 2]) -> Vec3 {
        if self.alpha == 0.0 { mirror(wo, n) } else { mirror(wo, sample_normal(wo, n, self.alpha, u)) }
    }
    /// Directional albedo at the cosine `cos_o` in [0, 1].
    #[inline]
    pub fn albedo(&self, cos_o: f32) -> Rgb {
        let Split { a, b } = albedo::directional(cos_o, self.alpha);
        self.f0 * a + self.f90 * b
    }
}

/// `w` mirrored about the unit normal `n`.
#[inline]
pub fn mirror(w: Vec3, n: Vec3) -> Vec3 {
    (n * (2.0 * w.dot(n)) - w).normalize()
}

/// A visible GGX normal around `n`, which faces `wo`.
#[inline]
pub fn sample_normal(wo: Vec3, n: Vec3, alpha: f32, u: [f32; 2]) -> Vec3 {
    let frame = Frame::from_normal(n);
    frame.to_scene(sample_visible_normal(frame.to_local(wo), alpha, u))
}

/// pdf of reflecting `wo` into `wi` by a visible normal around `n`, per solid angle.
#[inline]
pub fn reflection_pdf(wo: Vec3, wi: Vec3, n: Vec3, alpha: f32) -> f32 {
    0.25 * masking_over_cosine(wo.dot(n), alpha) * distribution(wo + wi, n, alpha)
}

/// What a coat leaves to the diffuse base: a factor for each of the two directions.
#[derive(Clone, Copy, Debug)]
pub struct Coat {
    f0: f32,
    f90: f32,
    alpha: f32,
    /// 1/(1 − Ē), or 0 where the coat reflects everything.
    inverse_mean: f32,
}

impl Coat {
    /// No coat.
    pub const NONE: Coat = Coat { f0: 0.0, f90: 0.0, alpha: 0.0, inverse_mean: 1.0 };

    /// The coat of reflectances `f0` and `f90` (strongest channel, in [0, 1]).
    #[inline]
    pub fn new(f0: f32, f90: f32, alpha: f32) -> Coat {
        let Split { a, b } = albedo::mean(alpha);
        let rest = 1.0 - (f0 * a + f90 * b);
        Coat { f0, f90, alpha, inverse_mean: if rest > 1e-6 { 1.0 / rest } else { 0.0 } }
    }
    /// 1 − E(cosθ): share of the base's albedo that leaves towards a direction of cosine `cos_o` in [0, 1].
    #[inline]
    pub fn out_weight(&self, cos_o: f32) -> f32 {
        if self.f0 == 0.0 && self.f90 == 0.0 {
            return 1.0;
        }
        let Split { a, b } = albedo::directional(cos_o, self.alpha);
        (1.0 - (self.f0 * a + self.f90 * b)).max(0.0)
    }
    /// (1 − E(cosθ))/(1 − Ē): relative weight of light that arrives at cosine `cos_i`; its cosine-weighted mean is 1.
    #[inline]
    pub fn in_weight(&self, cos_i: f32) -> f32 {
        self.out_weight(cos_i) * self.inverse_mean
    }
}

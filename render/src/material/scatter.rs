//! What integrators ask of a surface point, whatever its material.

use super::{Lobes, TransportMode};
use crate::math::Rgb;
use glam::Vec3;

/// A sampled direction.
#[derive(Clone, Copy, Debug)]
pub struct BsdfSample {
    /// Unit direction, away from the surface.
    pub wi: Vec3,
    /// f·|cosθi|/pdf, the choice of the lobe included; for a Dirac lobe its coefficient over the choice's probability.
    pub weight: Rgb,
    /// Solid-angle pdf of all non-Dirac lobes in the asked set; for a Dirac sample the probability of the choice.
    pub pdf: f32,
    /// The kind of the chosen lobe, exactly one.
    pub lobe: Lobes,
    /// The direction crosses the surface.
    pub transmitted: bool,
}

impl BsdfSample {
    /// Whether the sample comes from a Dirac lobe.
    #[inline]
    pub fn is_specular(&self) -> bool {
        self.lobe == Lobes::SPECULAR
    }
}

/// Scattering at one surface point (the contract is in [`super`]).
///
/// The cosine of the side light comes from is taken with the shading normal and must agree with the geometric side (no
/// light through the back); the other direction needs only the geometric side, so that smooth silhouettes stay lit.
pub trait Scatter {
    /// Kinds of lobe with a nonzero weight here.
    fn lobes(&self) -> Lobes;
    /// The unit geometric normal, on the front side.
    fn geometric_normal(&self) -> Vec3;
    /// The unit shading normal, normal map included, in the hemisphere of the geometric one.
    fn shading_normal(&self) -> Vec3;
    /// BSDF value (1/sr) of the non-Dirac lobes in `lobes`, without the cosine.
    fn eval(&self, wo: Vec3, wi: Vec3, lobes: Lobes, mode: TransportMode) -> Rgb;
    /// pdf of [`Scatter::sample`] per solid angle, of the non-Dirac lobes in `lobes`.
    fn pdf(&self, wo: Vec3, wi: Vec3, lobes: Lobes, mode: TransportMode) -> f32;
    /// [`Scatter::eval`] and [`Scatter::pdf`] of all lobes at once.
    fn eval_pdf(&self, wo: Vec3, wi: Vec3, mode: TransportMode) -> (Rgb, f32);
    /// Samples a direction from the lobes in `lobes`; `u[2]` chooses the lobe. `None` if the sample is absorbed.
    fn sample(&self, wo: Vec3, u: [f32; 3], lobes: Lobes, mode: TransportMode) -> Option<BsdfSample>;
    /// Every direction that the Dirac lobes send `wo` to, each with its whole coefficient (`pdf` is 1): what a ray tree
    /// follows where [`Scatter::sample`] would choose.
    fn dirac_samples(&self, wo: Vec3, mode: TransportMode) -> [Option<BsdfSample>; 3];
    /// ρ(wo) such that the diffuse lobe is ρ(wo)/π · [`Scatter::diffuse_in_weight`]`(wi)`.
    fn diffuse_albedo(&self, wo: Vec3) -> Rgb;
    /// What the coat lets in from `wi`, relative to its cosine-weighted mean; 1 without a coat.
    fn diffuse_in_weight(&self, wi: Vec3) -> f32;
    /// Diffuse and non-diffuse albedo towards `wo`, for Russian roulette (Jensen 2001): P = min(1, max over RGB of d + s).
    ///
    /// Diffuse exact for flat surfaces; rough glass by its smooth Fresnel terms. Neither includes the η² of radiance.
    fn roulette_albedos(&self, wo: Vec3) -> (Rgb, Rgb);

    /// Estimate of the albedo towards `wo`, all lobes, transmission included; each channel in [0, 1].
    #[inline]
    fn albedo(&self, wo: Vec3) -> Rgb {
        let (d, s) = self.roulette_albedos(wo);
        (d + s).map(|v| v.min(1.0))
    }
    /// |cosθ| of `w` with the shading normal.
    #[inline]
    fn cos(&self, w: Vec3) -> f32 {
        w.dot(self.shading_normal()).abs()
    }
    /// |cosθ| of `w` with the geometric normal: what converts pdfs between solid angle and area.
    #[inline]
    fn cos_geometric(&self, w: Vec3) -> f32 {
        w.dot(self.geometric_normal()).abs()
    }
    /// Factor on the throughput of photons and light paths at a shading normal, |wo·ns||wi·ng| / (|wo·ng||wi·ns|)
    /// (Veach 1997, §5.3), where `wo` is where the photon came from. Exactly 1 where the normals agree.
    #[inline]
    fn importance_correction(&self, wo: Vec3, wi: Vec3) -> f32 {
        let (ng, ns) = (self.geometric_normal(), self.shading_normal());
        if ns == ng {
            return 1.0;
        }
        let denominator = (wo.dot(ng) * wi.dot(ns)).abs();
        if denominator > 0.0 { (wo.dot(ns) * wi.dot(ng)).abs() / denominator } else { 0.0 }
    }
}

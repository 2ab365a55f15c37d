//! Dielectric boundaries: solid refracting bodies and thin walls, smooth (Dirac) and rough (Walter et al. 2007).

use super::TransportMode;
use super::fresnel::{dielectric, refracted_cosine, thin_slab, transmittance};
use super::layered::{mirror, reflection_pdf, sample_normal};
use super::microfacet::{ALPHA_RESOLVED, distribution, masking_over_cosine, visibility};
use crate::math::Rgb;
use glam::Vec3;

/// A dielectric boundary.
#[derive(Clone, Copy, Debug)]
pub struct Glass {
    /// Share of the whole material, in (0, 1].
    pub weight: f32,
    /// Multiplies transmitted light once a crossing.
    pub tint: Rgb,
    /// Index of refraction of the inside relative to the outside, ≥ 1.
    pub ior: f32,
    /// A wall too thin to bend light; else the boundary of a solid body.
    pub thin: bool,
    /// GGX α; 0 is smooth.
    pub alpha: f32,
}

/// One side of the boundary as seen from `wo`.
#[derive(Clone, Copy, Debug)]
pub struct Interface {
    /// Shading normal on the side of `wo`.
    pub n: Vec3,
    /// Index beyond the boundary over the index on `wo`'s side; 1 for a thin wall.
    pub eta: f32,
}

/// A direction the glass sends light to.
#[derive(Clone, Copy, Debug)]
pub struct GlassSample {
    /// Unit direction.
    pub wi: Vec3,
    /// For a Dirac lobe its coefficient divided by the choice probability; unset for rough glass.
    pub weight: Rgb,
    /// Probability of choosing this lobe, of a Dirac lobe.
    pub choice: f32,
    /// Crossed the boundary.
    pub transmitted: bool,
}

impl Glass {
    /// α as used: smooth where the transmitted lobe, about (ior − 1)·α wide, is narrower than f32 can resolve.
    pub fn effective_alpha(alpha: f32, ior: f32, thin: bool) -> f32 {
        let width = if thin { alpha } else { alpha * (ior - 1.0) };
        if width < ALPHA_RESOLVED { 0.0 } else { alpha }
    }

    /// The interface seen from `wo`, whose geometric side is `front`.
    #[inline]
    pub fn interface(&self, wo: Vec3, ns: Vec3, front: bool) -> Interface {
        let n = if wo.dot(ns) < 0.0 { -ns } else { ns };
        let eta = match (self.thin, front) {
            (true, _) => 1.0,
            (false, true) => self.ior,
            (false, false) => 1.0 / self.ior,
        };
        Interface { n, eta }
    }

    /// Reflectance and transmittance (with tint) at the cosine `cos_o` on a facet.
    #[inline]
    pub fn split(&self, cos_o: f32, eta: f32) -> (f32, Rgb) {
        let r = if self.thin { thin_slab(dielectric(cos_o, self.ior)) } else { dielectric(cos_o, eta) };
        (r, self.tint * (1.0 - r))
    }

    /// Probability of reflecting at a facet, given what [`Glass::split`] returned.
    #[inline]
    fn reflect_probability(r: f32, t: Rgb) -> f32 {
        let t = t.mean();
        if r + t > 0.0 { r / (r + t) } else { 1.0 }
    }

    /// Factor on transmitted light for the radiance's compression by refraction, 1/η².
    #[inline]
    fn scale(eta: f32, mode: TransportMode) -> f32 {
        match mode {
            TransportMode::Radiance => 1.0 / (eta * eta),
            TransportMode::Importance => 1.0,
        }
    }

    /// Samples a direction; `u[2]` chooses between reflection and transmission. `None` if it leads nowhere.
    #[inline]
    pub fn sample(&self, wo: Vec3, side: Interface, u: [f32; 3], mode: TransportMode) -> Option<GlassSample> {
        let m = if self.alpha == 0.0 { side.n } else { sample_normal(wo, side.n, self.alpha, [u[0], u[1]]) };
        let cos_m = wo.dot(m);
        let (r, t) = self.split(cos_m.abs(), side.eta);
        let p_reflect = Self::reflect_probability(r, t);
        if u[2] < p_reflect {
            let weight = Rgb::splat(r / p_reflect);
            return Some(GlassSample { wi: mirror(wo, m), weight, choice: p_reflect, transmitted: false });
        }
        let choice = 1.0 - p_reflect;
        let wi = if !self.thin {
            refract(wo, m, cos_m, side.eta)?
        } else if self.alpha == 0.0 {
            -wo
        } else {
            let up = mirror(wo, m);
            up - side.n * (2.0 * up.dot(side.n))
        };
        let weight = t * (Self::scale(side.eta, mode) / choice);
        Some(GlassSample { wi, weight, choice, transmitted: true })
    }

    /// Value (1/sr) and pdf (per solid angle) of the rough boundary. `transmitted` says on which geometric side `wi` is.
    #[inline]
    pub fn eval(&self, wo: Vec3, wi: Vec3, side: Interface, transmitted: bool, mode: TransportMode) -> (Rgb, f32) {
        let (cos_o, cos_i) = (wo.dot(side.n), wi.dot(side.n));
        const NOTHING: (Rgb, f32) = (Rgb::BLACK, 0.0);
        if transmitted != (cos_i < 0.0) {
            return NOTHING;
        }
        if !transmitted || self.thin {
            let up = if transmitted { wi - side.n * (2.0 * cos_i) } else { wi };
            let h = wo + up;
            let (r, t) = self.split(wo.dot(h) / h.length().max(f32::MIN_POSITIVE), side.eta);
            let shape = distribution(h, side.n, self.alpha) * visibility(cos_o, cos_i.abs(), self.alpha);
            let p = Self::reflect_probability(r, t);
            let pdf = reflection_pdf(wo, up, side.n, self.alpha);
            return if transmitted { (t * shape, pdf * (1.0 - p)) } else { (Rgb::splat(r * shape), pdf * p) };
        }
        self.eval_refraction(wo, wi, side, mode)
    }

    /// Walter et al. 2007, eqs. 16–21, in the form of pbrt 4th ed. §9.7.
    fn eval_refraction(&self, wo: Vec3, wi: Vec3, side: Interface, mode: TransportMode) -> (Rgb, f32) {
        let (cos_o, cos_i) = (wo.dot(side.n), -wi.dot(side.n));
        let mut h = wo + wi * side.eta;
        if h.dot(side.n) < 0.0 {
            h = -h;
        }
        let m = h.normalize_or_zero();
        let (om, im) = (wo.dot(m), wi.dot(m));
        // A facet seen from behind carries nothing.
        if om <= 0.0 || im >= 0.0 {
            return (Rgb::BLACK, 0.0);
        }
        let through = transmittance(om, -im, side.eta);
        let (r, t) = (1.0 - through, self.tint * through);
        let root = im + om / side.eta;
        // dm/dwi; the difference in `root` is never 0 for facets that refract wo into wi.
        let jacobian = -im / (root * root).max(f32::MIN_POSITIVE);
        let d = distribution(h, side.n, self.alpha);
        let f = 4.0 * visibility(cos_o, cos_i, self.alpha) * d * om * jacobian * Self::scale(side.eta, mode);
        let p = 1.0 - Self::reflect_probability(r, t);
        (t * f, masking_over_cosine(cos_o, self.alpha) * d * om * jacobian * p)
    }
}

/// Refracts `wo` at the facet `m` with `cos_m = wo·m` > 0; `None` at total internal reflection.
#[inline]
fn refract(wo: Vec3, m: Vec3, cos_m: f32, eta: f32) -> Option<Vec3> {
    if eta == 1.0 {
        return Some(-wo);
    }
    let cos_t = refracted_cosine(cos_m.abs(), eta)?;
    Some((m * (cos_m.abs() / eta - cos_t) - wo * (1.0 / eta)).normalize())
}

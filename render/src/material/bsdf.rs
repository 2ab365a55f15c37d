//! The BSDF at one surface point.

use super::glass::Glass;
use super::layered::{Coat, Reflection};
use super::{Lobes, TransportMode};
use crate::math::ops::INV_PI;
use crate::math::warp::cosine_hemisphere;
use crate::math::{Frame, Rgb};
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

/// Scattering at one surface point, every texture already looked up.
///
/// The cosine of the side light comes from is taken with the shading normal and must agree with the geometric side (no
/// light through the back); the other direction needs only the geometric side, so that smooth silhouettes stay lit.
#[derive(Clone, Copy, Debug)]
pub struct Bsdf {
    ng: Vec3,
    ns: Vec3,
    /// Albedo of the Lambertian base, before its coat.
    diffuse: Rgb,
    lobes: Lobes,
    layers: Option<Layers>,
}

/// Everything beyond a bare Lambertian base.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layers {
    pub(super) coat: Coat,
    pub(super) reflection: Option<Reflection>,
    pub(super) glass: Option<Glass>,
}

/// Probabilities of choosing diffuse, reflection and glass; they sum to 1.
type Choice = [f32; 3];

impl Bsdf {
    /// A bare Lambertian surface of the given albedo, reflecting on both sides.
    #[inline]
    pub fn lambert(ng: Vec3, ns: Vec3, albedo: Rgb) -> Bsdf {
        let lobes = if albedo.is_black() { Lobes::NONE } else { Lobes::DIFFUSE };
        Bsdf { ng, ns, diffuse: albedo, lobes, layers: None }
    }

    pub(super) fn layered(ng: Vec3, ns: Vec3, diffuse: Rgb, layers: Layers) -> Bsdf {
        let mut bsdf = Bsdf::lambert(ng, ns, diffuse);
        let kind = |alpha: f32| if alpha == 0.0 { Lobes::SPECULAR } else { Lobes::GLOSSY };
        if let Some(r) = &layers.reflection {
            bsdf.lobes = bsdf.lobes | kind(r.alpha);
        }
        if let Some(g) = &layers.glass {
            bsdf.lobes = bsdf.lobes | kind(g.alpha);
        }
        bsdf.layers = Some(layers);
        bsdf
    }

    /// Kinds of lobe with a nonzero weight here.
    #[inline]
    pub fn lobes(&self) -> Lobes {
        self.lobes
    }
    /// The unit shading normal, normal map included, in the hemisphere of the geometric one.
    #[inline]
    pub fn shading_normal(&self) -> Vec3 {
        self.ns
    }
    /// |cosθ| of `w` with the shading normal.
    #[inline]
    pub fn cos(&self, w: Vec3) -> f32 {
        w.dot(self.ns).abs()
    }

    /// BSDF value (1/sr) of the non-Dirac lobes in `lobes`, without the cosine.
    #[inline]
    pub fn eval(&self, wo: Vec3, wi: Vec3, lobes: Lobes, mode: TransportMode) -> Rgb {
        let lobes = lobes.intersection(self.lobes);
        let transmitted = self.front(wo) != self.front(wi);
        match &self.layers {
            None if transmitted || lobes.is_empty() || !self.lit(wo, wi, mode) => Rgb::BLACK,
            None => self.diffuse * INV_PI,
            Some(layers) => self.eval_layers(layers, wo, wi, lobes, transmitted, mode).0,
        }
    }

    /// pdf of [`Bsdf::sample`] per solid angle, of the non-Dirac lobes in `lobes`.
    #[inline]
    pub fn pdf(&self, wo: Vec3, wi: Vec3, lobes: Lobes, mode: TransportMode) -> f32 {
        let asked = lobes.intersection(self.lobes);
        let transmitted = self.front(wo) != self.front(wi);
        match &self.layers {
            None if transmitted || asked.is_empty() => 0.0,
            None => self.diffuse_pdf(wo, wi, mode),
            Some(layers) => self.eval_layers(layers, wo, wi, asked, transmitted, mode).1,
        }
    }

    /// [`Bsdf::eval`] and [`Bsdf::pdf`] of all lobes at once.
    #[inline]
    pub fn eval_pdf(&self, wo: Vec3, wi: Vec3, mode: TransportMode) -> (Rgb, f32) {
        let transmitted = self.front(wo) != self.front(wi);
        match &self.layers {
            Some(layers) => self.eval_layers(layers, wo, wi, self.lobes, transmitted, mode),
            None if transmitted || self.lobes.is_empty() || !self.lit(wo, wi, mode) => (Rgb::BLACK, 0.0),
            None => (self.diffuse * INV_PI, self.diffuse_pdf(wo, wi, mode)),
        }
    }

    /// Samples a direction from the lobes in `lobes`; `u[2]` chooses the lobe. `None` if the sample is absorbed.
    #[inline]
    pub fn sample(&self, wo: Vec3, u: [f32; 3], lobes: Lobes, mode: TransportMode) -> Option<BsdfSample> {
        let asked = lobes.intersection(self.lobes);
        if asked.is_empty() {
            return None;
        }
        match &self.layers {
            None => {
                let wi = self.sample_diffuse(wo, [u[0], u[1]], mode);
                let pdf = if self.front(wi) == self.front(wo) { self.diffuse_pdf(wo, wi, mode) } else { 0.0 };
                if pdf <= 0.0 {
                    return None;
                }
                let weight = match mode {
                    TransportMode::Radiance => self.diffuse,
                    TransportMode::Importance => self.diffuse * (self.cos(wi) / wi.dot(self.ng).abs()),
                };
                Some(BsdfSample { wi, weight, pdf, lobe: Lobes::DIFFUSE, transmitted: false })
            }
            Some(layers) => self.sample_layers(layers, wo, u, asked, mode),
        }
    }

    /// Every direction that the Dirac lobes send `wo` to, each with its whole coefficient (`pdf` is 1): what a ray tree
    /// follows where [`Bsdf::sample`] would choose.
    pub fn dirac_samples(&self, wo: Vec3, mode: TransportMode) -> [Option<BsdfSample>; 3] {
        let Some(layers) = &self.layers else { return [None; 3] };
        let front = self.front(wo);
        let n = if wo.dot(self.ns) < 0.0 { -self.ns } else { self.ns };
        let coat = layers.reflection.filter(|r| r.alpha == 0.0).and_then(|r| {
            let weight = super::fresnel::schlick(r.f0, r.f90, wo.dot(n));
            self.dirac(r.sample(wo, n, [0.0; 2]), weight, 1.0, front, false)
        });
        let glass = layers.glass.filter(|g| g.alpha == 0.0);
        // The ends of the unit interval choose reflection and transmission.
        let [reflected, refracted] = [(0.0, false), (1.0 - f32::EPSILON, true)].map(|(u, transmitted)| {
            let g = glass?;
            let s = g.sample(wo, g.interface(wo, self.ns, front), [0.0, 0.0, u], mode)?;
            let weight = s.weight * (s.choice * g.weight);
            if s.transmitted == transmitted { self.dirac(s.wi, weight, 1.0, front, transmitted) } else { None }
        });
        [coat, reflected, refracted]
    }

    /// Estimate of the albedo towards `wo`, all lobes, transmission included; each channel in [0, 1].
    #[inline]
    pub fn albedo(&self, wo: Vec3) -> Rgb {
        let (d, s) = self.roulette_albedos(wo, TransportMode::Radiance);
        (d + s).map(|v| v.min(1.0))
    }
    /// ρ(wo) such that the diffuse lobe is ρ(wo)/π · [`Bsdf::diffuse_in_weight`]`(wi)`.
    #[inline]
    pub fn diffuse_albedo(&self, wo: Vec3) -> Rgb {
        match &self.layers {
            None => self.diffuse,
            Some(l) => self.diffuse * l.coat.out_weight(self.cos(wo)),
        }
    }
    /// What the coat lets in from `wi`, relative to its cosine-weighted mean; 1 without a coat.
    #[inline]
    pub fn diffuse_in_weight(&self, wi: Vec3) -> f32 {
        match &self.layers {
            None => 1.0,
            Some(l) => l.coat.in_weight(self.cos(wi)),
        }
    }
    /// Diffuse and non-diffuse albedo towards `wo`, for Russian roulette (Jensen 2001): P = min(1, max over RGB of d + s).
    ///
    /// Diffuse exact for flat surfaces; rough glass by its smooth Fresnel terms. Neither includes the η² of radiance.
    pub fn roulette_albedos(&self, wo: Vec3, _mode: TransportMode) -> (Rgb, Rgb) {
        let Some(l) = &self.layers else { return (self.diffuse, Rgb::BLACK) };
        let cos_o = self.cos(wo).min(1.0);
        let mut s = l.reflection.map_or(Rgb::BLACK, |r| r.albedo(cos_o));
        if let Some(g) = &l.glass {
            let (r, t) = g.split(cos_o, g.interface(wo, self.ns, self.front(wo)).eta);
            s += (Rgb::splat(r) + t) * g.weight;
        }
        (self.diffuse * l.coat.out_weight(cos_o), s)
    }
    /// Factor on the throughput of photons and light paths at a shading normal, |wo·ns||wi·ng| / (|wo·ng||wi·ns|)
    /// (Veach 1997, §5.3), where `wo` is where the photon came from. Exactly 1 where the normals agree.
    #[inline]
    pub fn importance_correction(&self, wo: Vec3, wi: Vec3) -> f32 {
        if self.ns == self.ng {
            return 1.0;
        }
        let denominator = (wo.dot(self.ng) * wi.dot(self.ns)).abs();
        if denominator > 0.0 { (wo.dot(self.ns) * wi.dot(self.ng)).abs() / denominator } else { 0.0 }
    }

    /// |cosθ| of `w` with the geometric normal: what converts pdfs between solid angle and area.
    #[inline]
    pub fn cos_geometric(&self, w: Vec3) -> f32 {
        w.dot(self.ng).abs()
    }

    #[inline]
    fn front(&self, w: Vec3) -> bool {
        w.dot(self.ng) > 0.0
    }

    /// Whether the direction light comes from is on the same side of both normals.
    #[inline]
    fn lit(&self, wo: Vec3, wi: Vec3, mode: TransportMode) -> bool {
        let light = match mode {
            TransportMode::Radiance => wi,
            TransportMode::Importance => wo,
        };
        (light.dot(self.ns) > 0.0) == self.front(light)
    }

    /// pdf of [`Bsdf::sample_diffuse`]; `wo` and `wi` are on the same geometric side.
    #[inline]
    fn diffuse_pdf(&self, wo: Vec3, wi: Vec3, mode: TransportMode) -> f32 {
        if !self.lit(wo, wi, mode) {
            return 0.0;
        }
        match mode {
            TransportMode::Radiance => self.cos(wi) * INV_PI,
            TransportMode::Importance => wi.dot(self.ng).abs() * INV_PI,
        }
    }

    /// Cosine-weighted around the normal whose cosine the sampled direction meets: the shading normal for radiance;
    /// for importance, where the adjoint correction puts |wi·ng| into the integrand, the geometric one.
    #[inline]
    fn sample_diffuse(&self, wo: Vec3, u: [f32; 2], mode: TransportMode) -> Vec3 {
        let normal = match mode {
            TransportMode::Radiance => self.ns,
            TransportMode::Importance => self.ng,
        };
        let local = cosine_hemisphere(u);
        let wi = Frame::from_normal(normal).to_scene(local);
        if self.front(wo) { wi } else { -wi }
    }

    /// Value and pdf of the non-Dirac lobes in `asked` of a layered surface.
    fn eval_layers(
        &self,
        layers: &Layers,
        wo: Vec3,
        wi: Vec3,
        asked: Lobes,
        transmitted: bool,
        mode: TransportMode,
    ) -> (Rgb, f32) {
        let mut f = Rgb::BLACK;
        let mut pdf = 0.0;
        if !asked.intersects(Lobes::NON_DIRAC) {
            return (f, pdf);
        }
        let choice = self.choice(layers, wo, asked, mode);
        let n = if wo.dot(self.ns) < 0.0 { -self.ns } else { self.ns };
        if choice[0] > 0.0 && !transmitted && self.lit(wo, wi, mode) {
            let coat = layers.coat.out_weight(self.cos(wo)) * layers.coat.in_weight(self.cos(wi));
            f += self.diffuse * (coat * INV_PI);
            pdf += choice[0] * self.diffuse_pdf(wo, wi, mode);
        }
        if let Some(r) = &layers.reflection
            && choice[1] > 0.0
            && r.alpha > 0.0
            && !transmitted
            && wi.dot(n) > 0.0
        {
            f += r.eval(wo, wi, n);
            pdf += choice[1] * r.pdf(wo, wi, n);
        }
        if let Some(g) = &layers.glass
            && choice[2] > 0.0
            && g.alpha > 0.0
        {
            let (fg, pg) = g.eval(wo, wi, g.interface(wo, self.ns, self.front(wo)), transmitted, mode);
            f += fg * g.weight;
            pdf += choice[2] * pg;
        }
        (f, pdf)
    }

    /// Choice in proportion to the estimated albedo of each part in `asked`; a part that gives nothing is not chosen.
    fn choice(&self, layers: &Layers, wo: Vec3, asked: Lobes, mode: TransportMode) -> Choice {
        let cos_o = self.cos(wo).min(1.0);
        let mut w: Choice = [0.0; 3];
        // In importance mode the light comes along wo: below the shading normal's horizon the base stays dark.
        let dark = mode == TransportMode::Importance && !self.lit(wo, wo, mode);
        if asked.contains(Lobes::DIFFUSE) && !dark {
            w[0] = self.diffuse.mean() * layers.coat.out_weight(cos_o);
        }
        let has = |alpha: f32| asked.contains(if alpha == 0.0 { Lobes::SPECULAR } else { Lobes::GLOSSY });
        if let Some(r) = &layers.reflection
            && has(r.alpha)
        {
            w[1] = r.albedo(cos_o).mean();
        }
        if let Some(g) = &layers.glass
            && has(g.alpha)
        {
            let (r, t) = g.split(cos_o, g.interface(wo, self.ns, self.front(wo)).eta);
            w[2] = g.weight * (r + t.mean());
        }
        let sum = w[0] + w[1] + w[2];
        if sum > 0.0 { w.map(|v| v / sum) } else { w }
    }

    fn sample_layers(
        &self,
        layers: &Layers,
        wo: Vec3,
        u: [f32; 3],
        asked: Lobes,
        mode: TransportMode,
    ) -> Option<BsdfSample> {
        let choice = self.choice(layers, wo, asked, mode);
        let n = if wo.dot(self.ns) < 0.0 { -self.ns } else { self.ns };
        let front = self.front(wo);
        if u[2] < choice[0] {
            let wi = self.sample_diffuse(wo, [u[0], u[1]], mode);
            return self.finish(layers, wo, wi, asked, Lobes::DIFFUSE, false, mode);
        }
        if u[2] < choice[0] + choice[1] || layers.glass.is_none() || choice[2] == 0.0 {
            let r = layers.reflection.as_ref().filter(|_| choice[1] > 0.0)?;
            let wi = r.sample(wo, n, [u[0], u[1]]);
            if wi.dot(n) <= 0.0 {
                return None;
            }
            if r.alpha > 0.0 {
                return self.finish(layers, wo, wi, asked, Lobes::GLOSSY, false, mode);
            }
            let weight = super::fresnel::schlick(r.f0, r.f90, wo.dot(n)) * (1.0 / choice[1]);
            return self.dirac(wi, weight, choice[1], front, false);
        }
        let g = layers.glass.as_ref()?;
        let rest = ((u[2] - choice[0] - choice[1]) / choice[2]).clamp(0.0, 1.0 - f32::EPSILON);
        let s = g.sample(wo, g.interface(wo, self.ns, front), [u[0], u[1], rest], mode)?;
        if (s.wi.dot(n) < 0.0) != s.transmitted {
            return None;
        }
        if g.alpha > 0.0 {
            return self.finish(layers, wo, s.wi, asked, Lobes::GLOSSY, s.transmitted, mode);
        }
        self.dirac(s.wi, s.weight * (g.weight / choice[2]), s.choice * choice[2], front, s.transmitted)
    }

    /// A Dirac sample, if its direction is on the geometric side it should be on.
    fn dirac(&self, wi: Vec3, weight: Rgb, choice: f32, front: bool, transmitted: bool) -> Option<BsdfSample> {
        let valid = (self.front(wi) == front) != transmitted;
        valid.then_some(BsdfSample { wi, weight, pdf: choice, lobe: Lobes::SPECULAR, transmitted })
    }

    /// A sample of a non-Dirac lobe: weight and pdf over all non-Dirac lobes asked for.
    #[allow(clippy::too_many_arguments)]
    fn finish(
        &self,
        layers: &Layers,
        wo: Vec3,
        wi: Vec3,
        asked: Lobes,
        lobe: Lobes,
        transmitted: bool,
        mode: TransportMode,
    ) -> Option<BsdfSample> {
        if (self.front(wo) != self.front(wi)) != transmitted {
            return None;
        }
        let (f, pdf) = self.eval_layers(layers, wo, wi, asked, transmitted, mode);
        let weight = f * (self.cos(wi) / pdf);
        (pdf > 0.0 && weight.is_finite()).then_some(BsdfSample { wi, weight, pdf, lobe, transmitted })
    }
}

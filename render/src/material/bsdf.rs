//! The BSDF at one surface point.

use super::glass::Glass;
use super::lambert::Lambert;
use super::layered::{Coat, Reflection};
use super::{BsdfSample, Lobes, Scatter, TransportMode};
use crate::math::Rgb;
use crate::math::ops::INV_PI;
use glam::Vec3;

/// Scattering at one surface point, every texture already looked up.
#[derive(Clone, Copy, Debug)]
pub struct Bsdf {
    /// The base, before its coat.
    base: Lambert,
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

impl From<Lambert> for Bsdf {
    #[inline]
    fn from(base: Lambert) -> Bsdf {
        Bsdf { base, lobes: base.lobes(), layers: None }
    }
}

impl Scatter for Bsdf {
    #[inline]
    fn lobes(&self) -> Lobes {
        self.lobes
    }
    #[inline]
    fn geometric_normal(&self) -> Vec3 {
        self.base.ng
    }
    #[inline]
    fn shading_normal(&self) -> Vec3 {
        self.base.ns
    }
    #[inline]
    fn eval(&self, wo: Vec3, wi: Vec3, lobes: Lobes, mode: TransportMode) -> Rgb {
        match &self.layers {
            None => self.base.eval(wo, wi, lobes, mode),
            Some(layers) => self.eval_layers(layers, wo, wi, lobes.intersection(self.lobes), mode).0,
        }
    }
    #[inline]
    fn pdf(&self, wo: Vec3, wi: Vec3, lobes: Lobes, mode: TransportMode) -> f32 {
        match &self.layers {
            None => self.base.pdf(wo, wi, lobes, mode),
            Some(layers) => self.eval_layers(layers, wo, wi, lobes.intersection(self.lobes), mode).1,
        }
    }
    #[inline]
    fn eval_pdf(&self, wo: Vec3, wi: Vec3, mode: TransportMode) -> (Rgb, f32) {
        match &self.layers {
            None => self.base.eval_pdf(wo, wi, mode),
            Some(layers) => self.eval_layers(layers, wo, wi, self.lobes, mode),
        }
    }
    #[inline]
    fn sample(&self, wo: Vec3, u: [f32; 3], lobes: Lobes, mode: TransportMode) -> Option<BsdfSample> {
        let Some(layers) = &self.layers else { return self.base.sample(wo, u, lobes, mode) };
        let asked = lobes.intersection(self.lobes);
        if asked.is_empty() { None } else { self.sample_layers(layers, wo, u, asked, mode) }
    }

    fn dirac_samples(&self, wo: Vec3, mode: TransportMode) -> [Option<BsdfSample>; 3] {
        let Some(layers) = &self.layers else { return [None; 3] };
        let front = self.base.front(wo);
        let n = if wo.dot(self.base.ns) < 0.0 { -self.base.ns } else { self.base.ns };
        let coat = layers.reflection.filter(|r| r.alpha == 0.0).and_then(|r| {
            let weight = super::fresnel::schlick(r.f0, r.f90, wo.dot(n));
            self.dirac(r.sample(wo, n, [0.0; 2]), weight, 1.0, front, false)
        });
        let glass = layers.glass.filter(|g| g.alpha == 0.0);
        // The ends of the unit interval choose reflection and transmission.
        let [reflected, refracted] = [(0.0, false), (1.0 - f32::EPSILON, true)].map(|(u, transmitted)| {
            let g = glass?;
            let s = g.sample(wo, g.interface(wo, self.base.ns, front), [0.0, 0.0, u], mode)?;
            let weight = s.weight * (s.choice * g.weight);
            if s.transmitted == transmitted { self.dirac(s.wi, weight, 1.0, front, transmitted) } else { None }
        });
        [coat, reflected, refracted]
    }
    #[inline]
    fn diffuse_albedo(&self, wo: Vec3) -> Rgb {
        match &self.layers {
            None => self.base.albedo,
            Some(l) => self.base.albedo * l.coat.out_weight(self.cos(wo)),
        }
    }
    #[inline]
    fn diffuse_in_weight(&self, wi: Vec3) -> f32 {
        match &self.layers {
            None => 1.0,
            Some(l) => l.coat.in_weight(self.cos(wi)),
        }
    }
    fn roulette_albedos(&self, wo: Vec3) -> (Rgb, Rgb) {
        let Some(l) = &self.layers else { return (self.base.albedo, Rgb::BLACK) };
        let cos_o = self.cos(wo).min(1.0);
        let mut s = l.reflection.map_or(Rgb::BLACK, |r| r.albedo(cos_o));
        if let Some(g) = &l.glass {
            let (r, t) = g.split(cos_o, g.interface(wo, self.base.ns, self.base.front(wo)).eta);
            s += (Rgb::splat(r) + t) * g.weight;
        }
        (self.base.albedo * l.coat.out_weight(cos_o), s)
    }
}

impl Bsdf {
    pub(super) fn layered(base: Lambert, layers: Layers) -> Bsdf {
        let mut lobes = base.lobes();
        let kind = |alpha: f32| if alpha == 0.0 { Lobes::SPECULAR } else { Lobes::GLOSSY };
        if let Some(r) = &layers.reflection {
            lobes = lobes | kind(r.alpha);
        }
        if let Some(g) = &layers.glass {
            lobes = lobes | kind(g.alpha);
        }
        Bsdf { base, lobes, layers: Some(layers) }
    }

    /// Value and pdf of the non-Dirac lobes in `asked` of a layered surface.
    fn eval_layers(&self, layers: &Layers, wo: Vec3, wi: Vec3, asked: Lobes, mode: TransportMode) -> (Rgb, f32) {
        let transmitted = self.base.front(wo) != self.base.front(wi);
        let mut f = Rgb::BLACK;
        let mut pdf = 0.0;
        if !asked.intersects(Lobes::NON_DIRAC) {
            return (f, pdf);
        }
        let choice = self.choice(layers, wo, asked, mode);
        let n = if wo.dot(self.base.ns) < 0.0 { -self.base.ns } else { self.base.ns };
        if choice[0] > 0.0 && !transmitted && self.base.lit(wo, wi, mode) {
            let coat = layers.coat.out_weight(self.cos(wo)) * layers.coat.in_weight(self.cos(wi));
            f += self.base.albedo * (coat * INV_PI);
            pdf += choice[0] * self.base.direction_pdf(wo, wi, mode);
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
            let (fg, pg) = g.eval(wo, wi, g.interface(wo, self.base.ns, self.base.front(wo)), transmitted, mode);
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
        let dark = mode == TransportMode::Importance && !self.base.lit(wo, wo, mode);
        if asked.contains(Lobes::DIFFUSE) && !dark {
            w[0] = self.base.albedo.mean() * layers.coat.out_weight(cos_o);
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
            let (r, t) = g.split(cos_o, g.interface(wo, self.base.ns, self.base.front(wo)).eta);
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
        let n = if wo.dot(self.base.ns) < 0.0 { -self.base.ns } else { self.base.ns };
        let front = self.base.front(wo);
        if u[2] < choice[0] {
            let wi = self.base.direction(wo, [u[0], u[1]], mode);
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
        let s = g.sample(wo, g.interface(wo, self.base.ns, front), [u[0], u[1], rest], mode)?;
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
        let valid = (self.base.front(wi) == front) != transmitted;
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
        if (self.base.front(wo) != self.base.front(wi)) != transmitted {
            return None;
        }
        let (f, pdf) = self.eval_layers(layers, wo, wi, asked, mode);
        let weight = f * (self.cos(wi) / pdf);
        (pdf > 0.0 && weight.is_finite()).then_some(BsdfSample { wi, weight, pdf, lobe, transmitted })
    }
}

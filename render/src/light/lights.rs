//! All lights of a scene, and the choice among them.

use super::{AreaLight, EmissiveTriangle, Light, LightContext};
use crate::math::{AliasTable, Rgb};

/// Chooses lights in proportion to their power.
#[derive(Clone, Debug)]
pub struct LightSelector {
    table: Option<AliasTable>,
}

impl LightSelector {
    /// A selector for lights of these powers: the mean over the channels counts.
    pub fn new(powers: &[Rgb]) -> LightSelector {
        // In f64 the sum of three large channels cannot overflow.
        let weights: Vec<f64> =
            powers.iter().map(|p| (f64::from(p.r) + f64::from(p.g) + f64::from(p.b)) / 3.0).collect();
        LightSelector { table: AliasTable::new(&weights) }
    }
    /// A light and its probability; `None` if nothing emits.
    #[inline]
    pub fn sample(&self, u: f32) -> Option<(usize, f32)> {
        self.table.as_ref().map(|t| t.sample(u))
    }
    /// A light, its probability, and what is left of `u` ([`AliasTable::sample_with_rest`]); `None` if nothing emits.
    #[inline]
    pub fn sample_with_rest(&self, u: f64) -> Option<(usize, f32, f64)> {
        self.table.as_ref().map(|t| t.sample_with_rest(u))
    }
    /// Probability of light `i`.
    #[inline]
    pub fn pmf(&self, i: usize) -> f32 {
        match &self.table {
            Some(t) if i < t.len() => t.pmf(i),
            _ => 0.0,
        }
    }
    /// Nothing emits.
    pub fn is_empty(&self) -> bool {
        self.table.is_none()
    }
}

/// The lights of a scene: first one per emissive triangle, in the order given, then the punctual ones.
#[derive(Clone, Debug)]
pub struct Lights {
    lights: Vec<Light>,
    area_count: usize,
    selector: LightSelector,
}

impl Lights {
    /// Prepares the lights. `emitters[i]` becomes light `i`, so that `Instance::first_emitter + triangle` is the index
    /// of a light; `punctual` follows.
    pub fn build(emitters: &[EmissiveTriangle], punctual: Vec<Light>, ctx: &LightContext) -> Lights {
        let mut lights: Vec<Light> = emitters.iter().map(|e| Light::Area(AreaLight::new(e, ctx))).collect();
        let area_count = lights.len();
        lights.extend(punctual);
        let powers: Vec<Rgb> = lights.iter().map(Light::power).collect();
        let selector = LightSelector::new(&powers);
        Lights { lights, area_count, selector }
    }
    /// Every light.
    #[inline]
    pub fn as_slice(&self) -> &[Light] {
        &self.lights
    }
    /// Light `i`.
    #[inline]
    pub fn get(&self, i: usize) -> Option<&Light> {
        self.lights.get(i)
    }
    /// The choice in proportion to power.
    #[inline]
    pub fn selector(&self) -> &LightSelector {
        &self.selector
    }
    /// Number of lights that are emissive triangles; they come first.
    pub fn area_count(&self) -> usize {
        self.area_count
    }
    /// Number of lights.
    pub fn len(&self) -> usize {
        self.lights.len()
    }
    /// There is no light.
    pub fn is_empty(&self) -> bool {
        self.lights.is_empty()
    }
    /// Total emitted power, folded in index order.
    pub fn total_power(&self) -> Rgb {
        let sum = self.lights.iter().fold([0.0f64; 3], |s, l| {
            let p = l.power().to_array();
            std::array::from_fn(|k| s[k] + f64::from(p[k]))
        });
        Rgb::from(sum.map(|v| v as f32))
    }
}

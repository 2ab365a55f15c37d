//! All lights of a scene, and the choice among them.

use super::{AreaLight, EmissiveTriangle, Light, LightContext};
use crate::math::{AliasTable, Rgb};

/// Share of the choice that goes to all lights that emit, each alike. By power alone, what only a dim light reaches would stay
/// black beside a bright one: at a ratio of 1e12, for 1e12 samples. The brightest loses this share of its samples at most.
const EVEN_SHARE: f64 = 1.0 / 16.0;

/// Chooses lights in proportion to their power, and for a small share without regard to it.
#[derive(Clone, Debug)]
pub struct LightSelector {
    table: Option<AliasTable>,
}

impl LightSelector {
    /// A selector for lights of these powers: the mean over the channels counts.
    pub fn new(powers: &[Rgb]) -> LightSelector {
        // In f64 the sum of three large channels cannot overflow, and neither can that of all lights.
        let mean = |p: &Rgb| (f64::from(p.r) + f64::from(p.g) + f64::from(p.b)) / 3.0;
        let emits = |w: f64| w.is_finite() && w > 0.0;
        let own: Vec<f64> = powers.iter().map(mean).map(|w| if emits(w) { w } else { 0.0 }).collect();
        let lit = own.iter().filter(|&&w| w > 0.0).count();
        let (total, each) = (own.iter().sum::<f64>(), EVEN_SHARE / lit.max(1) as f64);
        let weight = |w: &f64| if *w > 0.0 { (1.0 - EVEN_SHARE) * (w / total) + each } else { 0.0 };
        LightSelector { table: AliasTable::new(&own.iter().map(weight).collect::<Vec<f64>>()) }
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
    /// The choice among them.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dim_light_keeps_its_share_beside_a_bright_one() {
        let powers = [1e12f32, 1.0, 0.0, f32::NAN, 1e-20].map(Rgb::splat);
        let selector = LightSelector::new(&powers);
        let pmf = |i| f64::from(selector.pmf(i));
        assert_eq!([pmf(2), pmf(3)], [0.0; 2]);
        for (i, expected) in [(0, 15.0 / 16.0 + 1.0 / 48.0), (1, 1.0 / 48.0), (4, 1.0 / 48.0)] {
            assert!((pmf(i) - expected).abs() < 1e-6, "{i}: {}", pmf(i));
        }
        // The numbers that paths choose by are of single precision: they must find it as often as its probability says.
        let n = 1 << 20;
        let found = (0..n).filter(|k| selector.sample(*k as f32 / n as f32).is_some_and(|(i, _)| i == 4)).count();
        assert!((found as f64 / f64::from(n) - 1.0 / 48.0).abs() < 1e-5, "{found}");
    }

    #[test]
    fn equal_lights_are_chosen_alike_and_powers_of_two_change_nothing() {
        let powers = |f: f32| [3.0, 0.5, 7.0].map(|w| Rgb::splat(w * f));
        let [a, b] = [1.0, 1.0 / 1024.0].map(|f| LightSelector::new(&powers(f)));
        assert!((0..3).all(|i| a.pmf(i) == b.pmf(i)));
        assert_eq!(LightSelector::new(&[Rgb::WHITE; 4]).pmf(2), 0.25);
        assert!(LightSelector::new(&[Rgb::BLACK; 2]).is_empty());
    }
}

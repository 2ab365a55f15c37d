//! Next-event estimation: light that arrives straight from a light (Veach 1997, §8 and §9).

use crate::geometry::{Ray, SurfacePoint};
use crate::light::Light;
use crate::math::{Numbers, Rgb};
use crate::scene::Scene;
use glam::Vec3;

/// Spacing of the numbers that samplers give.
const DIGIT: f64 = 1.0 / 16_777_216.0;
/// The largest number below 1.
const BELOW_ONE: f32 = 1.0 - 0.5 * f32::EPSILON;

/// A direction towards a light, not yet tested for occlusion.
#[derive(Clone, Copy, Debug)]
pub struct LightDirection {
    /// Unit direction to the light.
    pub wi: Vec3,
    /// Radiance that arrives if nothing blocks, divided by `pdf`.
    pub weighted_radiance: Rgb,
    /// pdf per solid angle with the light's selection in it; infinite for Dirac lights, which BSDF sampling cannot find.
    pub pdf: f32,
    /// Distance to the light; infinite for directional lights.
    pub distance: f32,
    /// Index of the light.
    pub light: usize,
    /// Expected number of samples of it: the probability of choosing it, or 1.
    pub pmf: f32,
    /// From the point to the light.
    pub shadow: Ray,
}

impl LightDirection {
    /// Chooses a light and a point on it. Always takes three numbers.
    #[inline]
    pub fn sample(scene: &Scene, point: &SurfacePoint, numbers: &mut impl Numbers) -> Option<Self> {
        let (u_fine, u) = (numbers.next_1d(), numbers.next_2d());
        // One number chooses the light and the place on it, so that the samples of each light stay stratified in both their
        // dimensions; the third number only fills the digits that the choice among many lights uses up.
        let u_both = f64::from(u[0]) + f64::from(u_fine) * DIGIT;
        let (index, pmf, rest) = scene.lights.selector().sample_with_rest(u_both)?;
        Self::towards(scene, point, index, pmf, [(rest as f32).min(BELOW_ONE), u[1]])
    }

    /// A point on light `index`, of which `count` samples are expected: the light's probability where one of all is chosen, 1
    /// where each is asked. [`LightDirection::pdf`] and [`LightDirection::weighted_radiance`] have it in them.
    #[inline]
    pub fn towards(scene: &Scene, point: &SurfacePoint, index: usize, count: f32, u: [f32; 2]) -> Option<Self> {
        let s = scene.lights.get(index)?.sample_li(&scene.light_context(), point.position, u)?;
        let pdf = count * s.pdf;
        if pdf <= 0.0 || !pdf.is_finite() {
            return None;
        }
        let origin = point.spawn(s.wi);
        let span = s.shadow_target - origin;
        let length = span.length();
        if length <= 0.0 {
            return None;
        }
        let shadow = Ray::segment(origin, span * length.recip(), length);
        Some(LightDirection {
            wi: s.wi,
            weighted_radiance: s.radiance * (1.0 / pdf),
            pdf: if s.is_dirac { f32::INFINITY } else { pdf },
            distance: s.distance,
            light: index,
            pmf: count,
            shadow,
        })
    }

    /// Whether the light is seen.
    #[inline]
    pub fn is_visible(&self, scene: &Scene) -> bool {
        !scene.occluded(&self.shadow)
    }
}

/// pdf per solid angle with which [`LightDirection::sample`] from `from` would have given the direction `wi`, which met
/// the emissive surface `hit` at `distance`.
#[inline]
pub fn light_pdf(scene: &Scene, from: Vec3, wi: Vec3, distance: f32, hit: &SurfacePoint) -> f32 {
    let Some((light, pmf)) = light_at(scene, hit) else { return 0.0 };
    pmf * light.pdf_li(from, wi, distance)
}

/// The light whose surface `hit` is on, and the probability of choosing it.
#[inline]
pub fn light_at<'a>(scene: &'a Scene, hit: &SurfacePoint) -> Option<(&'a Light, f32)> {
    let first = scene.instances[hit.instance as usize].first_emitter?;
    let index = (first + hit.triangle) as usize;
    Some((scene.lights.get(index)?, scene.lights.selector().pmf(index)))
}

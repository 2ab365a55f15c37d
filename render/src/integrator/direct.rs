//! Next-event estimation: light that arrives straight from a light (Veach 1997, §8 and §9).

use crate::geometry::{Ray, SurfacePoint};
use crate::math::Rgb;
use crate::math::sobol::Sampler;
use crate::scene::Scene;
use glam::Vec3;

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
    shadow: Ray,
}

impl LightDirection {
    /// Chooses a light and a point on it. Always takes three numbers from `sampler`.
    #[inline]
    pub fn sample(scene: &Scene, point: &SurfacePoint, sampler: &mut Sampler) -> Option<Self> {
        let (u_light, u) = (sampler.next_1d(), sampler.next_2d());
        let (index, pmf) = scene.lights.selector().sample(u_light)?;
        Self::towards(scene, point, index, pmf, u)
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
    let Some(first) = scene.instances[hit.instance as usize].first_emitter else { return 0.0 };
    let index = (first + hit.triangle) as usize;
    let Some(light) = scene.lights.get(index) else { return 0.0 };
    scene.lights.selector().pmf(index) * light.pdf_li(from, wi, distance)
}

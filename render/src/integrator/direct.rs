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
        let (light, pmf) = scene.lights.select(u_light)?;
        let s = light.sample_li(point.position, u)?;
        let pdf = pmf * s.pdf;
        if pdf <= 0.0 || !pdf.is_finite() {
            return None;
        }
        let origin = point.spawn(s.wi);
        let shadow = s.shadow_ray(origin);
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

/// pdf per solid angle with which [`LightDirection::sample`] would have found the emissive surface `hit` from `from`.
#[inline]
pub fn light_pdf(scene: &Scene, from: Vec3, hit: &SurfacePoint) -> f32 {
    scene.lights.pdf_li(&scene.instances, from, hit)
}

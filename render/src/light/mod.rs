//! Lights: emissive triangles, point, spot and directional lights, and their choice by power.
//!
//! Everything is in scene space. `sample_li` looks from a point towards a light (next-event estimation), `sample_le`
//! starts a photon path at it. Quantities: radiance L per channel, intensity I of point and spot lights, irradiance E of
//! directional lights on a plane that faces them, power Φ.

pub mod area;
pub mod lights;
pub mod punctual;
pub mod spherical_triangle;

pub use area::{AreaLight, EmissiveTriangle};
pub use lights::{LightSelector, Lights};
pub use punctual::{DirectionalLight, PointLight, SpotLight};

use crate::geometry::offset_origin;
use crate::material::{Material, Textures};
use crate::math::Rgb;
use glam::Vec3;

/// What evaluating a textured light needs.
#[derive(Clone, Copy, Debug)]
pub struct LightContext<'a> {
    /// The scene's materials.
    pub materials: &'a [Material],
    /// The scene's textures.
    pub textures: &'a Textures,
}

/// One light.
#[derive(Clone, Debug)]
pub enum Light {
    /// An emissive triangle.
    Area(AreaLight),
    /// Isotropic point.
    Point(PointLight),
    /// Point with a cone.
    Spot(SpotLight),
    /// Parallel light from infinity.
    Directional(DirectionalLight),
}

/// A direction towards a light.
#[derive(Clone, Copy, Debug)]
pub struct LightLiSample {
    /// Unit direction to the light.
    pub wi: Vec3,
    /// Distance to the point on the light; infinite for directional lights.
    pub distance: f32,
    /// Radiance that arrives along `wi` if nothing is between; for Dirac lights the irradiance on a facing plane
    /// (I/d², or E), to be used with `pdf` 1.
    pub radiance: Rgb,
    /// pdf of `wi` per solid angle; 1 for Dirac lights.
    pub pdf: f32,
    /// No other technique can find this direction.
    pub is_dirac: bool,
    /// Where the shadow ray ends: for an area light moved off its surface by the bound on its rounding error, for a
    /// directional light far outside the scene.
    pub shadow_target: Vec3,
}

/// The start of a photon path.
#[derive(Clone, Copy, Debug)]
pub struct EmissionSample {
    /// Start of the ray, already off the light's surface.
    pub origin: Vec3,
    /// Unit normal of the light's surface on the emitting side; `None` for punctual lights.
    pub normal: Option<Vec3>,
    /// Unit direction of flight.
    pub direction: Vec3,
    /// Le·|cosθ|/(pdf_position·pdf_direction), not divided by the probability of choosing this light.
    pub power: Rgb,
    /// pdf of `origin` per area; 1 for point and spot lights.
    pub pdf_position: f32,
    /// pdf of `direction` per solid angle; 1 for directional lights.
    pub pdf_direction: f32,
}

/// A point on a light from which photons may start, chosen by [`Light::sample_point`].
#[derive(Clone, Copy, Debug)]
pub struct EmissionPoint {
    /// The point, on the surface of the light.
    pub position: Vec3,
    /// Bound on the absolute rounding error of `position`, per axis; zero for punctual lights.
    pub error: Vec3,
    /// Unit geometric normal of the front; `None` for punctual lights.
    pub normal: Option<Vec3>,
    /// Emitted radiance (area), peak intensity (point, spot) at the point.
    pub emission: Rgb,
    /// pdf of the point per area; 1 for point and spot lights.
    pub pdf: f32,
}

impl Light {
    /// Samples a direction from `from` to this light. `None` where it does not shine.
    #[inline]
    pub fn sample_li(&self, ctx: &LightContext, from: Vec3, u: [f32; 2]) -> Option<LightLiSample> {
        match self {
            Light::Area(l) => l.sample_li(ctx, from, u),
            Light::Point(l) => l.sample_li(from),
            Light::Spot(l) => l.sample_li(from),
            Light::Directional(l) => l.sample_li(from),
        }
    }
    /// pdf per solid angle with which [`Light::sample_li`] from `from` gives the direction `wi`, known to hit this light
    /// at `distance`; 0 for Dirac lights.
    #[inline]
    pub fn pdf_li(&self, from: Vec3, wi: Vec3, distance: f32) -> f32 {
        match self {
            Light::Area(l) => l.pdf_li(from, wi, distance),
            _ => 0.0,
        }
    }
    /// Samples the start of a photon path.
    #[inline]
    pub fn sample_le(&self, ctx: &LightContext, u_position: [f32; 2], u_direction: [f32; 2]) -> Option<EmissionSample> {
        match self {
            Light::Area(l) => l.sample_le(ctx, u_position, u_direction),
            Light::Point(l) => Some(l.sample_le(u_direction)),
            Light::Spot(l) => l.sample_le(u_direction),
            Light::Directional(l) => Some(l.sample_le(u_position)),
        }
    }
    /// Total emitted power Φ.
    pub fn power(&self) -> Rgb {
        match self {
            Light::Area(l) => l.power(),
            Light::Point(l) => l.power(),
            Light::Spot(l) => l.power(),
            Light::Directional(l) => l.power(),
        }
    }
    /// A point on the light, for emission in a direction that the caller chooses; `None` for directional lights and
    /// where the light is black.
    pub fn sample_point(&self, ctx: &LightContext, u: [f32; 2]) -> Option<EmissionPoint> {
        match self {
            Light::Area(l) => l.sample_point(ctx, u),
            Light::Point(l) => Some(EmissionPoint {
                position: l.position,
                error: Vec3::ZERO,
                normal: None,
                emission: l.intensity,
                pdf: 1.0,
            }),
            Light::Spot(l) => Some(EmissionPoint {
                position: l.position,
                error: Vec3::ZERO,
                normal: None,
                emission: l.intensity,
                pdf: 1.0,
            }),
            Light::Directional(_) => None,
        }
    }
    /// What `point` emits towards the unit `direction`: L·|cosθ| for area lights, intensity for point and spot lights.
    /// Divided by the point's pdf and that of the direction it is the power of a photon.
    #[inline]
    pub fn emitted(&self, point: &EmissionPoint, direction: Vec3) -> Rgb {
        match self {
            Light::Area(l) => {
                let c = point.normal.map_or(0.0, |n| n.dot(direction));
                point.emission * if l.double_sided { c.abs() } else { c.max(0.0) }
            }
            Light::Spot(l) => point.emission * l.falloff(direction),
            _ => point.emission,
        }
    }
    /// pdf per solid angle with which [`Light::sample_le`] leaves `point` along `direction`; 0 for directional lights.
    #[inline]
    pub fn pdf_direction(&self, point: &EmissionPoint, direction: Vec3) -> f32 {
        match self {
            Light::Area(l) => l.pdf_direction(point.normal.map_or(0.0, |n| n.dot(direction))),
            Light::Point(_) => punctual::SPHERE_PDF,
            Light::Spot(l) => l.pdf_direction(direction),
            Light::Directional(_) => 0.0,
        }
    }
    /// How densely the paths of [`Light::sample_le`] land, in proportion to how densely [`Light::sample_li`] looks there.
    ///
    /// Emitted along `flight` over `distance`, paths land with pdf (per area) `landing_density` · cosθ / p, where θ is the
    /// angle on the surface they meet and p the pdf per solid angle of `sample_li` from there (1 for Dirac lights), relative
    /// to the pdf with which `sample_li` chooses the point they come from. That is emissionPdf·cosθ/(directPdf·cosθ_light)
    /// of SmallVCM with the terms that cancel left out: 1/(area · π) for each face of an area light, pdf of the direction
    /// over distance² of point and spot lights, 1/(area of the disc) of directional ones.
    #[inline]
    pub fn landing_density(&self, flight: Vec3, distance: f32) -> f64 {
        let per_square = |pdf: f32| f64::from(pdf) / (f64::from(distance) * f64::from(distance));
        match self {
            Light::Area(l) => l.density_per_etendue(),
            Light::Point(_) => per_square(punctual::SPHERE_PDF),
            Light::Spot(l) => per_square(l.pdf_direction(flight)),
            Light::Directional(l) => l.pdf_position(),
        }
    }
    /// Whether its `sample_li` is a Dirac direction.
    #[inline]
    pub fn is_dirac(&self) -> bool {
        !matches!(self, Light::Area(_))
    }
}

impl EmissionPoint {
    /// Start of a ray along `direction`, off the surface by the bound on the rounding error.
    #[inline]
    pub fn spawn(&self, direction: Vec3) -> Vec3 {
        self.normal.map_or(self.position, |n| offset_origin(self.position, self.error, n, direction))
    }
}

#[cfg(test)]
mod tests;

//! Point, spot and directional lights (KHR_lights_punctual).

use super::{EmissionSample, LightLiSample};
use crate::math::ops::{PI, cbrt, cos, safe_sqrt, sin, sin64};
use crate::math::warp::{disc, uniform_sphere};
use crate::math::{Frame, Rgb};
use glam::Vec3;

/// 1/(4π): the pdf of a uniform direction.
pub(super) const SPHERE_PDF: f32 = 0.25 * crate::math::ops::INV_PI;
/// Shadow rays to directional lights end at this many scene radii.
const FAR: f32 = 4.0;

/// An isotropic point light.
#[derive(Clone, Copy, Debug)]
pub struct PointLight {
    /// Position.
    pub position: Vec3,
    /// Intensity I, per steradian.
    pub intensity: Rgb,
}

/// A point light with a cone and glTF's angular falloff.
#[derive(Clone, Copy, Debug)]
pub struct SpotLight {
    /// Position.
    pub position: Vec3,
    /// Intensity on the axis, per steradian.
    pub intensity: Rgb,
    frame: Frame,
    /// 1 − cos of the inner half-angle: full intensity inside.
    inner: f32,
    /// 1 − cos of the outer half-angle: nothing outside.
    outer: f32,
    /// ∫ falloff dω.
    solid_angle: f32,
}

/// Parallel light.
#[derive(Clone, Copy, Debug)]
pub struct DirectionalLight {
    /// Unit direction of flight.
    pub direction: Vec3,
    /// Irradiance on a plane that faces it.
    pub irradiance: Rgb,
    /// Bounding sphere of the scene.
    pub scene_center: Vec3,
    /// Its radius.
    pub scene_radius: f32,
}

/// Dirac sample towards a point at `position` of intensity `intensity`.
#[inline]
fn towards(position: Vec3, from: Vec3, intensity: impl Fn(Vec3) -> Rgb) -> Option<LightLiSample> {
    let d = position - from;
    let distance = d.length();
    if distance == 0.0 {
        return None;
    }
    let wi = d / distance;
    // Divided twice: the square of a tiny or huge distance may leave the range of f32 before the quotient does.
    let radiance = intensity(-wi) * (1.0 / distance) * (1.0 / distance);
    if radiance.is_black() {
        return None;
    }
    Some(LightLiSample { wi, distance, radiance, pdf: 1.0, is_dirac: true, shadow_target: position })
}

impl PointLight {
    /// See [`super::Light::sample_li`].
    #[inline]
    pub fn sample_li(&self, from: Vec3) -> Option<LightLiSample> {
        towards(self.position, from, |_| self.intensity)
    }
    /// See [`super::Light::sample_le`]: uniform over the sphere.
    #[inline]
    pub fn sample_le(&self, u: [f32; 2]) -> EmissionSample {
        EmissionSample {
            origin: self.position,
            normal: None,
            direction: uniform_sphere(u),
            power: self.power(),
            pdf_position: 1.0,
            pdf_direction: SPHERE_PDF,
        }
    }
    /// 4πI.
    pub fn power(&self) -> Rgb {
        self.intensity * (4.0 * PI)
    }
}

impl SpotLight {
    /// A spot at `position` along the unit `axis`, half-angles in radians, 0 ≤ `inner` ≤ `outer` ≤ π/2.
    pub fn new(position: Vec3, axis: Vec3, intensity: Rgb, inner: f64, outer: f64) -> SpotLight {
        // 1 − cos θ = 2 sin²(θ/2) keeps its digits for tiny cones.
        let one_minus_cos = |angle: f64| {
            let s = sin64(0.5 * angle);
            2.0 * s * s
        };
        let (hi, ho) = (one_minus_cos(inner.min(outer)), one_minus_cos(outer));
        // 2π (∫ full + ∫ quadratic falloff in cosθ) = 2π (hi + (ho − hi)/3).
        let solid_angle = (2.0 * std::f64::consts::PI * (hi + (ho - hi) / 3.0)) as f32;
        let frame = Frame::from_normal(axis);
        SpotLight { position, intensity, frame, inner: hi as f32, outer: ho as f32, solid_angle }
    }

    /// The solid angle that the full intensity would need for the same power, ∫ falloff dω.
    pub fn solid_angle(&self) -> f32 {
        self.solid_angle
    }

    /// Angular falloff in [0, 1] along the unit `direction` of flight: ((cosθ − cos outer)/(cos inner − cos outer))²,
    /// clamped, as KHR_lights_punctual recommends, but without that text's guard of 0.001 on the denominator, which
    /// would darken cones below 2.6° (here the difference is exact down to the smallest cones).
    #[inline]
    pub fn falloff(&self, direction: Vec3) -> f32 {
        let c = direction.dot(self.frame.z);
        if c <= 0.0 {
            return 0.0;
        }
        // 1 − cos = sin²/(1 + cos), with the sine from a cross product.
        self.falloff_at(direction.cross(self.frame.z).length_squared() / (1.0 + c))
    }

    #[inline]
    fn falloff_at(&self, one_minus_cos: f32) -> f32 {
        if one_minus_cos >= self.outer {
            return 0.0;
        }
        if one_minus_cos <= self.inner {
            return 1.0;
        }
        let t = (self.outer - one_minus_cos) / (self.outer - self.inner);
        t * t
    }

    /// See [`super::Light::sample_li`].
    #[inline]
    pub fn sample_li(&self, from: Vec3) -> Option<LightLiSample> {
        towards(self.position, from, |direction| self.intensity * self.falloff(direction))
    }

    /// See [`super::Light::sample_le`]: exactly in proportion to the falloff, whose integral over the cosine is cubic.
    #[inline]
    pub fn sample_le(&self, u: [f32; 2]) -> Option<EmissionSample> {
        let (flat, slope) = (self.inner, (self.outer - self.inner) / 3.0);
        let x = u[0] * (flat + slope);
        let h = if x < flat {
            x
        } else {
            let v = ((x - flat) / slope).clamp(0.0, 1.0);
            self.outer - (self.outer - self.inner) * cbrt(1.0 - v)
        };
        let (r, phi) = (safe_sqrt(h * (2.0 - h)), 2.0 * PI * u[1]);
        let direction = self.frame.to_scene(Vec3::new(r * cos(phi), r * sin(phi), 1.0 - h)).normalize();
        let pdf_direction = self.falloff_at(h) / self.solid_angle;
        (pdf_direction > 0.0).then(|| EmissionSample {
            origin: self.position,
            normal: None,
            direction,
            power: self.power(),
            pdf_position: 1.0,
            pdf_direction,
        })
    }
    /// pdf of [`SpotLight::sample_le`] per solid angle.
    #[inline]
    pub fn pdf_direction(&self, direction: Vec3) -> f32 {
        self.falloff(direction) / self.solid_angle
    }
    /// I·∫ falloff dω.
    pub fn power(&self) -> Rgb {
        self.intensity * self.solid_angle
    }
}

impl DirectionalLight {
    /// See [`super::Light::sample_li`].
    #[inline]
    pub fn sample_li(&self, from: Vec3) -> Option<LightLiSample> {
        let wi = -self.direction;
        let shadow_target = from + wi * (FAR * self.scene_radius);
        let distance = f32::INFINITY;
        Some(LightLiSample { wi, distance, radiance: self.irradiance, pdf: 1.0, is_dirac: true, shadow_target })
    }
    /// See [`super::Light::sample_le`]: from a disc as wide as the scene, outside it.
    #[inline]
    pub fn sample_le(&self, u: [f32; 2]) -> EmissionSample {
        let d = disc(u);
        let f = Frame::from_normal(self.direction);
        // A little wider and further out than the bound, so that rounding loses nothing at its rim.
        let r = self.scene_radius;
        let origin = self.scene_center + (f.x * d[0] + f.y * d[1] - f.z) * r - f.z * (r * 1e-3);
        EmissionSample {
            origin,
            normal: None,
            direction: self.direction,
            power: self.power(),
            pdf_position: 1.0 / (PI * r * r),
            pdf_direction: 1.0,
        }
    }
    /// pdf of [`DirectionalLight::sample_le`] per area of the disc.
    #[inline]
    pub fn pdf_position(&self) -> f64 {
        let r = f64::from(self.scene_radius);
        1.0 / (std::f64::consts::PI * r * r)
    }
    /// E·π r²: what crosses the scene's bounding disc.
    pub fn power(&self) -> Rgb {
        self.irradiance * (PI * self.scene_radius * self.scene_radius)
    }
}

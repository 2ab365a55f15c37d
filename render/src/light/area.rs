//! Emissive triangles.

use super::spherical_triangle::SphericalTriangle;
use super::{EmissionPoint, EmissionSample, LightContext, LightLiSample};
use crate::geometry::offset_origin;
use crate::math::ops::{INV_PI, PI};
use crate::math::warp::{cosine_hemisphere, triangle};
use crate::math::{Frame, Rgb};
use glam::{DVec3, Vec2, Vec3};

/// Below this solid angle (sr) uniform points are as good as uniform directions, and safer to compute; pbrt 4th ed.
/// §6.5.4 uses the same bounds.
const MIN_SPHERICAL: f64 = 3e-4;
/// Above it (nearly a hemisphere: the point lies in the triangle's plane) the spherical map loses its precision.
const MAX_SPHERICAL: f64 = 6.22;
/// Most sub-triangles along an edge when a textured triangle's power is integrated.
const MAX_SUBDIVISION: u32 = 64;

/// Input to [`super::Lights::build`]: one triangle whose material emits, in scene space.
#[derive(Clone, Copy, Debug)]
pub struct EmissiveTriangle {
    /// Vertices, counter-clockwise seen from the front.
    pub p: [Vec3; 3],
    /// Texture coordinates of the vertices: sets 0 and 1 of each.
    pub uv: [[Vec2; 2]; 3],
    /// Vertex colours (white where absent); alpha masks need them.
    pub color: [[f32; 4]; 3],
    /// Index of the material.
    pub material: u32,
    /// Index of the instance.
    pub instance: u32,
    /// Index of the triangle in the instance's mesh.
    pub triangle: u32,
}

/// An emissive triangle as a light.
#[derive(Clone, Debug)]
pub struct AreaLight {
    /// The triangle.
    pub shape: EmissiveTriangle,
    /// Unit geometric normal, on the front side; zero for a triangle without area.
    pub normal: Vec3,
    /// Area in square scene units.
    pub area: f32,
    /// Both faces emit.
    pub double_sided: bool,
    /// Emitted radiance, averaged over the triangle.
    pub mean_radiance: Rgb,
    /// The radiance varies (texture or alpha mask) and must be looked up.
    varying: bool,
}

impl AreaLight {
    /// Prepares a triangle. A triangle without area, or of an unknown material, never emits.
    pub fn new(shape: &EmissiveTriangle, ctx: &LightContext) -> AreaLight {
        let p = shape.p.map(|v| v.as_dvec3());
        let cross = (p[1] - p[0]).cross(p[2] - p[0]);
        let normal = cross.try_normalize().unwrap_or(DVec3::ZERO).as_vec3();
        let area = (0.5 * cross.length()) as f32;
        let mut light =
            AreaLight { shape: *shape, normal, area, double_sided: false, mean_radiance: Rgb::BLACK, varying: false };
        if let Some(m) = ctx.materials.get(shape.material as usize) {
            light.double_sided = m.is_double_sided();
            light.varying = m.has_varying_emission();
            light.mean_radiance = light.average(ctx);
        }
        light
    }

    /// Mean emitted radiance: at the centroids of n² equal sub-triangles, two of them a texel along each edge.
    fn average(&self, ctx: &LightContext) -> Rgb {
        let n = if self.varying { self.subdivision(ctx) } else { 1 };
        let third = 1.0 / (3.0 * f64::from(n));
        let mut sum = [0.0f64; 3];
        for i in 0..n {
            for j in 0..n - i {
                // The upright sub-triangle of the cell, and the inverted one where there is room.
                let shifts: &[f64] = if i + j + 1 < n { &[1.0, 2.0] } else { &[1.0] };
                for s in shifts {
                    let (b1, b2) = ((3.0 * f64::from(i) + s) * third, (3.0 * f64::from(j) + s) * third);
                    let l = self.radiance_at([b1 as f32, b2 as f32], ctx);
                    for (total, v) in sum.iter_mut().zip(l.to_array()) {
                        *total += f64::from(v);
                    }
                }
            }
        }
        let count = f64::from(n) * f64::from(n);
        if sum == [0.0; 3] {
            return self.overlooked(ctx) * (1.0 / count as f32);
        }
        Rgb::from(sum.map(|v| (v / count) as f32))
    }

    /// Radiance that a sub-triangle may hide when all their centroids are black: none if no texel the triangle covers
    /// is lit, else the full factor, so that the light keeps a chance to be chosen.
    fn overlooked(&self, ctx: &LightContext) -> Rgb {
        let Some(m) = ctx.materials.get(self.shape.material as usize) else { return Rgb::BLACK };
        let uv = self.shape.uv.map(|v| v[m.emission_uv_set()]);
        let (min, max) = (uv[0].min(uv[1]).min(uv[2]), uv[0].max(uv[1]).max(uv[2]));
        if m.may_emit_within(min, max, ctx.textures) { m.emission_factor() } else { Rgb::BLACK }
    }

    fn subdivision(&self, ctx: &LightContext) -> u32 {
        let Some(m) = ctx.materials.get(self.shape.material as usize) else { return 1 };
        let [w, h] = m.emission_resolution(ctx.textures).unwrap_or([1, 1]);
        let uv = self.shape.uv.map(|v| v[m.emission_uv_set()] * Vec2::new(w as f32, h as f32));
        let longest = (uv[1] - uv[0]).length().max((uv[2] - uv[1]).length()).max((uv[0] - uv[2]).length());
        // An alpha mask follows another texture: sample it as finely as allowed.
        let wanted = if m.has_alpha_mask() { MAX_SUBDIVISION as f32 } else { 2.0 * longest };
        (wanted.ceil() as u32).clamp(1, MAX_SUBDIVISION)
    }

    /// Emitted radiance at barycentric coordinates (b1, b2), from a face that emits.
    #[inline]
    fn radiance_at(&self, b: [f32; 2], ctx: &LightContext) -> Rgb {
        let Some(m) = ctx.materials.get(self.shape.material as usize) else { return Rgb::BLACK };
        let b0 = 1.0 - b[0] - b[1];
        let mix = |k: usize| self.shape.uv[0][k] * b0 + self.shape.uv[1][k] * b[0] + self.shape.uv[2][k] * b[1];
        let uv = [mix(0), mix(1)];
        let color: [f32; 4] = std::array::from_fn(|k| {
            self.shape.color[0][k] * b0 + self.shape.color[1][k] * b[0] + self.shape.color[2][k] * b[1]
        });
        if m.alpha_passes(&uv, &color, ctx.textures) { m.emission_at(&uv, ctx.textures) } else { Rgb::BLACK }
    }

    #[inline]
    fn radiance(&self, b: [f32; 2], ctx: &LightContext) -> Rgb {
        if self.varying { self.radiance_at(b, ctx) } else { self.mean_radiance }
    }

    /// Position at barycentric coordinates, and the bound on its rounding error (pbrt 4th ed. §6.8.5: γ₇).
    #[inline]
    fn position(&self, b: [f32; 2]) -> (Vec3, Vec3) {
        const GAMMA: f32 = 7.0 * 0.5 * f32::EPSILON;
        let [p0, p1, p2] = self.shape.p;
        let t = [p0 * (1.0 - b[0] - b[1]), p1 * b[0], p2 * b[1]];
        (t[0] + t[1] + t[2], (t[0].abs() + t[1].abs() + t[2].abs()) * GAMMA)
    }

    /// The spherical triangle seen from `from`, if directions are to be sampled in it rather than points.
    #[inline]
    fn spherical(&self, from: Vec3) -> Option<SphericalTriangle> {
        // Ω ≤ area/d² where d is the distance to the triangle: far away there is nothing to compute.
        let [p0, p1, p2] = self.shape.p;
        let size2 = (p1 - p0).length_squared().max((p2 - p0).length_squared());
        let d2 = (p0 - from).length_squared();
        if d2 > 4.0 * size2 && self.area < 0.25 * MIN_SPHERICAL as f32 * d2 {
            return None;
        }
        let direction = |p: Vec3| (p.as_dvec3() - from.as_dvec3()).try_normalize();
        let (a, b, c) = (direction(p0)?, direction(p1)?, direction(p2)?);
        let triangle = SphericalTriangle::new(a, b, c);
        (MIN_SPHERICAL..=MAX_SPHERICAL).contains(&triangle.solid_angle).then_some(triangle)
    }

    /// See [`super::Light::sample_li`].
    pub fn sample_li(&self, ctx: &LightContext, from: Vec3, u: [f32; 2]) -> Option<LightLiSample> {
        let facing = (from - self.shape.p[0]).dot(self.normal);
        if facing == 0.0 || (facing < 0.0 && !self.double_sided) || self.area <= 0.0 {
            return None;
        }
        let spherical = self.spherical(from);
        let b = match &spherical {
            Some(s) => self.barycentric(from, s.sample(u)?)?,
            None => triangle(u),
        };
        let (position, error) = self.position(b);
        let d = position - from;
        let distance = d.length();
        // Besides the point's own error the end of the shadow ray carries that of its direction and length, see
        // `SurfacePoint::arrival`.
        let error = error + Vec3::splat(8.0 * f32::EPSILON * distance);
        let shadow_target = offset_origin(position, error, self.normal, -d);
        if distance == 0.0 {
            return None;
        }
        let wi = d / distance;
        let pdf = match &spherical {
            Some(s) => (1.0 / s.solid_angle) as f32,
            None => self.area_pdf(wi, distance),
        };
        let radiance = self.radiance(b, ctx);
        let usable = pdf > 0.0 && pdf.is_finite() && !radiance.is_black();
        usable.then_some(LightLiSample { wi, distance, radiance, pdf, is_dirac: false, shadow_target })
    }

    /// Barycentric coordinates of the point in the direction `w`, clamped to the triangle.
    fn barycentric(&self, from: Vec3, w: DVec3) -> Option<[f32; 2]> {
        let [p0, p1, p2] = self.shape.p.map(|v| v.as_dvec3());
        let (e1, e2, s) = (p1 - p0, p2 - p0, from.as_dvec3() - p0);
        let h = w.cross(e2);
        let determinant = e1.dot(h);
        let b1 = (s.dot(h) / determinant).clamp(0.0, 1.0);
        let b2 = (w.dot(s.cross(e1)) / determinant).clamp(0.0, 1.0 - b1);
        (b1.is_finite() && b2.is_finite()).then_some([b1 as f32, b2 as f32])
    }

    /// d²/(A·cos) with factors ordered so that no square leaves the range of f32 early.
    #[inline]
    fn area_pdf(&self, wi: Vec3, distance: f32) -> f32 {
        let cosine = wi.dot(self.normal).abs();
        if cosine == 0.0 {
            return 0.0;
        }
        (distance / self.area) * (distance / cosine)
    }

    /// See [`super::Light::pdf_li`].
    pub fn pdf_li(&self, from: Vec3, wi: Vec3, distance: f32) -> f32 {
        if wi.dot(self.normal) >= 0.0 && !self.double_sided {
            return 0.0;
        }
        match self.spherical(from) {
            Some(s) => (1.0 / s.solid_angle) as f32,
            None => self.area_pdf(wi, distance),
        }
    }

    /// See [`super::Light::sample_point`]: uniform over the triangle.
    pub fn sample_point(&self, ctx: &LightContext, u: [f32; 2]) -> Option<EmissionPoint> {
        if self.area <= 0.0 {
            return None;
        }
        let b = triangle(u);
        let emission = self.radiance(b, ctx);
        let (position, error) = self.position(b);
        let point = EmissionPoint { position, error, normal: Some(self.normal), emission, pdf: 1.0 / self.area };
        (!emission.is_black()).then_some(point)
    }

    /// See [`super::Light::sample_le`]: uniform over the triangle, cosine-weighted around its normal; of a double-sided
    /// light each face is chosen half the time.
    pub fn sample_le(&self, ctx: &LightContext, u_position: [f32; 2], u: [f32; 2]) -> Option<EmissionSample> {
        let point = self.sample_point(ctx, u_position)?;
        let (back, u0) = match self.double_sided {
            false => (false, u[0]),
            true if u[0] < 0.5 => (false, 2.0 * u[0]),
            true => (true, 2.0 * u[0] - 1.0),
        };
        let normal = if back { -self.normal } else { self.normal };
        let local = cosine_hemisphere([u0, u[1]]);
        let direction = Frame::from_normal(normal).to_scene(local);
        let pdf_direction = self.pdf_direction(local.z);
        if pdf_direction <= 0.0 {
            return None;
        }
        let sides = if self.double_sided { 2.0 } else { 1.0 };
        Some(EmissionSample {
            origin: point.spawn(direction),
            normal: Some(normal),
            direction,
            power: point.emission * (sides * PI * self.area),
            pdf_position: point.pdf,
            pdf_direction,
        })
    }

    /// pdf per solid angle of the emitted direction whose cosine with the front's normal is `cosine`.
    #[inline]
    pub fn pdf_direction(&self, cosine: f32) -> f32 {
        if self.double_sided { 0.5 * cosine.abs() * INV_PI } else { cosine.max(0.0) * INV_PI }
    }

    /// pdf of [`AreaLight::sample_le`] per area and projected solid angle: 1/(A·π) for each face that emits.
    #[inline]
    pub fn density_per_etendue(&self) -> f64 {
        let sides = if self.double_sided { 2.0 } else { 1.0 };
        1.0 / (f64::from(self.area) * std::f64::consts::PI * sides)
    }

    /// π·A·L, for each face that emits.
    pub fn power(&self) -> Rgb {
        self.mean_radiance * (PI * self.area * if self.double_sided { 2.0 } else { 1.0 })
    }
}

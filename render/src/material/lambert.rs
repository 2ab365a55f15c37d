//! A bare Lambertian surface, reflecting on both sides.

use super::{BsdfSample, Lobes, Scatter, TransportMode};
use crate::math::ops::INV_PI;
use crate::math::warp::cosine_hemisphere;
use crate::math::{Frame, Rgb};
use glam::Vec3;

/// Scattering at one point of such a surface.
#[derive(Clone, Copy, Debug)]
pub struct Lambert {
    pub(super) ng: Vec3,
    pub(super) ns: Vec3,
    pub(super) albedo: Rgb,
    lobes: Lobes,
}

impl Lambert {
    /// Of the given albedo, between unit normals: geometric and shading.
    #[inline]
    pub fn new(ng: Vec3, ns: Vec3, albedo: Rgb) -> Lambert {
        Lambert { ng, ns, albedo, lobes: if albedo.is_black() { Lobes::NONE } else { Lobes::DIFFUSE } }
    }

    #[inline]
    pub(super) fn front(&self, w: Vec3) -> bool {
        w.dot(self.ng) > 0.0
    }

    /// Whether the direction light comes from is on the same side of both normals.
    #[inline]
    pub(super) fn lit(&self, wo: Vec3, wi: Vec3, mode: TransportMode) -> bool {
        let light = match mode {
            TransportMode::Radiance => wi,
            TransportMode::Importance => wo,
        };
        (light.dot(self.ns) > 0.0) == self.front(light)
    }

    /// pdf of [`Lambert::direction`]; `wo` and `wi` are on the same geometric side.
    #[inline]
    pub(super) fn direction_pdf(&self, wo: Vec3, wi: Vec3, mode: TransportMode) -> f32 {
        if !self.lit(wo, wi, mode) {
            return 0.0;
        }
        match mode {
            TransportMode::Radiance => self.cos(wi) * INV_PI,
            TransportMode::Importance => self.cos_geometric(wi) * INV_PI,
        }
    }

    /// Cosine-weighted around the normal whose cosine the sampled direction meets: the shading normal for radiance;
    /// for importance, where the adjoint correction puts |wi·ng| into the integrand, the geometric one.
    #[inline]
    pub(super) fn direction(&self, wo: Vec3, u: [f32; 2], mode: TransportMode) -> Vec3 {
        let normal = match mode {
            TransportMode::Radiance => self.ns,
            TransportMode::Importance => self.ng,
        };
        let wi = Frame::from_normal(normal).to_scene(cosine_hemisphere(u));
        if self.front(wo) { wi } else { -wi }
    }

    /// Whether light passes between both directions at all, if `lobes` are asked for.
    #[inline]
    fn reflects(&self, wo: Vec3, wi: Vec3, lobes: Lobes) -> bool {
        self.front(wo) == self.front(wi) && lobes.intersects(self.lobes)
    }
}

impl Scatter for Lambert {
    #[inline]
    fn lobes(&self) -> Lobes {
        self.lobes
    }
    #[inline]
    fn geometric_normal(&self) -> Vec3 {
        self.ng
    }
    #[inline]
    fn shading_normal(&self) -> Vec3 {
        self.ns
    }
    #[inline]
    fn eval(&self, wo: Vec3, wi: Vec3, lobes: Lobes, mode: TransportMode) -> Rgb {
        let reflects = self.reflects(wo, wi, lobes) && self.lit(wo, wi, mode);
        if reflects { self.albedo * INV_PI } else { Rgb::BLACK }
    }
    #[inline]
    fn pdf(&self, wo: Vec3, wi: Vec3, lobes: Lobes, mode: TransportMode) -> f32 {
        if self.reflects(wo, wi, lobes) { self.direction_pdf(wo, wi, mode) } else { 0.0 }
    }
    #[inline]
    fn eval_pdf(&self, wo: Vec3, wi: Vec3, mode: TransportMode) -> (Rgb, f32) {
        if !self.reflects(wo, wi, self.lobes) || !self.lit(wo, wi, mode) {
            return (Rgb::BLACK, 0.0);
        }
        (self.albedo * INV_PI, self.direction_pdf(wo, wi, mode))
    }
    #[inline]
    fn sample(&self, wo: Vec3, u: [f32; 3], lobes: Lobes, mode: TransportMode) -> Option<BsdfSample> {
        if !lobes.intersects(self.lobes) {
            return None;
        }
        let wi = self.direction(wo, [u[0], u[1]], mode);
        let pdf = if self.front(wi) == self.front(wo) { self.direction_pdf(wo, wi, mode) } else { 0.0 };
        if pdf <= 0.0 {
            return None;
        }
        let weight = match mode {
            TransportMode::Radiance => self.albedo,
            TransportMode::Importance => self.albedo * (self.cos(wi) / self.cos_geometric(wi)),
        };
        Some(BsdfSample { wi, weight, pdf, lobe: Lobes::DIFFUSE, transmitted: false })
    }
    #[inline]
    fn dirac_samples(&self, _wo: Vec3, _mode: TransportMode) -> [Option<BsdfSample>; 3] {
        [None; 3]
    }
    #[inline]
    fn diffuse_albedo(&self, _wo: Vec3) -> Rgb {
        self.albedo
    }
    #[inline]
    fn diffuse_in_weight(&self, _wi: Vec3) -> f32 {
        1.0
    }
    #[inline]
    fn roulette_albedos(&self, _wo: Vec3) -> (Rgb, Rgb) {
        (self.albedo, Rgb::BLACK)
    }
}

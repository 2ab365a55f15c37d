//! Recursive ray tracing (Whitted 1980): direct light of all lights, mirrors and glass, for a quick look at a scene.
//!
//! At every surface each light is asked for its light, and every Dirac direction is followed: both of a dielectric. Whitted's
//! shiny surfaces, sharp mirrors with Phong's highlights, are here glossy lobes: followed along one direction of the lobe
//! (Cook, Porter and Carpenter 1984), weighted against the lights' samples (Veach and Guibas 1995), so that a rough metal shows
//! the scene around it.
//!
//! What is computed is the part of light that all methods call direct, `E(S|G)*L` and `E(S|G)*DL` (see [`super`]), without
//! bias: the ray tree is pruned by roulette. Whatever takes a diffuse surface to another one, or focuses light onto one, is left
//! out.

use super::direct::LightDirection;
use super::path::first_hit;
use super::sample::{Part, Sample};
use crate::geometry::{Ray, SurfacePoint};
use crate::light::Lights;
use crate::material::{Bsdf, BsdfSample, Lobes, Scatter, TransportMode};
use crate::math::sobol::Sampler;
use crate::math::{Rgb, heuristic, roulette};
use crate::scene::Scene;
use crate::scene::segment::Interior;
use glam::Vec3;

/// Branches below this throughput face roulette: a tree has at most 1/`PRUNED` branches a level where no surface amplifies.
const PRUNED: f32 = 1.0 / 64.0;
/// Emissive triangles up to this number are each sampled at every hit; of more, this number of samples is taken by power.
const AREA_SAMPLES: usize = 8;
/// Point, spot and directional lights up to this number are all asked at every hit; more are chosen like emissive triangles.
const MAX_PUNCTUAL: usize = 64;

/// A ray still to be traced.
struct Branch {
    ray: Ray,
    throughput: Rgb,
    interior: Interior,
    /// pdf of the glossy lobe that sent it; infinite where the lights' samples cannot find what it finds.
    pdf: f32,
    /// Surfaces met before.
    bounce: u32,
}

/// Recursive ray tracing of one scene.
pub struct Whitted<'a> {
    scene: &'a Scene,
    max_depth: Option<u32>,
    /// Each emissive triangle, and each other light, is sampled at every hit.
    every: (bool, bool),
    /// Memory of the ray tree, reused from call to call.
    branches: Vec<Branch>,
}

/// A surface under its lights.
struct Vertex<'v> {
    point: &'v SurfacePoint,
    bsdf: &'v Bsdf,
    wo: Vec3,
    throughput: Rgb,
    interior: Interior,
}

impl<'a> Whitted<'a> {
    /// For `scene`. `max_depth`: longest path in edges; `None` is unlimited.
    pub fn new(scene: &'a Scene, max_depth: Option<u32>) -> Self {
        let lights = &scene.lights;
        let area = lights.area_count();
        let every = (area <= AREA_SAMPLES, lights.len() - area <= MAX_PUNCTUAL);
        Whitted { scene, max_depth, every, branches: Vec::new() }
    }

    /// Radiance along `camera_ray`.
    pub fn trace(&mut self, camera_ray: Ray, sampler: &mut Sampler) -> Sample {
        let mut sample = Sample::default();
        let (throughput, interior) = (Rgb::WHITE, Interior::default());
        self.branches.push(Branch { ray: camera_ray, throughput, interior, pdf: f32::INFINITY, bounce: 0 });
        while let Some(branch) = self.branches.pop() {
            self.follow(&branch, sampler, &mut sample);
        }
        sample
    }

    /// Traces one ray of the tree and plants its branches.
    fn follow(&mut self, b: &Branch, sampler: &mut Sampler, sample: &mut Sample) {
        let scene = self.scene;
        sample.rays += 1;
        let Some((point, distance)) = scene.intersect_with_distance(&b.ray) else { return };
        let wo = -b.ray.direction;
        let throughput = b.throughput * b.interior.transmittance_to(scene, &point, wo, distance);
        let emission = scene.emission(&point, wo);
        if !emission.is_black() {
            let weight = heuristic::power(b.pdf, self.light_pdf(&b.ray, distance, &point));
            sample.add(Part::Direct, throughput * emission * weight);
        }
        let bsdf = scene.bsdf(&point);
        if b.bounce == 0 {
            sample.first = Some(first_hit(&point, &bsdf, wo));
        }
        // The next vertex would end a path of bounce + 2 edges.
        if self.max_depth.is_some_and(|d| b.bounce + 1 >= d) {
            return;
        }
        let vertex = Vertex { point: &point, bsdf: &bsdf, wo, throughput, interior: b.interior };
        self.direct_light(&vertex, sampler, sample);
        if bsdf.lobes().intersects(Lobes::SPECULAR) {
            for s in bsdf.dirac_samples(wo, TransportMode::Radiance).into_iter().flatten() {
                self.branch(&vertex, &s, f32::INFINITY, b.bounce, sampler);
            }
        }
        if bsdf.lobes().intersects(Lobes::GLOSSY)
            && let Some(s) = bsdf.sample(wo, sampler.next_3d(), Lobes::GLOSSY, TransportMode::Radiance)
        {
            self.branch(&vertex, &s, s.pdf, b.bounce, sampler);
        }
    }

    /// Adds the direction `s` to the ray tree, by roulette where it carries little.
    fn branch(&mut self, v: &Vertex<'_>, s: &BsdfSample, pdf: f32, bounce: u32, sampler: &mut Sampler) {
        let mut throughput = v.throughput * s.weight;
        let survival = (throughput.max_component() / PRUNED).min(roulette::survival_cap(bounce));
        if survival <= 0.0 || (survival < 1.0 && sampler.next_1d() >= survival) {
            return;
        }
        throughput *= 1.0 / survival;
        let interior = if s.transmitted { v.interior.crossed(self.scene, v.point, s.wi) } else { v.interior };
        let ray = Ray::new(v.point.spawn(s.wi), s.wi);
        self.branches.push(Branch { ray, throughput, interior, pdf, bounce: bounce + 1 });
    }

    /// Light of all lights on the diffuse and the glossy lobe.
    fn direct_light(&self, v: &Vertex<'_>, sampler: &mut Sampler, sample: &mut Sample) {
        let lights = &self.scene.lights;
        if !v.bsdf.lobes().intersects(Lobes::NON_DIRAC) || lights.selector().is_empty() {
            return;
        }
        let area = lights.area_count();
        if self.every.1 {
            (area..lights.len()).for_each(|index| self.light(v, index, 1.0, [0.0; 2], sample));
        }
        if self.every.0 {
            (0..area).for_each(|index| self.light(v, index, 1.0, sampler.next_2d(), sample));
        }
        if self.every == (true, true) {
            return;
        }
        for stratum in 0..AREA_SAMPLES {
            let u = (stratum as f32 + sampler.next_1d()) / AREA_SAMPLES as f32;
            let point = sampler.next_2d();
            let Some((index, pmf)) = lights.selector().sample(u.min(1.0 - f32::EPSILON)) else { return };
            if !self.is_always_sampled(lights, index) {
                self.light(v, index, AREA_SAMPLES as f32 * pmf, point, sample);
            }
        }
    }

    fn is_always_sampled(&self, lights: &Lights, index: usize) -> bool {
        if index < lights.area_count() { self.every.0 } else { self.every.1 }
    }

    /// Light of light `index`, of which `count` samples are expected at each hit.
    fn light(&self, v: &Vertex<'_>, index: usize, count: f32, u: [f32; 2], sample: &mut Sample) {
        let scene = self.scene;
        let Some(light) = LightDirection::towards(scene, v.point, index, count, u) else { return };
        let f = |lobes| v.bsdf.eval(v.wo, light.wi, lobes, TransportMode::Radiance);
        let (diffuse, glossy) = (f(Lobes::DIFFUSE), f(Lobes::GLOSSY));
        if diffuse.is_black() && glossy.is_black() {
            return;
        }
        sample.rays += 1;
        if !light.is_visible(scene) {
            return;
        }
        // No ray is sent along the diffuse lobe: there the light's samples are all there is.
        let pdf = v.bsdf.pdf(v.wo, light.wi, Lobes::GLOSSY, TransportMode::Radiance);
        let f = diffuse + glossy * heuristic::power(light.pdf, pdf);
        let body = v.interior.leaving(scene, v.point, v.wo, light.wi);
        let transmittance = body.transmittance(scene, light.distance);
        let incident = v.throughput * light.weighted_radiance * transmittance * v.bsdf.cos(light.wi);
        sample.add(Part::Direct, incident * f);
    }

    /// Expected density of [`Whitted::light`]'s samples in the direction of `ray`, which met the emissive surface `hit`.
    fn light_pdf(&self, ray: &Ray, distance: f32, hit: &SurfacePoint) -> f32 {
        let lights = &self.scene.lights;
        let Some(first) = self.scene.instances[hit.instance as usize].first_emitter else { return 0.0 };
        let index = (first + hit.triangle) as usize;
        let Some(light) = lights.get(index) else { return 0.0 };
        let count = if self.every.0 { 1.0 } else { AREA_SAMPLES as f32 * lights.selector().pmf(index) };
        count * light.pdf_li(ray.origin, ray.direction, distance)
    }
}

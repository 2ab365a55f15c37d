//! Path tracing with next-event estimation and multiple importance sampling (Kajiya 1986; Veach 1997).
//!
//! Shares nothing with the photon code beyond scene, BSDFs and lights: the independent truth.

use super::direct::{LightDirection, light_pdf};
use super::sample::{FirstHit, Part, Sample, Stage};
use crate::geometry::{Ray, SurfacePoint};
use crate::material::{Lobes, Scatter, TransportMode};
use crate::math::sobol::Sampler;
use crate::math::{Rgb, heuristic, roulette};
use crate::scene::Scene;
use crate::scene::segment::Interior;
use crate::scene::surfaces::Surfaces;
use glam::Vec3;

/// The direction a path came along: what MIS needs to know of the last scattering.
struct Arrival {
    from: Vec3,
    /// pdf of the BSDF sample; infinite for Dirac lobes and camera rays, which next-event estimation cannot find.
    pdf: f32,
}

/// Radiance along `camera_ray`, in a scene that may be called one of `S`. `max_depth`: longest path in edges; `None` is unlimited.
pub fn trace<S: Surfaces>(scene: &Scene, camera_ray: Ray, max_depth: Option<u32>, sampler: &mut Sampler) -> Sample {
    let mut sample = Sample::default();
    let mut ray = camera_ray;
    let mut throughput = Rgb::WHITE;
    let mut stage = Stage::default();
    let mut interior = Interior::default();
    let mut arrival = Arrival { from: ray.origin, pdf: f32::INFINITY };
    for bounce in 0.. {
        sample.rays += 1;
        let Some((point, distance)) = S::intersect(scene, &ray) else { break };
        let wo = -ray.direction;
        throughput *= interior.transmittance_to(scene, &point, wo, distance);
        let emission = scene.emission(&point, wo);
        if !emission.is_black() {
            let weight = match arrival.pdf {
                f32::INFINITY => 1.0,
                pdf => heuristic::power(pdf, light_pdf(scene, arrival.from, ray.direction, distance, &point)),
            };
            sample.add(stage.part(), throughput * emission * weight);
        }
        let bsdf = S::bsdf(scene, &point);
        if bounce == 0 {
            sample.first = Some(first_hit(&point, &bsdf, wo));
        }
        // The next vertex would end a path of bounce + 2 edges.
        if max_depth.is_some_and(|d| bounce + 1 >= d) {
            break;
        }
        add_direct_light(scene, &point, &bsdf, wo, throughput, stage, interior, sampler, &mut sample);
        let u = sampler.next_3d();
        let u_roulette = sampler.next_1d();
        let Some(s) = bsdf.sample(wo, u, Lobes::ALL, TransportMode::Radiance) else { break };
        throughput *= s.weight;
        let survival = roulette::camera_survival(throughput.max_component(), bounce);
        if u_roulette >= survival {
            break;
        }
        throughput *= 1.0 / survival;
        stage = stage.after(s.lobe);
        arrival = Arrival { from: point.position, pdf: if s.lobe == Lobes::SPECULAR { f32::INFINITY } else { s.pdf } };
        if s.transmitted {
            interior = interior.crossed(scene, &point, s.wi);
        }
        ray = Ray::new(point.spawn(s.wi), s.wi);
    }
    sample
}

/// What the image layers show of the first surface.
pub(super) fn first_hit(point: &SurfacePoint, bsdf: &impl Scatter, wo: Vec3) -> FirstHit {
    let n = bsdf.shading_normal();
    FirstHit { position: point.position, normal: if n.dot(wo) < 0.0 { -n } else { n }, albedo: bsdf.albedo(wo) }
}

#[allow(clippy::too_many_arguments)] // the state of a path vertex, spelled out
fn add_direct_light(
    scene: &Scene,
    point: &SurfacePoint,
    bsdf: &impl Scatter,
    wo: Vec3,
    throughput: Rgb,
    stage: Stage,
    interior: Interior,
    sampler: &mut Sampler,
    sample: &mut Sample,
) {
    const SAMPLED: Lobes = Lobes::DIFFUSE.union(Lobes::GLOSSY);
    let Some(light) = LightDirection::sample(scene, point, sampler) else { return };
    if !bsdf.lobes().intersects(SAMPLED) {
        return;
    }
    let diffuse = bsdf.eval(wo, light.wi, Lobes::DIFFUSE, TransportMode::Radiance);
    let glossy = bsdf.eval(wo, light.wi, Lobes::GLOSSY, TransportMode::Radiance);
    if diffuse.is_black() && glossy.is_black() {
        return;
    }
    sample.rays += 1;
    if !light.is_visible(scene) {
        return;
    }
    let pdf = bsdf.pdf(wo, light.wi, Lobes::ALL, TransportMode::Radiance);
    let weight = heuristic::power(light.pdf, pdf) * bsdf.cos(light.wi);
    let body = interior.leaving(scene, point, wo, light.wi);
    let incident = throughput * light.weighted_radiance * body.transmittance(scene, light.distance) * weight;
    let part = |lobe| match stage.after(lobe) {
        // Light that reaches the first diffuse surface straight from a light is direct.
        Stage::AfterDiffuse | Stage::BeforeDiffuse => Part::Direct,
        other => other.part(),
    };
    sample.add(part(Lobes::DIFFUSE), incident * diffuse);
    sample.add(part(Lobes::GLOSSY), incident * glossy);
}

//! Emission aimed at specular and glossy geometry, for the caustic map.
//!
//! A photon path `L(S|G)⁺D` starts towards specular or glossy geometry, so only directions into the bounding spheres of
//! such geometry need photons: the projection map of Jensen (2001, §5.4) with cones in place of a raster, exact for
//! every light and unbiased, because every direction that meets such geometry first has a positive pdf.

use crate::light::{EmissionSample, Light};
use crate::math::ops::PI;
use crate::math::sobol::Sampler;
use crate::math::{AliasTable, Frame, Rgb, warp};
use crate::scene::Scene;
use glam::Vec3;

/// Most bounding spheres used; each costs a few nanoseconds a photon.
const MAX_TARGETS: usize = 32;
/// A cluster is split when the pieces' summed cross-section is below this share of its own.
const WORTHWHILE_SPLIT: f32 = 0.8;
/// Share of emission that chooses lights by power alone, so that no light starves by a poor estimate.
const POWER_SHARE: f64 = 0.1;

/// A bounding sphere of specular or glossy triangles.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Centre.
    pub center: Vec3,
    /// Radius; every vertex lies inside.
    pub radius: f32,
    /// Upper bound on the surfaces' specular and glossy albedo: how many photons per solid angle it gets.
    pub weight: f32,
}

/// What to aim at, and how often from each light.
#[derive(Clone, Debug)]
pub struct AimedEmission {
    targets: Vec<Target>,
    lights: AliasTable,
}

impl AimedEmission {
    /// Targets of all specular and glossy geometry; `None` when there is none, or no light.
    pub fn new(scene: &Scene) -> Option<Self> {
        let targets = find_targets(scene);
        if targets.is_empty() {
            return None;
        }
        let total: f64 = scene.lights.as_slice().iter().map(|l| f64::from(l.power().luminance())).sum();
        if total <= 0.0 {
            return None;
        }
        let towards: Vec<f64> = scene
            .lights
            .as_slice()
            .iter()
            .map(|l| f64::from(l.power().luminance()) * reach(&targets, center_of(l), scene.space.radius))
            .collect();
        let towards_total: f64 = towards.iter().sum();
        let weights: Vec<f64> = scene
            .lights
            .as_slice()
            .iter()
            .zip(&towards)
            .map(|(l, t)| {
                let by_power = f64::from(l.power().luminance()) / total;
                let by_reach = if towards_total > 0.0 { t / towards_total } else { by_power };
                POWER_SHARE * by_power + (1.0 - POWER_SHARE) * by_reach
            })
            .collect();
        Some(AimedEmission { targets, lights: AliasTable::new(&weights)? })
    }

    /// The bounding spheres.
    pub fn targets(&self) -> &[Target] {
        &self.targets
    }

    /// A photon that starts towards a target; `None` where the sampled direction carries no light.
    pub fn sample(&self, scene: &Scene, sampler: &mut Sampler) -> Option<EmissionSample> {
        let (u_light, u_position) = (sampler.next_1d(), sampler.next_2d());
        let (u_target, u_direction) = (sampler.next_1d(), sampler.next_2d());
        let (index, pmf) = self.lights.sample(u_light);
        let light = scene.lights.get(index)?;
        let mut s = if let Light::Directional(l) = light {
            let (origin, pdf) = self.sample_parallel(l.direction, scene.space.radius, u_target, u_direction);
            EmissionSample {
                origin,
                normal: None,
                direction: l.direction,
                power: l.irradiance * (1.0 / pdf),
                pdf_position: pdf,
                pdf_direction: 1.0,
            }
        } else {
            self.sample_mixture(scene, light, [u_position, u_direction], u_target)?
        };
        s.power *= 1.0 / pmf;
        (s.power != Rgb::BLACK).then_some(s)
    }

    /// Emission from a point on `light`, by a mixture of the targets' cones and the light's own distribution: the wider
    /// the cones are compared to the light's own, the more it is the latter, which follows its cosine or falloff.
    fn sample_mixture(
        &self,
        scene: &Scene,
        light: &Light,
        [u_position, u_direction]: [[f32; 2]; 2],
        u: f32,
    ) -> Option<EmissionSample> {
        let context = scene.light_context();
        let point = light.sample_point(&context, u_position)?;
        let total: f32 = self.targets.iter().map(|t| t.weight * one_minus_cos(t, point.position)).sum();
        let widest = self.targets.iter().map(|t| t.weight).fold(0.0, f32::max);
        let cones = 2.0 * PI * total / widest;
        let own = cones / (cones + solid_angle_of(light));
        let direction = if u < own {
            light.sample_le(&context, u_position, u_direction)?.direction
        } else {
            self.sample_cone(point.position, total, (u - own) / (1.0 - own), u_direction)?
        };
        let aimed = self.cone_density(point.position, direction) / (2.0 * PI * total);
        let pdf = own * light.pdf_direction(&point, direction) + (1.0 - own) * aimed;
        (pdf > 0.0).then(|| EmissionSample {
            origin: point.spawn(direction),
            normal: point.normal,
            direction,
            power: light.emitted(&point, direction) * (1.0 / (point.pdf * pdf)),
            pdf_position: point.pdf,
            pdf_direction: pdf,
        })
    }

    /// A direction from `from` into the union of the targets' cones: one cone by weight × solid angle, of which `total`
    /// is the sum over 2π, uniformly inside. Its pdf is [`Self::cone_density`] / (2π `total`).
    fn sample_cone(&self, from: Vec3, total: f32, u_target: f32, u: [f32; 2]) -> Option<Vec3> {
        let mut remaining = u_target * total;
        let mut chosen = self.targets.last()?;
        for t in &self.targets {
            remaining -= t.weight * one_minus_cos(t, from);
            if remaining < 0.0 {
                chosen = t;
                break;
            }
        }
        let axis = (chosen.center - from).try_normalize().unwrap_or(Vec3::Z);
        Some(Frame::from_normal(axis).to_scene(warp::uniform_cone(u, one_minus_cos(chosen, from))))
    }

    /// Σ of the weights of the cones that hold `direction`.
    fn cone_density(&self, from: Vec3, direction: Vec3) -> f32 {
        self.targets.iter().filter(|t| in_cone(t, from, direction)).map(|t| t.weight).sum()
    }

    /// A start for parallel light along `direction`: a point on the disc of one target, moved out of the scene, and its
    /// pdf per area Σ wᵢ[x ∈ Dᵢ] / Σ wⱼAⱼ.
    fn sample_parallel(&self, direction: Vec3, scene_radius: f32, u_target: f32, u: [f32; 2]) -> (Vec3, f32) {
        let total: f32 = self.targets.iter().map(|t| t.weight * t.radius * t.radius).sum();
        let mut remaining = u_target * total;
        let mut chosen = self.targets[self.targets.len() - 1];
        let mut index = self.targets.len() - 1;
        for (i, t) in self.targets.iter().enumerate() {
            remaining -= t.weight * t.radius * t.radius;
            if remaining < 0.0 {
                (chosen, index) = (*t, i);
                break;
            }
        }
        let frame = Frame::from_normal(direction);
        let d = warp::disc(u);
        let on_disc = chosen.center + (frame.x * d[0] + frame.y * d[1]) * chosen.radius;
        let density: f32 = self
            .targets
            .iter()
            .enumerate()
            .filter(|(i, t)| {
                let v = t.center - on_disc;
                *i == index || (v - direction * v.dot(direction)).length_squared() <= t.radius * t.radius
            })
            .map(|(_, t)| t.weight)
            .sum();
        // Start outside the scene's bounding sphere, on the same line.
        let back = on_disc.dot(direction) + scene_radius * 2.0;
        (on_disc - direction * back, density / (PI * total))
    }
}

/// 1 − cos of the half-angle under which `from` sees the sphere; 2 (all directions) from inside.
fn one_minus_cos(t: &Target, from: Vec3) -> f32 {
    let d2 = (t.center - from).length_squared();
    let r2 = t.radius * t.radius;
    if d2 <= r2 {
        return 2.0;
    }
    let sin2 = r2 / d2;
    // 1 − √(1 − s²) without cancellation for small cones; a hair wider against rounding.
    (sin2 / (1.0 + (1.0 - sin2).sqrt())) * (1.0 + 1e-5) + 1e-12
}

/// Where a light is, roughly; `None` for directional lights.
fn center_of(light: &Light) -> Option<Vec3> {
    match light {
        Light::Area(l) => Some((l.shape.p[0] + l.shape.p[1] + l.shape.p[2]) * (1.0 / 3.0)),
        Light::Point(l) => Some(l.position),
        Light::Spot(l) => Some(l.position),
        Light::Directional(_) => None,
    }
}

/// The solid angle a light's own emission fills, roughly.
fn solid_angle_of(light: &Light) -> f32 {
    match light {
        Light::Area(_) => 2.0 * PI,
        Light::Spot(l) => l.solid_angle(),
        _ => 4.0 * PI,
    }
}

/// Whether `direction` lies in the cone of [`one_minus_cos`]. Directions on the rim may count to either side by rounding:
/// with the cone a hair wider than the sphere, none that meets the sphere is lost.
fn in_cone(t: &Target, from: Vec3, direction: Vec3) -> bool {
    let to = t.center - from;
    let d2 = to.length_squared();
    if d2 <= t.radius * t.radius {
        return true;
    }
    // sin²∠ ≤ r²/d² is the same cone without cancellation, widened as above.
    let cross = direction.cross(to).length_squared();
    direction.dot(to) > 0.0 && cross <= t.radius * t.radius * (1.0 + 4e-5) + 4e-12 * d2
}

/// Estimated share of a light's emission that meets a target, from its centre; directional lights (no centre) by the
/// targets' discs over the scene's.
fn reach(targets: &[Target], center: Option<Vec3>, scene_radius: f32) -> f64 {
    targets
        .iter()
        .map(|t| {
            f64::from(t.weight)
                * match center {
                    Some(c) => f64::from(one_minus_cos(t, c)),
                    None => f64::from(t.radius / scene_radius * (t.radius / scene_radius)),
                }
        })
        .sum()
}

/// One piece of specular or glossy geometry, on its way to a target.
struct Cluster {
    triangles: Vec<[Vec3; 3]>,
    target: Target,
}

fn find_targets(scene: &Scene) -> Vec<Target> {
    let mut clusters: Vec<Cluster> = Vec::new();
    for instance in &scene.instances {
        let mesh = &scene.meshes[instance.mesh as usize];
        let weight = scene.materials[mesh.material as usize].specular_albedo_bound();
        if weight > 0.0 {
            let triangles = (0..mesh.triangles.len() as u32).map(|t| mesh.triangle_positions(t, instance)).collect();
            clusters.push(cluster(triangles, weight));
        }
    }
    merge_down(&mut clusters);
    split_up(&mut clusters);
    clusters.into_iter().map(|c| c.target).collect()
}

/// Too many objects: the nearest in file order are joined until few enough are left.
fn merge_down(clusters: &mut Vec<Cluster>) {
    while clusters.len() > MAX_TARGETS {
        *clusters = std::mem::take(clusters)
            .chunk_pairs()
            .map(|(a, b)| match b {
                Some(b) => {
                    let weight = a.target.weight.max(b.target.weight);
                    cluster(a.triangles.into_iter().chain(b.triangles).collect(), weight)
                }
                None => a,
            })
            .collect();
    }
}

/// Room left: clusters whose halves are much smaller together are split, largest first.
fn split_up(clusters: &mut Vec<Cluster>) {
    let mut done = Vec::new();
    while clusters.len() + done.len() < MAX_TARGETS {
        let largest =
            (0..clusters.len()).max_by(|&a, &b| clusters[a].target.radius.total_cmp(&clusters[b].target.radius));
        let Some(i) = largest else { break };
        let c = clusters.swap_remove(i);
        match halves(&c) {
            Some((a, b)) => clusters.extend([a, b]),
            None => done.push(c),
        }
    }
    clusters.append(&mut done);
}

fn halves(c: &Cluster) -> Option<(Cluster, Cluster)> {
    if c.triangles.len() < 2 {
        return None;
    }
    let centroid = |t: &[Vec3; 3]| (t[0] + t[1] + t[2]) * (1.0 / 3.0);
    let (lo, hi) = c
        .triangles
        .iter()
        .map(centroid)
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
    let extent = hi - lo;
    let axis = if extent.x >= extent.y && extent.x >= extent.z { 0 } else { usize::from(extent.y < extent.z) + 1 };
    let middle = (lo[axis] + hi[axis]) * 0.5;
    let (a, b): (Vec<_>, Vec<_>) = c.triangles.iter().partition(|t| centroid(t)[axis] < middle);
    if a.is_empty() || b.is_empty() {
        return None;
    }
    let (a, b) = (cluster(a, c.target.weight), cluster(b, c.target.weight));
    let section = |c: &Cluster| c.target.radius * c.target.radius;
    (section(&a) + section(&b) < WORTHWHILE_SPLIT * section(c)).then_some((a, b))
}

fn cluster(triangles: Vec<[Vec3; 3]>, weight: f32) -> Cluster {
    let (lo, hi) =
        triangles.iter().flatten().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(lo, hi), &p| (lo.min(p), hi.max(p)));
    let center = (lo + hi) * 0.5;
    let radius = triangles.iter().flatten().map(|p| (*p - center).length()).fold(0.0, f32::max);
    // Rounding of the centre and the lengths: a few units in the last place of coordinates below 2.
    let radius = radius * (1.0 + 1e-6) + 1e-6;
    Cluster { triangles, target: Target { center, radius, weight } }
}

/// Consuming iteration in pairs, the last one alone when the count is odd.
trait ChunkPairs: Sized {
    fn chunk_pairs(self) -> impl Iterator<Item = (Cluster, Option<Cluster>)>;
}

impl ChunkPairs for Vec<Cluster> {
    fn chunk_pairs(self) -> impl Iterator<Item = (Cluster, Option<Cluster>)> {
        let mut items = self.into_iter();
        std::iter::from_fn(move || items.next().map(|a| (a, items.next())))
    }
}

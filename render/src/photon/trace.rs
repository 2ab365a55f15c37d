//! Photon paths from emission to absorption: which hits are stored, and with what power.
//!
//! A path is a pure function of (scene, seed, map, round, path index). Power is kept undivided; estimates divide by the
//! emitted count (Jensen 2001, §5).

use super::aim::AimedEmission;
use super::pack::{encode_normal, encode_rgbe};
use super::{EmissionRange, MapKind, PhotonBatch};
use crate::geometry::{Ray, SurfacePoint};
use crate::light::EmissionSample;
use crate::material::{BsdfSample, Lobes, Scatter, TransportMode};
use crate::math::sobol::Sampler;
use crate::math::{Purpose, Rgb, roulette};
use crate::scene::surfaces::{Any, Bare, Surfaces};
use crate::scene::{Scene, segment::Interior};
use glam::Vec3;
use rayon::prelude::*;

/// Paths traced as one unit of parallel work; of no influence on the result.
const PATHS_PER_TASK: u64 = 2048;

/// Which stored hits a map takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Storage {
    /// Every hit on a diffuse lobe: `L(S|G|D)*D`, read behind final-gather rays.
    All,
    /// Only light that met a diffuse surface before: `L…D…D`, for looking at the map directly beside direct light and
    /// the caustic map.
    Indirect,
    /// Only light focused by Dirac and glossy lobes: `L(S|G)⁺D`; a path ends at its first diffuse surface.
    Caustic,
}

/// How photon paths are made: everything besides the path index that a photon depends on.
pub struct Emission<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Which map.
    pub kind: MapKind,
    /// Which hits are stored.
    pub storage: Storage,
    /// The job's seed.
    pub seed: u64,
    /// Repetition, for progressive methods.
    pub round: u32,
    /// Emission towards specular and glossy geometry; `None`: by light power into all directions.
    pub aim: Option<&'a AimedEmission>,
}

/// One stored hit, before packing.
#[derive(Clone, Copy, Debug)]
pub struct Photon {
    /// Scene-space position.
    pub position: Vec3,
    /// Undivided power, such that Σ power / (emitted count · area) estimates the irradiance that the diffuse lobe
    /// reflects: with the shading normal's cosine (Veach 1997, §5.3) and the coat's inward transmittance in it.
    pub power: Rgb,
    /// Geometric normal on the side the light came from.
    pub normal: Vec3,
}

impl Emission<'_> {
    /// Traces the paths of `range` on the current rayon pool. The result does not depend on the number of threads.
    pub fn trace(&self, range: EmissionRange) -> PhotonBatch {
        in_parallel(range, false, |index, batch| {
            let non_finite = self.trace_path(index, &mut |p| store(batch, p));
            batch.non_finite += non_finite;
        })
    }

    /// Traces path `index` and hands every stored photon to `sink`, in bounce order; returns the number of powers that were not
    /// finite and were left out.
    pub fn trace_path(&self, index: u64, sink: &mut impl FnMut(&Photon)) -> u64 {
        let purpose = match self.kind {
            MapKind::Global => Purpose::GlobalPhotons,
            MapKind::Caustic => Purpose::CausticPhotons,
        };
        let mut sampler = Sampler::new(self.seed, purpose, self.round, 0, index);
        let emitted = match self.aim {
            Some(aim) => aim.sample(self.scene, &mut sampler),
            None => emit_by_power(self.scene, &mut sampler),
        };
        let Some(start) = emitted else { return 0 };
        if self.scene.is_bare {
            self.follow::<Bare>(start, &mut sampler, sink)
        } else {
            self.follow::<Any>(start, &mut sampler, sink)
        }
    }

    fn follow<S: Surfaces>(&self, start: EmissionSample, sampler: &mut Sampler, sink: &mut impl FnMut(&Photon)) -> u64 {
        let scene = self.scene;
        let mut ray = Ray::new(start.origin, start.direction);
        let mut power = start.power;
        let mut interior = Interior::default();
        let (mut met_diffuse, mut met_other) = (false, false);
        let mut non_finite = 0;
        for bounce in 0.. {
            if !power.is_finite() {
                return non_finite + 1;
            }
            if power.is_black() {
                break;
            }
            let Some((point, distance)) = S::intersect(scene, &ray) else { break };
            let wo = -ray.direction;
            power *= interior.transmittance_to(scene, &point, wo, distance);
            let bsdf = S::bsdf(scene, &point);
            let diffuse = bsdf.lobes().intersects(Lobes::DIFFUSE);
            let stored = match self.storage {
                Storage::All => true,
                Storage::Indirect => met_diffuse,
                Storage::Caustic => met_other && !met_diffuse,
            };
            if diffuse
                && stored
                && let Some(photon) = arriving(&point, &bsdf, wo, power)
            {
                if photon.power.is_finite() {
                    sink(&photon);
                } else {
                    non_finite += 1;
                }
            }
            let lobes = match self.storage {
                Storage::Caustic => Lobes::GLOSSY.union(Lobes::SPECULAR),
                _ => Lobes::ALL,
            };
            let Some((s, survival)) = scatter(&bsdf, wo, lobes, bounce, sampler) else { break };
            power *= s.weight * (bsdf.importance_correction(wo, s.wi) / survival);
            met_diffuse |= s.lobe == Lobes::DIFFUSE;
            met_other |= s.lobe != Lobes::DIFFUSE;
            if s.transmitted {
                interior = interior.crossed(scene, &point, s.wi);
            }
            ray = Ray::new(point.spawn(s.wi), s.wi);
        }
        non_finite
    }
}

/// Chooses a light by its power and emits into all directions.
fn emit_by_power(scene: &Scene, sampler: &mut Sampler) -> Option<EmissionSample> {
    let (u_light, u_position, u_direction) = (sampler.next_1d(), sampler.next_2d(), sampler.next_2d());
    let (index, pmf) = scene.lights.selector().sample(u_light)?;
    let mut s = scene.lights.get(index)?.sample_le(&scene.light_context(), u_position, u_direction)?;
    s.power *= 1.0 / pmf;
    Some(s)
}

/// The photon that `power` arriving from `wo` leaves at `point`; its power may not be finite.
fn arriving(point: &SurfacePoint, bsdf: &impl Scatter, wo: Vec3, power: Rgb) -> Option<Photon> {
    let cos_geometric = wo.dot(point.ng);
    if cos_geometric == 0.0 {
        return None;
    }
    // The density of photons measures irradiance with the geometric cosine; the lobe reflects with the shading one.
    let weight = bsdf.cos(wo) / cos_geometric.abs() * bsdf.diffuse_in_weight(wo);
    let power = power * weight;
    (!power.is_black()).then(|| Photon {
        position: point.position,
        power,
        normal: if cos_geometric < 0.0 { -point.ng } else { point.ng },
    })
}

/// Russian roulette between diffuse reflection, other scattering and absorption (Jensen 2001, §5.2). Returns the sample
/// within the chosen lobe set and the probability of that choice, so that the caller divides by it.
fn scatter(
    bsdf: &impl Scatter,
    wo: Vec3,
    lobes: Lobes,
    bounce: u32,
    sampler: &mut Sampler,
) -> Option<(BsdfSample, f32)> {
    let (mut u_choice, u) = (sampler.next_1d(), sampler.next_3d());
    let (mut d, s) = bsdf.roulette_albedos(wo);
    if !lobes.intersects(Lobes::DIFFUSE) {
        d = Rgb::BLACK;
    }
    let survival = (d + s).max_component().min(roulette::survival_cap(bounce));
    let sum = d.sum() + s.sum();
    if sum <= 0.0 || u_choice >= survival {
        return None;
    }
    u_choice /= survival;
    let p_diffuse = d.sum() / sum;
    let (lobes, probability) = if u_choice < p_diffuse {
        (Lobes::DIFFUSE, survival * p_diffuse)
    } else {
        (Lobes::GLOSSY.union(Lobes::SPECULAR), survival * (1.0 - p_diffuse))
    };
    bsdf.sample(wo, u, lobes, TransportMode::Importance).map(|sample| (sample, probability))
}

fn store(batch: &mut PhotonBatch, p: &Photon) {
    batch.positions.push(p.position.to_array());
    batch.powers.push(encode_rgbe(p.power));
    batch.normals.push(encode_normal(p.normal));
}

/// The batch of the paths `range`, of photons or of light `vertices`: `trace` appends what a path leaves. In parallel on the
/// current rayon pool, in path order.
pub fn in_parallel(range: EmissionRange, vertices: bool, trace: impl Fn(u64, &mut PhotonBatch) + Sync) -> PhotonBatch {
    let tasks = range.len().div_ceil(PATHS_PER_TASK);
    let parts: Vec<PhotonBatch> = (0..tasks)
        .into_par_iter()
        .map(|t| {
            let first = range.first + t * PATHS_PER_TASK;
            let end = range.end.min(first + PATHS_PER_TASK);
            let mut batch = PhotonBatch::new(EmissionRange { first, end }, vertices);
            (first..end).for_each(|index| trace(index, &mut batch));
            batch
        })
        .collect();
    concatenate(range, vertices, parts)
}

fn concatenate(range: EmissionRange, vertices: bool, parts: Vec<PhotonBatch>) -> PhotonBatch {
    let mut whole = PhotonBatch::new(range, vertices);
    let count = parts.iter().map(PhotonBatch::len).sum();
    whole.positions.reserve_exact(count);
    whole.powers.reserve_exact(count);
    whole.normals.reserve_exact(count);
    if let Some(v) = &mut whole.vertices {
        v.reserve_exact(count);
    }
    for mut part in parts {
        whole.non_finite += part.non_finite;
        whole.positions.append(&mut part.positions);
        whole.powers.append(&mut part.powers);
        whole.normals.append(&mut part.normals);
        if let (Some(to), Some(from)) = (&mut whole.vertices, &part.vertices) {
            to.extend(from);
        }
    }
    whole
}

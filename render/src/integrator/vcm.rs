//! Vertex connection and merging: every strategy of bidirectional path tracing, and in the same weighted sum photon mapping
//! at every vertex that is not Dirac (Georgiev et al. 2012; Hachisuka et al. 2012; Georgiev 2012, "Implementing Vertex
//! Connection and Merging").
//!
//! A round emits light paths whose vertices become the round's map, and takes one camera sample of each pixel. The sample is
//! connected to one light path, made anew from its index, and merged with the map within the round's radius, which falls from
//! round to round (Knaus and Zwicker 2011), so that the blur of merging vanishes from the mean.
//!
//! Camera sample p (the number of its pixel) is connected to light path p modulo the round's number of paths. Each path is shown
//! to the camera once, by the pixel whose number is the path's modulo the number of pixels.

use super::bdpt::Bdpt;
use super::connect::Connector;
use super::progressive::{FirstRound, first_radius};
use super::radius::radius_of_round;
use super::sample::Sample;
use super::tile::SampleId;
use super::vertex::{Merging, Start, Vertex, Walk};
use crate::film::LightImage;
use crate::geometry::Ray;
use crate::material::{Scatter, TransportMode};
use crate::math::sobol::Sampler;
use crate::math::{Purpose, Rgb};
use crate::photon::estimate::for_each_on_surface;
use crate::photon::kernel::Kernel;
use crate::photon::map::PhotonMap;
use crate::photon::pack::{encode_direction, encode_normal, encode_rgbe};
use crate::photon::trace::in_parallel;
use crate::photon::{EmissionRange, MapKind, PhotonBatch};
use crate::scene::{Camera, Scene};
use crate::settings::RenderSettings;

/// What a round of a job is made of.
#[derive(Clone, Copy)]
pub struct Round<'a> {
    scene: &'a Scene,
    camera: &'a Camera,
    settings: &'a RenderSettings,
    /// Index of its first light path in the job's sequence, and their number.
    first: u64,
    paths: u64,
    /// Merge radius, scene units.
    radius: f32,
}

impl<'a> Round<'a> {
    /// Round `round` of a job whose first radius is `first_radius`, scene units.
    pub fn new(
        scene: &'a Scene,
        camera: &'a Camera,
        settings: &'a RenderSettings,
        first_radius: f32,
        round: u32,
    ) -> Self {
        let first = settings.paths_before_round(settings.photons, round);
        let paths = settings.share_of_round(settings.photons, round);
        let radius = radius_of_round(first_radius, settings.radius_alpha, round);
        Round { scene, camera, settings, first, paths, radius }
    }

    fn pixels(&self) -> u64 {
        u64::from(self.settings.width) * u64::from(self.settings.height)
    }
    fn merging(&self) -> Merging {
        // Without a light there is no radius, and nothing to merge with.
        if self.radius > 0.0 { Merging::new(self.paths as f64, self.radius) } else { Merging::NONE }
    }

    /// The vertices of the round's light paths `range`, on the current rayon pool.
    pub fn emit(&self, range: EmissionRange) -> PhotonBatch {
        let max_length = self.settings.max_depth.map_or(u32::MAX, |d| d - 1);
        let (scene, mode) = (self.scene, TransportMode::Importance);
        let walk = Walk { scene, mode, merging: self.merging(), max_length, roulette: true };
        in_parallel(range, true, |index, batch| {
            let mut sampler = self.light_sampler(index);
            if let Some(start) = Start::light(scene, &mut sampler) {
                walk.run(&start, &mut sampler, |v, _| store(batch, v));
            }
        })
    }

    /// One sequence for all rounds, so that their light paths are stratified together.
    fn light_sampler(&self, index: u64) -> Sampler {
        Sampler::new(self.settings.seed, Purpose::LightPath, 0, 0, self.first + index)
    }
}

/// Light vertices within the first round's radius. Merging is one technique of several, and its blur has nothing to hide it: fewer than
/// photon mapping has of indirect light.
const FIRST_ROUND_VERTICES: f32 = 10.0;

/// The first round's merge radius, scene units, where none is given: as of progressive photon mapping, from the density of a
/// pilot's light vertices and the width of a `pixel` on the surfaces that are seen (see [`first_radius`]).
pub fn choose_first_radius(round: &Round, pilot: EmissionRange, pixel: f32) -> (usize, f32) {
    let map = PhotonMap::build(MapKind::Global, round.emit(pilot));
    let first = FirstRound { paths: round.paths, pixel, kernel: Kernel::Constant };
    (map.stored_count(), first_radius(&map, first, FIRST_ROUND_VERTICES))
}

/// Stores a light vertex.
///
/// Its power has the cosines of Veach 1997, §5.3, in it: the density of vertices measures irradiance with the geometric
/// cosine, the BSDF reflects with the shading one.
fn store(batch: &mut PhotonBatch, v: &Vertex) {
    let power = v.throughput * (v.bsdf.cos(v.wo) / v.bsdf.cos_geometric(v.wo));
    if !power.is_finite() {
        batch.non_finite += 1;
        return;
    }
    let code = encode_rgbe(power);
    let Some(vertices) = &mut batch.vertices else { return };
    if !v.is_connectible() || code == 0 {
        return;
    }
    let root = |v: f64| (v.sqrt() as f32).min(f32::MAX);
    batch.positions.push(v.point.position.to_array());
    batch.powers.push(code);
    batch.normals.push(encode_normal(v.point.ng));
    vertices.directions.push(encode_direction(v.wo));
    vertices.shares.push([root(v.quantities.vcm), root(v.quantities.vm)]);
    vertices.lengths.push(v.length.min(255) as u8);
}

/// The gather pass of a round.
pub struct Vcm<'a> {
    round: Round<'a>,
    /// The round's light vertices; without them nothing merges.
    map: Option<&'a PhotonMap>,
    bdpt: Bdpt<'a>,
    /// 1 / (paths · π · radius²): from summed power to irradiance.
    per_area: f32,
}

impl<'a> Vcm<'a> {
    /// For the samples of a tile.
    pub fn new(round: Round<'a>, map: Option<&'a PhotonMap>) -> Self {
        let light_paths = round.paths as f64 / round.pixels() as f64;
        let connector = Connector { scene: round.scene, camera: round.camera, merging: round.merging(), light_paths };
        let r = f64::from(round.radius);
        let per_area = (1.0 / (round.paths as f64 * std::f64::consts::PI * r * r)) as f32;
        Vcm { round, map, bdpt: Bdpt::new(connector, round.settings), per_area }
    }

    /// Radiance along `ray` by all strategies with t ≥ 2 and by merging; those with t = 1 are added to `light`.
    pub fn trace(&mut self, id: SampleId, ray: Ray, sampler: &mut Sampler, light: &mut LightImage) -> Sample {
        let (paths, pixels) = (self.round.paths, self.round.pixels());
        let mut sample = Sample::default();
        // The path that the sample is connected to comes last and stays.
        for turn in (0..=paths.saturating_sub(1) / pixels).rev() {
            let index = turn * pixels + id.pixel;
            if index < paths {
                light.add_rays(self.bdpt.trace_light_path(self.round.light_sampler(index)));
                self.bdpt.look_at_light_path(light);
            }
        }
        if id.pixel >= paths {
            light.add_rays(self.bdpt.trace_light_path(self.round.light_sampler(id.pixel % paths.max(1))));
        }
        self.bdpt.trace_camera_path(id, ray, sampler, &mut sample, light, |bdpt, v, sample| {
            if let Some(map) = self.map {
                sample.direct += merge(bdpt, map, v, self.round.radius) * self.per_area;
            }
        });
        sample
    }
}

/// Σ of what the light vertices within `radius` of `v` give (ibid. eqs. 7 and 42), times the area of the disc and their
/// emitted number.
fn merge(bdpt: &Bdpt, map: &PhotonMap, v: &Vertex, radius: f32) -> Rgb {
    let mut sum = Rgb::BLACK;
    let Some(vertices) = map.vertices() else { return sum };
    if !v.is_connectible() {
        return sum;
    }
    // The front's normal: a thin wall's other side is another surface, but light through this one is its light.
    for_each_on_surface(map, v.point.position, v.point.ng, radius * radius, |i| {
        let at = i as usize;
        if v.length.saturating_add(u32::from(vertices.lengths[at])) > bdpt.max_depth() {
            return;
        }
        let Some(wi) = map.direction(i) else { return };
        if let Some(c) = bdpt.connector().merge(v, wi, map.power(i), vertices.shares[at].map(f64::from)) {
            sum += c.weighted();
        }
    });
    sum
}

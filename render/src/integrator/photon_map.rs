//! The gather pass of photon mapping (Jensen 1996, 2001; Christensen 1999).
//!
//! A camera path follows specular and glossy lobes; at every diffuse lobe it meets, light comes in three parts:
//! direct light by next-event estimation (with MIS against the final-gather rays), focused light from the caustic map,
//! and the rest by final-gather rays that read the global map's precomputed irradiance where they meet a diffuse lobe.
//! With `direct_from_map` the map holds all light instead, and is looked at where the camera path meets a diffuse lobe: the plain
//! radiance estimate (Jensen 2001, ch. 7). Light that reaches glossy lobes straight from a light is then still estimated.
//! Which term counts which paths: see [`super`]; every path is counted once, by lobe, without a roughness threshold.

use super::direct::{LightDirection, light_pdf};
use super::path::first_hit;
use super::sample::{Part, Sample};
use crate::geometry::{Ray, SurfacePoint};
use crate::material::{BsdfSample, Lobes, Scatter, TransportMode};
use crate::math::ops::INV_PI;
use crate::math::sobol::Sampler;
use crate::math::{Rgb, heuristic, roulette};
use crate::photon::estimate::{self, Gather};
use crate::photon::map::{PhotonMap, PhotonMaps};
use crate::photon::query::NeighbourBuffer;
use crate::scene::segment::Interior;
use crate::scene::surfaces::{Any, Surfaces};
use crate::scene::{Scene, SceneSpace};
use crate::settings::{Estimator, RenderSettings};
use glam::Vec3;
use std::sync::Arc;

const FOCUSING: Lobes = Lobes::GLOSSY.union(Lobes::SPECULAR);

/// How the gather pass reads the maps.
#[derive(Clone, Copy, Debug)]
pub struct GatherSettings {
    /// Density estimates from the global map.
    pub global: Gather,
    /// Density estimates from the caustic map.
    pub caustic: Gather,
    /// Final-gather rays per diffuse camera vertex; 0 looks at the global map directly.
    pub final_gather: u32,
    /// The global map holds direct light, too: the diffuse lobe asks no light.
    pub direct_from_map: bool,
}

/// Where the light of a map is asked for.
#[derive(Clone, Copy)]
pub struct Query<'a> {
    /// The map.
    pub map: &'a PhotonMap,
    /// The point, scene space.
    pub position: Vec3,
    /// The unit normal of its surface, on the side that is seen.
    pub normal: Vec3,
    /// How densities are estimated.
    pub gather: &'a Gather,
}

/// How the light of a map is read.
pub trait Reading {
    /// Irradiance, where it is looked at.
    fn irradiance(&self, at: Query<'_>, buffer: &mut NeighbourBuffer) -> Rgb;
    /// Irradiance, where a final-gather ray arrives.
    fn precomputed(&self, at: Query<'_>, buffer: &mut NeighbourBuffer) -> Rgb;
}

/// All photons; precomputed nearby for final gather (Christensen 1999).
#[derive(Clone, Copy, Debug)]
pub struct Whole;

impl Reading for Whole {
    fn irradiance(&self, at: Query<'_>, buffer: &mut NeighbourBuffer) -> Rgb {
        estimate::irradiance_into(at.map, at.position, at.normal, at.gather, buffer).irradiance
    }
    fn precomputed(&self, at: Query<'_>, buffer: &mut NeighbourBuffer) -> Rgb {
        at.map.precomputed(at.gather.k).irradiance(at.map, at.position, at.normal, at.gather, buffer)
    }
}

/// One gather pass over one scene and its maps.
pub struct PhotonGather<'a, R = Whole, S = Any> {
    /// The scene.
    pub scene: &'a Scene,
    /// The maps; a missing one holds no light.
    pub maps: &'a PhotonMaps,
    /// How they are read.
    pub settings: GatherSettings,
    /// What is read of the maps.
    pub reading: R,
    /// What its surfaces can be.
    pub surfaces: S,
    /// Memory of the neighbour searches, reused from call to call.
    pub buffer: NeighbourBuffer,
}

impl GatherSettings {
    /// The settings of a job: a largest radius that nobody gave comes from each map's own density.
    pub fn new(settings: &RenderSettings, maps: &PhotonMaps, space: &SceneSpace) -> Self {
        let gather = |map: &Option<Arc<PhotonMap>>| {
            let radius = map.as_ref().map_or(0.0, |m| gather_radius(settings, m, space));
            if let (Estimator::Hash, Some(map)) = (settings.estimator, map) {
                map.enable_hash_grid(radius);
            }
            Gather { k: settings.k, max_radius_squared: radius * radius, kernel: settings.kernel }
        };
        GatherSettings {
            global: gather(&maps.global),
            caustic: gather(&maps.caustic),
            final_gather: settings.final_gather,
            direct_from_map: settings.direct_from_map,
        }
    }
}

/// The largest gather radius in `map`, scene space: what the user gave, or what the map's density suggests. The hash grid
/// gathers within it everywhere, so there it is the distance that holds k photons at nine in ten of them, not twice that.
pub fn gather_radius(settings: &RenderSettings, map: &PhotonMap, space: &SceneSpace) -> f32 {
    match (settings.max_radius, settings.estimator) {
        (Some(world), _) => space.length(f64::from(world)),
        (None, Estimator::KdTree) => map.default_max_radius(settings.k),
        (None, Estimator::Hash) => 0.5 * map.default_max_radius(settings.k),
    }
}

/// Most branchings of one camera sample.
const MAX_SPLITS: u32 = 4;
/// Least share of the camera sample's light that both branches carry where a path branches; where one has less, it is left to chance.
const LEAST_BRANCH: f32 = 0.01;

/// The branches of one camera sample. Where clear glass both reflects and transmits, both ways are followed: a lamp that is seen by the
/// fainter of them would otherwise be found by few samples only, each of them bright (splitting, Arvo and Kirk 1990).
struct RayTree {
    /// Branches that are still to be followed, with their random numbers.
    waiting: Vec<(CameraPath, Sampler)>,
    /// How often it may branch yet.
    splits: u32,
}

impl RayTree {
    /// The two ways from a Dirac surface met by a path that carries `value`, if both are to be followed.
    fn split(&mut self, bsdf: &impl Scatter, wo: Vec3, value: Rgb) -> Option<[BsdfSample; 2]> {
        if bsdf.lobes() != Lobes::SPECULAR || self.splits == 0 {
            return None;
        }
        let mut ways = bsdf.dirac_samples(wo, TransportMode::Radiance).into_iter().flatten();
        let (first, second, third) = (ways.next()?, ways.next()?, ways.next());
        let is_bright = |s: &BsdfSample| (value * s.weight).max_component() >= LEAST_BRANCH;
        let splits = third.is_none() && is_bright(&first) && is_bright(&second);
        self.splits -= u32::from(splits);
        splits.then_some([first, second])
    }
}

/// A branch of a camera path, on its way to its next surface.
struct CameraPath {
    ray: Ray,
    /// Share of the camera sample's light that its first ray carries.
    share: Rgb,
    /// What is left of that; roulette goes by it alone.
    throughput: Rgb,
    interior: Interior,
    /// Where the ray comes from, and the pdf of the scattering there; infinite where next-event estimation could not find the light.
    from: Vec3,
    pdf: f32,
    bounce: u32,
}

impl CameraPath {
    fn new(ray: Ray) -> Self {
        let (from, interior) = (ray.origin, Interior::default());
        CameraPath { ray, share: Rgb::WHITE, throughput: Rgb::WHITE, interior, from, pdf: f32::INFINITY, bounce: 0 }
    }
    fn is_camera_ray(&self) -> bool {
        self.bounce == 0
    }
    fn value(&self) -> Rgb {
        self.share * self.throughput
    }
    /// Goes on in the direction `s`, whose weight is in the throughput.
    fn leave<B>(&mut self, scene: &Scene, v: &Vertex<'_, B>, s: &BsdfSample) {
        (self.from, self.pdf) = (v.point.position, if s.lobe == Lobes::SPECULAR { f32::INFINITY } else { s.pdf });
        if s.transmitted {
            self.interior = self.interior.crossed(scene, v.point, s.wi);
        }
        self.ray = Ray::new(v.point.spawn(s.wi), s.wi);
        self.bounce += 1;
    }
    /// The branch in the direction `s`.
    fn branch<B>(&self, scene: &Scene, v: &Vertex<'_, B>, s: &BsdfSample) -> CameraPath {
        let mut branch = CameraPath { share: self.value() * s.weight, throughput: Rgb::WHITE, ..*self };
        branch.leave(scene, v, s);
        branch
    }
}

/// A vertex where light is gathered.
struct Vertex<'v, B> {
    point: &'v SurfacePoint,
    bsdf: &'v B,
    wo: Vec3,
    interior: Interior,
}

impl<R: Reading, S: Surfaces> PhotonGather<'_, R, S> {
    /// Radiance along `camera_ray`.
    pub fn trace(&mut self, camera_ray: Ray, sampler: &mut Sampler) -> Sample {
        let (mut sample, mut tree) = (Sample::default(), RayTree { waiting: Vec::new(), splits: MAX_SPLITS });
        self.follow(CameraPath::new(camera_ray), sampler, &mut tree, &mut sample);
        while let Some((path, mut sampler)) = tree.waiting.pop() {
            self.follow(path, &mut sampler, &mut tree, &mut sample);
        }
        sample
    }

    /// Follows one branch of a camera path to its end.
    fn follow(&mut self, mut path: CameraPath, sampler: &mut Sampler, tree: &mut RayTree, sample: &mut Sample) {
        let scene = self.scene;
        loop {
            sample.rays += 1;
            let Some((point, distance)) = S::intersect(scene, &path.ray) else { return };
            let wo = -path.ray.direction;
            path.throughput *= path.interior.transmittance_to(scene, &point, wo, distance);
            let emission = scene.emission(&point, wo);
            if !emission.is_black() {
                let weight = if path.pdf == f32::INFINITY {
                    1.0
                } else {
                    self.hit_weight(path.pdf, path.from, &path.ray, distance, &point)
                };
                sample.add(Part::Direct, path.value() * emission * weight);
            }
            let bsdf = S::bsdf(scene, &point);
            if path.is_camera_ray() {
                sample.first = Some(first_hit(&point, &bsdf, wo));
            }
            let vertex = Vertex { point: &point, bsdf: &bsdf, wo, interior: path.interior };
            self.direct_light(&vertex, path.value(), sampler, sample);
            if bsdf.lobes().intersects(Lobes::DIFFUSE) {
                self.diffuse_light(&vertex, path.value(), sampler, sample);
            }
            if let Some([first, second]) = tree.split(&bsdf, wo, path.value()) {
                tree.waiting.push((path.branch(scene, &vertex, &second), sampler.branch(0, 1)));
                path = path.branch(scene, &vertex, &first);
                continue;
            }
            let u = sampler.next_3d();
            let Some(s) = self.continue_path(&bsdf, wo, u, &mut path.throughput, path.bounce, sampler) else { return };
            path.leave(scene, &vertex, &s);
        }
    }

    /// Follows a specular or glossy lobe, with roulette; `throughput` is updated.
    fn continue_path(
        &self,
        bsdf: &S::Bsdf,
        wo: Vec3,
        u: [f32; 3],
        throughput: &mut Rgb,
        bounce: u32,
        sampler: &mut Sampler,
    ) -> Option<BsdfSample> {
        let u_roulette = sampler.next_1d();
        if !bsdf.lobes().intersects(FOCUSING) {
            return None;
        }
        let s = bsdf.sample(wo, u, FOCUSING, TransportMode::Radiance)?;
        *throughput *= s.weight;
        let survival = roulette::camera_survival(throughput.max_component(), bounce);
        if u_roulette >= survival {
            return None;
        }
        *throughput *= 1.0 / survival;
        Some(s)
    }

    /// MIS weight of emission met by a scattered ray of density `pdf` against one light sample.
    fn hit_weight(&self, pdf: f32, from: Vec3, ray: &Ray, distance: f32, hit: &SurfacePoint) -> f32 {
        heuristic::power(pdf, light_pdf(self.scene, from, ray.direction, distance, hit))
    }

    /// Next-event estimation for the diffuse and the glossy lobe, each with the weight that its own second technique
    /// (final-gather rays, the glossy continuation) leaves it.
    fn direct_light(&self, v: &Vertex<'_, S::Bsdf>, throughput: Rgb, sampler: &mut Sampler, sample: &mut Sample) {
        let Some(light) = LightDirection::sample(self.scene, v.point, sampler) else { return };
        let f = |lobes| v.bsdf.eval(v.wo, light.wi, lobes, TransportMode::Radiance);
        let diffuse = if self.settings.direct_from_map { Rgb::BLACK } else { f(Lobes::DIFFUSE) };
        let glossy = f(Lobes::GLOSSY);
        if diffuse.is_black() && glossy.is_black() {
            return;
        }
        sample.rays += 1;
        if !light.is_visible(self.scene) {
            return;
        }
        let pdf = |lobes| v.bsdf.pdf(v.wo, light.wi, lobes, TransportMode::Radiance);
        let gather_rays = self.settings.final_gather as f32;
        let w_diffuse = heuristic::power(light.pdf, gather_rays * pdf(Lobes::DIFFUSE));
        let w_glossy = heuristic::power(light.pdf, pdf(FOCUSING));
        let body = v.interior.leaving(self.scene, v.point, v.wo, light.wi);
        let incident = throughput
            * light.weighted_radiance
            * body.transmittance(self.scene, light.distance)
            * v.bsdf.cos(light.wi);
        sample.add(Part::Direct, incident * (diffuse * w_diffuse + glossy * w_glossy));
    }

    /// Light on the diffuse lobe that does not come straight from a light.
    fn diffuse_light(&mut self, v: &Vertex<'_, S::Bsdf>, throughput: Rgb, sampler: &mut Sampler, sample: &mut Sample) {
        let reflectance = v.bsdf.diffuse_albedo(v.wo);
        if reflectance.is_black() {
            return;
        }
        let normal = facing(v.point.ng, v.wo);
        let radiance = throughput * reflectance * INV_PI;
        let maps = self.maps;
        if let Some(map) = &maps.caustic {
            let gather = self.settings.caustic;
            let e = self.irradiance(map, v.point.position, normal, &gather);
            sample.add(Part::Caustic, radiance * e);
        }
        if self.settings.final_gather == 0 {
            if let Some(map) = &maps.global {
                let gather = self.settings.global;
                let e = self.irradiance(map, v.point.position, normal, &gather);
                sample.add(Part::Indirect, radiance * e);
            }
            return;
        }
        let share = 1.0 / self.settings.final_gather as f32;
        for ray in 0..self.settings.final_gather {
            // Stratified together with the rays of all the pixel's samples.
            let mut sampler = sampler.branch(ray, self.settings.final_gather);
            let u = sampler.next_3d();
            let Some(s) = v.bsdf.sample(v.wo, u, Lobes::DIFFUSE, TransportMode::Radiance) else { continue };
            self.final_gather(v, &s, throughput * s.weight * share, &mut sampler, sample);
        }
    }

    /// One final-gather ray: emission by MIS (the second technique of direct light), then the global map at diffuse
    /// lobes, through specular and glossy ones. Emission behind those is the caustic map's, and is not counted here.
    fn final_gather(
        &mut self,
        v: &Vertex<'_, S::Bsdf>,
        start: &BsdfSample,
        mut throughput: Rgb,
        sampler: &mut Sampler,
        sample: &mut Sample,
    ) {
        let (scene, maps) = (self.scene, self.maps);
        let reference = throughput.max_component();
        if reference <= 0.0 {
            return;
        }
        let mut ray = Ray::new(v.point.spawn(start.wi), start.wi);
        let mut interior = v.interior;
        for bounce in 0.. {
            sample.rays += 1;
            let Some((point, distance)) = S::intersect(scene, &ray) else { return };
            let wo = -ray.direction;
            throughput *= interior.transmittance_to(scene, &point, wo, distance);
            if bounce == 0 {
                let emission = scene.emission(&point, wo);
                if !emission.is_black() {
                    let pdf = self.settings.final_gather as f32 * start.pdf;
                    let weight = self.hit_weight(pdf, v.point.position, &ray, distance, &point);
                    sample.add(Part::Direct, throughput * emission * weight);
                }
            }
            let Some(map) = &maps.global else { return };
            let bsdf = S::bsdf(scene, &point);
            if bsdf.lobes().intersects(Lobes::DIFFUSE) {
                let e = self.precomputed(map, &point, wo);
                sample.add(Part::Indirect, throughput * bsdf.diffuse_albedo(wo) * e * INV_PI);
            }
            // Roulette relative to the gather ray's own start, so that `final_gather` does not change it.
            let mut relative = throughput * (1.0 / reference);
            let u = sampler.next_3d();
            let Some(s) = self.continue_path(&bsdf, wo, u, &mut relative, bounce + 1, sampler) else { return };
            throughput = relative * reference;
            if s.transmitted {
                interior = interior.crossed(scene, &point, s.wi);
            }
            ray = Ray::new(point.spawn(s.wi), s.wi);
        }
    }

    fn irradiance(&mut self, map: &PhotonMap, position: Vec3, normal: Vec3, gather: &Gather) -> Rgb {
        self.reading.irradiance(Query { map, position, normal, gather }, &mut self.buffer)
    }

    /// Irradiance where a final-gather ray arrives.
    fn precomputed(&mut self, map: &PhotonMap, point: &SurfacePoint, wo: Vec3) -> Rgb {
        let gather = &self.settings.global;
        let at = Query { map, position: point.position, normal: facing(point.ng, wo), gather };
        self.reading.precomputed(at, &mut self.buffer)
    }
}

#[inline]
fn facing(n: Vec3, w: Vec3) -> Vec3 {
    if n.dot(w) < 0.0 { -n } else { n }
}

//! The narrow waist between light transport and the cluster: what one job computes, phase by phase.
//!
//! Every function here is a pure function of (scene bundle, settings, index range), so any worker may run any range, at
//! any time, more than once, and the image has the same bits.

use crate::error::{SceneError, SettingsError};
use crate::film::{Accumulator, ChannelSet, LightImage, MapError, SampleMap, Tile, TileGrid, TileRect};
use crate::import::{self, SceneBundle, Wanted};
use crate::integrator::bdpt::Bdpt;
use crate::integrator::mlt::Mlt;
use crate::integrator::photon_map::{self, GatherSettings, PhotonGather, Whole};
use crate::integrator::radius::blur_of_rounds;
use crate::integrator::tile::Samples;
use crate::integrator::vcm::{self, Vcm};
use crate::integrator::whitted::Whitted;
use crate::integrator::{Bootstrap, map_error, path, progressive, tile};
use crate::math::Rgb;
use crate::photon::aim::AimedEmission;
use crate::photon::query::NeighbourBuffer;
use crate::photon::trace::{Emission, Storage};
use crate::photon::{EmissionRange, MapKind, PhotonBatch};
use crate::plan::{self, EmissionPlan, Plan};
use crate::scene::surfaces::{Any, Bare, Surfaces};
use crate::scene::{Camera, Scene, SceneDigest, builder};
use crate::settings::{Layer, Method, RenderSettings};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

pub use crate::photon::map::{PhotonMap, PhotonMaps};

/// One phase of a job, in the order of [`PreparedJob::phases`]. Work units of a phase are numbered from 0.
///
/// A gather phase needs the maps of its own round; a splat phase needs the bootstrap, where there is one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Emit photon paths 0 … `paths` for `map`; then merge and broadcast the map.
    Emission {
        /// The round, from 0.
        round: u32,
        /// The map they are for.
        map: MapKind,
        /// Number of paths.
        paths: u64,
    },
    /// Trace bootstrap paths 0 … `paths`; then join their luminances and broadcast them.
    Bootstrap {
        /// Number of paths.
        paths: u64,
    },
    /// Decide by what is closed how many samples each pixel takes from `round` on; then broadcast that. No work for workers.
    SampleMap {
        /// The first round that goes by it.
        round: u32,
    },
    /// Compute units 0 … `units` of the round that splat onto the light image: Markov chains, or whole rounds of the method.
    Splat {
        /// The round, from 0.
        round: u32,
        /// Number of units.
        units: u64,
    },
    /// Render tiles 0 … `tiles`.
    Gather {
        /// The round, from 0.
        round: u32,
        /// Number of tiles.
        tiles: u32,
    },
}

impl Phase {
    /// Number of work units.
    pub fn units(&self) -> u64 {
        match *self {
            Phase::Emission { paths, .. } | Phase::Bootstrap { paths } => paths,
            Phase::SampleMap { .. } => 0,
            Phase::Splat { units, .. } => units,
            Phase::Gather { tiles, .. } => u64::from(tiles),
        }
    }
    /// The round it belongs to.
    pub fn round(&self) -> u32 {
        match *self {
            Phase::Emission { round, .. } | Phase::Gather { round, .. } | Phase::Splat { round, .. } => round,
            Phase::SampleMap { round } => round,
            Phase::Bootstrap { .. } => 0,
        }
    }
    /// Whether it makes the image of its round.
    pub const fn makes_image(&self) -> bool {
        matches!(self, Phase::Gather { .. } | Phase::Splat { .. })
    }
}

/// What a gather or splat phase reads that earlier phases made.
#[derive(Clone, Debug, Default)]
pub struct Inputs {
    /// The photon maps of the round.
    pub maps: PhotonMaps,
    /// The bootstrap of the Markov chains.
    pub bootstrap: Option<Arc<Bootstrap>>,
    /// Where the samples go, once that is decided.
    pub sample_map: Option<Arc<SampleMap>>,
}

/// Why a job cannot start.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum JobError {
    /// The scene is at fault.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A setting is at fault.
    #[error(transparent)]
    Settings(#[from] SettingsError),
}

/// What of a scene an image with these settings asks for.
pub fn wanted(settings: &RenderSettings) -> Wanted {
    let surface = |l: &Layer| matches!(l, Layer::Albedo | Layer::Normal);
    Wanted { everything: settings.keep_all, surface_layers: settings.layers.iter().any(surface), images: true }
}

/// The bundle that a cluster needs for an image with these settings, without what nothing of it reads.
///
/// # Errors
/// When the scene is damaged.
pub fn cut(bundle: &SceneBundle, settings: &RenderSettings) -> Result<SceneBundle, SceneError> {
    import::cut(bundle, SceneDigest::of(bundle).0, wanted(settings))
}

/// A scene ready to render with its settings.
pub struct PreparedJob {
    settings: RenderSettings,
    digest: SceneDigest,
    scene: Scene,
    camera: Camera,
    aim: Option<AimedEmission>,
    plan: Plan,
    warnings: Vec<String>,
}

impl PreparedJob {
    /// Imports and builds the scene and makes the plan. Deterministic: both ends hold the same.
    ///
    /// # Errors
    /// When the scene or a setting makes no sense.
    pub fn prepare(bundle: &SceneBundle, settings: &RenderSettings) -> Result<Self, JobError> {
        settings.validate()?;
        let description = import::load_for(bundle, wanted(settings))?;
        Self::from_description(description, SceneDigest::of(bundle), settings)
    }

    /// Like [`PreparedJob::prepare`], for a scene made in code; `digest` names it.
    ///
    /// # Errors
    /// When the scene or a setting makes no sense.
    pub fn from_description(
        mut description: crate::scene::description::SceneDescription,
        digest: SceneDigest,
        settings: &RenderSettings,
    ) -> Result<Self, JobError> {
        settings.validate()?;
        let cameras = std::mem::take(&mut description.cameras);
        let parts = std::mem::take(&mut description.parts);
        let bounds = builder::world_bounds(&description);
        let mut scene = builder::build(description)?;
        // Testing every hit for holes finds none where there are none.
        scene.has_alpha_masks |= settings.keep_all;
        scene.has_absorption |= settings.keep_all;
        scene.is_bare &= !settings.keep_all;
        let (width, height) = (settings.width, settings.height);
        let (camera, note) = builder::choose_camera(&cameras, bounds, &scene.space, &settings.camera, width, height)?;
        let mut warnings = std::mem::take(&mut scene.warnings);
        warnings.extend(note);
        if scene.lights.is_empty() {
            warnings.push("the scene has no light: the image will be black".into());
        }
        let wants_aim = plan::reads_photons(settings.method)
            && !settings.direct_from_map
            && settings.caustic_photons > 0
            && (scene.has_diffuse() || settings.keep_all);
        let aim = if wants_aim { AimedEmission::new(&scene) } else { None };
        let plan = Plan::new(&scene, &camera, settings, aim.as_ref(), parts);
        // As they are divided, so that who asks for as many gets the same image.
        let mut settings = settings.clone();
        if settings.divide_photons {
            let paths = |e: &Option<EmissionPlan>, given| e.map_or(given, |e| e.paths);
            settings.photons = paths(&plan.global, settings.photons);
            settings.caustic_photons = paths(&plan.caustic, settings.caustic_photons);
            settings.divide_photons = false;
        }
        Ok(PreparedJob { settings, digest, scene, camera, aim, plan, warnings })
    }

    /// The settings.
    pub fn settings(&self) -> &RenderSettings {
        &self.settings
    }
    /// What the scene's bytes hash to.
    pub fn scene_digest(&self) -> SceneDigest {
        self.digest
    }
    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }
    /// What will be done and what is left out.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }
    /// What a user should know: unsupported features, a made-up camera, no light.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }
    /// Whether there is any light, so that the image is not black.
    pub fn has_light(&self) -> bool {
        !self.scene.lights.is_empty()
    }

    /// What has to be done, in order. The last phase is always a gather or splat phase.
    pub fn phases(&self) -> Vec<Phase> {
        let is_mlt = self.settings.method == Method::Mlt;
        if !self.is_splatted() {
            return (0..self.rounds()).flat_map(|round| self.phases_of_round(round)).collect();
        }
        let bootstrap = is_mlt.then_some(Phase::Bootstrap { paths: self.settings.bootstrap });
        let units = |round| self.settings.parts_of_round(round).len() as u64;
        let splats = (0..self.rounds()).map(|round| Phase::Splat { round, units: units(round) });
        bootstrap.into_iter().chain(splats).collect()
    }
    /// Whether the image is made of splats alone, by splat phases.
    pub fn is_splatted(&self) -> bool {
        self.settings.method == Method::Mlt || self.settings.has_independent_rounds()
    }
    fn phases_of_round(&self, round: u32) -> impl Iterator<Item = Phase> {
        let emission = |map, e: &Option<EmissionPlan>| {
            // Rounds that are no more than passes over the pixels all read the maps of the first.
            let e = e.filter(|_| round == 0 || self.settings.method.has_rounds())?;
            Some(Phase::Emission { round, map, paths: self.paths_of_round(e.paths, round) })
        };
        let decides = self.settings.pilot_rounds() == Some(round);
        [emission(MapKind::Global, &self.plan.global), emission(MapKind::Caustic, &self.plan.caustic)]
            .into_iter()
            .flatten()
            .chain(decides.then_some(Phase::SampleMap { round }))
            .chain([Phase::Gather { round, tiles: self.grid().len() }])
    }
    /// Number of rounds that the image is the mean of, ≥ 1.
    pub fn rounds(&self) -> u32 {
        self.settings.image_rounds()
    }
    /// An empty film that waits for all rounds.
    pub fn accumulator(&self) -> Accumulator {
        let weight = |round| self.settings.parts_of_round(round).len() as u32;
        let weights: Vec<u32> = (0..self.rounds()).map(weight).collect();
        let blocks = self.settings.blocks(&weights).map(|b| b.len() as u32).collect();
        let widths = self.blur_of_rounds(&weights);
        let film = Accumulator::in_blocks(self.grid(), self.channels(), weights, blocks);
        let film = if self.settings.layers.contains(&Layer::StandardError) { film.with_standard_error() } else { film };
        let film = match self.settings.pilot_rounds() {
            Some(rounds) => film.with_pilot(rounds),
            None => film,
        };
        match widths {
            Some(widths) if widths.len() > 1 => film.with_blur(widths),
            _ => film,
        }
    }
    /// How blurred each block of rounds is, of methods that read maps within a radius that falls.
    fn blur_of_rounds(&self, weights: &[u32]) -> Option<Vec<f64>> {
        let reads_maps = self.plan.global.is_some() || self.plan.caustic.is_some();
        (self.settings.method.has_rounds() && reads_maps).then(|| {
            let mut all = blur_of_rounds(self.settings.radius_alpha);
            let widths = |b: Range<usize>| {
                let parts = weights[b].iter().sum::<u32>();
                all.by_ref().take(parts as usize).sum::<f64>() / f64::from(parts)
            };
            self.settings.blocks(weights).map(widths).collect()
        })
    }
    fn paths_of_round(&self, total: u64, round: u32) -> u64 {
        if self.settings.method.has_rounds() { self.settings.share_of_round(total, round) } else { total }
    }
    /// An empty light image, where the method splats: what [`PreparedJob::gather`] and [`PreparedJob::splat`] add to.
    pub fn light_image(&self) -> Option<LightImage> {
        let planes = self.settings.light_planes();
        // Chains splat radiance over luminance.
        let chains = self.settings.method == Method::Mlt;
        let scale = if chains { 1.0 } else { self.scene.lights.total_power().max_component() };
        (planes > 0).then(|| LightImage::new(self.grid(), planes, scale))
    }
    /// Closes the round in the making, on the current rayon pool: all of its tiles are in `film`, or all of its units in `light`.
    pub fn close(&self, film: &mut Accumulator, light: Option<&LightImage>, bootstrap: Option<&Bootstrap>) {
        let units = self.settings.parts_of_round(film.closed_rounds()).len() as u32;
        match (light, bootstrap) {
            (Some(light), _) if self.settings.has_independent_rounds() => {
                film.close_splatted(light, 1.0 / f64::from(units.max(1)));
            }
            (Some(light), Some(bootstrap)) => {
                film.close_splatted(light, Mlt::scale(&self.settings, bootstrap, units));
                film.set_brightness(Mlt::brightness(bootstrap, film.mutations()));
            }
            _ => film.close(light),
        }
    }
    /// The tiles of the image.
    pub fn grid(&self) -> TileGrid {
        TileGrid { width: self.settings.width, height: self.settings.height }
    }
    /// The channels of a tile: those of the image, but for layers that are summed on the light image.
    pub fn channels(&self) -> ChannelSet {
        ChannelSet::of_tiles(&self.settings.layers)
    }
    /// Whether photons of `map` carry directions: those that are light vertices.
    pub fn photon_directions(&self, _map: MapKind) -> bool {
        self.settings.method == Method::Vcm
    }

    /// Traces the photon paths of `range` of `round`, in parallel on the current rayon pool.
    pub fn emit(&self, round: u32, map: MapKind, range: EmissionRange) -> PhotonBatch {
        if self.settings.method == Method::Vcm {
            return self.vcm_round(round).emit(range);
        }
        let (storage, aim) = match map {
            MapKind::Global => (self.plan.global.map_or(Storage::All, |g| g.storage), None),
            MapKind::Caustic => (Storage::Caustic, self.aim.as_ref()),
        };
        let (scene, seed) = (&self.scene, self.settings.seed);
        Emission { scene, kind: map, storage, seed, round, aim }.trace(range)
    }

    /// Luminances of the bootstrap paths of `range`, in order, in parallel on the current rayon pool.
    pub fn bootstrap(&self, range: EmissionRange) -> Vec<f32> {
        self.mlt().bootstrap(range)
    }

    /// Computes units `range` of the splat phase of `round`, in parallel on the current rayon pool, and adds them to `light`.
    pub fn splat(&self, inputs: &Inputs, round: u32, range: EmissionRange, light: &mut LightImage) {
        let before = u64::from(self.settings.parts_of_round(round).start);
        let range = EmissionRange { first: before + range.first, end: before + range.end };
        if self.settings.has_independent_rounds() {
            (range.first..range.end).for_each(|round| self.render_round(round as u32, light));
        } else if let Some(bootstrap) = &inputs.bootstrap {
            self.mlt().run(bootstrap, range, light);
        }
    }

    fn mlt(&self) -> Mlt<'_> {
        Mlt::new(&self.scene, &self.camera, &self.settings)
    }

    /// Computes a whole round here: photons, maps and all tiles.
    fn render_round(&self, round: u32, light: &mut LightImage) {
        let mut inputs = Inputs::default();
        for phase in self.phases_of_round(round) {
            match phase {
                Phase::Emission { map, paths, .. } => {
                    let batch = self.emit(round, map, EmissionRange { first: 0, end: paths });
                    inputs.maps.insert(Arc::new(self.build_map(map, batch)));
                }
                Phase::Gather { tiles, .. } => {
                    let tile = |index| {
                        let mut own = self.settings.method.splats().then(|| self.light_image()).flatten();
                        (self.gather(&inputs, round, index, own.as_mut()), own)
                    };
                    let tiles: Vec<_> = (0..tiles).into_par_iter().with_max_len(1).map(tile).collect();
                    for (tile, own) in &tiles {
                        self.splat_tile(tile, light);
                        // Of one job, so never mismatched.
                        let _ = own.as_ref().map(|own| light.add(own));
                    }
                }
                Phase::Bootstrap { .. } | Phase::SampleMap { .. } | Phase::Splat { .. } => {}
            }
        }
    }

    /// Adds a tile's colour to plane 0 and its alpha, in units, to plane 1.
    fn splat_tile(&self, tile: &Tile, light: &mut LightImage) {
        let Some(rect) = self.grid().rect(tile.index) else { return };
        let unit = light.unit();
        for (i, pixel) in tile.pixels.chunks_exact(self.channels().len()).enumerate() {
            let (x, y) = (rect.x + i as u32 % rect.width, rect.y + i as u32 / rect.width);
            light.splat(0, x, y, Rgb::new(pixel[0], pixel[1], pixel[2]));
            light.splat(1, x, y, Rgb::splat(pixel[3] * unit));
        }
        light.add_rays(tile.rays);
        light.add_non_finite(tile.non_finite);
    }

    /// Builds the search structure over merged photons (`merged.range` = [0, emitted)), in parallel on the current
    /// rayon pool.
    pub fn build_map(&self, kind: MapKind, merged: PhotonBatch) -> PhotonMap {
        PhotonMap::build(kind, merged)
    }

    /// The error that `map` brings into the image, in parallel on the current rayon pool; `None` where each round has maps of its own,
    /// so that their differences tell it.
    pub fn map_error(&self, map: &Arc<PhotonMap>) -> Option<MapError> {
        let measure = || {
            let mut maps = PhotonMaps::default();
            maps.insert(map.clone());
            map_error::measure(&self.scene, &self.camera, &self.settings, &maps)
        };
        (self.settings.method == Method::Photon && self.rounds() > 1).then(measure)
    }

    /// Largest radius `map` is searched with, in world units: given, or chosen from the map's density.
    pub fn gather_radius(&self, map: &PhotonMap) -> f32 {
        let space = &self.scene.space;
        let first = match map.kind() {
            MapKind::Global => &self.plan.global,
            MapKind::Caustic => &self.plan.caustic,
        };
        let radius = match (self.settings.method, first) {
            (Method::Progressive | Method::Vcm, Some(e)) => e.first_radius,
            _ => photon_map::gather_radius(&self.settings, map, space),
        };
        space.length_to_world(radius) as f32
    }

    /// Renders tile `index` of `round`, on the current thread; what lands elsewhere in the image is added to `light`, which
    /// is there where [`PreparedJob::light_image`] says so.
    pub fn gather(&self, inputs: &Inputs, round: u32, index: u32, light: Option<&mut LightImage>) -> Tile {
        let Some(rect) = self.grid().rect(index) else {
            return Tile { index, pixels: Vec::new(), non_finite: 0, rays: 0 };
        };
        let (settings, scene, camera) = (&self.settings, &self.scene, &self.camera);
        let maps = &inputs.maps;
        let samples = Samples { even: settings.samples_of_round(round), map: inputs.sample_map.as_deref() };
        match settings.method {
            Method::Bdpt | Method::Vcm => {
                let mut nowhere = None;
                let light = light.unwrap_or_else(|| nowhere.insert(LightImage::new(self.grid(), 1, 0.0)));
                if settings.method == Method::Vcm {
                    let mut vcm = Vcm::new(self.vcm_round(round), maps.global.as_deref());
                    return tile::render_numbered(
                        index,
                        rect,
                        settings,
                        camera,
                        &scene.space,
                        samples,
                        |id, ray, s| vcm.trace(id, ray, s, light),
                    );
                }
                let mut bdpt = Bdpt::alone(scene, camera, settings);
                tile::render_numbered(index, rect, settings, camera, &scene.space, samples, |id, ray, sampler| {
                    bdpt.trace(id, ray, sampler, light)
                })
            }
            Method::Whitted => {
                let mut tree = Whitted::new(scene, settings.max_depth);
                tile::render(index, rect, settings, camera, &scene.space, samples, |ray, sampler| {
                    tree.trace(ray, sampler)
                })
            }
            _ if scene.is_bare => self.gather_among(Bare, maps, round, index, rect, samples),
            _ => self.gather_among(Any, maps, round, index, rect, samples),
        }
    }

    /// [`PreparedJob::gather`] of the methods that are compiled for each kind of surfaces by itself.
    fn gather_among<S: Surfaces>(
        &self,
        surfaces: S,
        maps: &PhotonMaps,
        round: u32,
        index: u32,
        rect: TileRect,
        samples: Samples<'_>,
    ) -> Tile {
        let (settings, scene, camera) = (&self.settings, &self.scene, &self.camera);
        if !matches!(settings.method, Method::Photon | Method::Progressive) {
            return tile::render(index, rect, settings, camera, &scene.space, samples, |ray, sampler| {
                path::trace::<S>(scene, ray, settings.max_depth, sampler)
            });
        }
        let (gather, buffer) = (self.gather_settings(maps, round), NeighbourBuffer::new());
        let mut pass = PhotonGather { scene, maps, settings: gather, reading: Whole, surfaces, buffer };
        tile::render(index, rect, settings, camera, &scene.space, samples, |ray, sampler| pass.trace(ray, sampler))
    }

    fn vcm_round(&self, round: u32) -> vcm::Round<'_> {
        let first_radius = self.plan.global.map_or(0.0, |e| e.first_radius);
        vcm::Round::new(&self.scene, &self.camera, &self.settings, first_radius, round)
    }

    fn gather_settings(&self, maps: &PhotonMaps, round: u32) -> GatherSettings {
        if self.settings.method == Method::Photon {
            return GatherSettings::new(&self.settings, maps, &self.scene.space);
        }
        let first = |e: &Option<EmissionPlan>| e.map_or(0.0, |e| e.first_radius);
        progressive::gather_settings(&self.settings, first(&self.plan.global), first(&self.plan.caustic), round)
    }
}

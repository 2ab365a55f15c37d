//! The narrow waist between light transport and the cluster: what one job computes, phase by phase.
//!
//! Every function here is a pure function of (scene bundle, settings, index range), so any worker may run any range, at
//! any time, more than once, and the image has the same bits.

use crate::error::{SceneError, SettingsError};
use crate::film::{ChannelSet, Tile, TileGrid};
use crate::import::{self, SceneBundle};
use crate::integrator::photon_map::{self, GatherSettings, PhotonGather};
use crate::integrator::{path, tile};
use crate::photon::aim::AimedEmission;
use crate::photon::query::NeighbourBuffer;
use crate::photon::trace::{Emission, Storage};
use crate::photon::{EmissionRange, MapKind, PhotonBatch};
use crate::plan::{EmissionPlan, Plan};
use crate::scene::{Camera, Scene, SceneDigest, builder};
use crate::settings::{Method, RenderSettings};

pub use crate::photon::map::{PhotonMap, PhotonMaps};

/// One phase of a job, in the order of [`PreparedJob::phases`]. Work units of a phase are numbered from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Emit photon paths 0 … `paths` for `map`; then merge and broadcast the map.
    Emission {
        /// The map they are for.
        map: MapKind,
        /// Number of paths.
        paths: u64,
    },
    /// Render tiles 0 … `tiles`.
    Gather {
        /// Number of tiles.
        tiles: u32,
    },
}

impl Phase {
    /// Number of work units.
    pub fn units(&self) -> u64 {
        match *self {
            Phase::Emission { paths, .. } => paths,
            Phase::Gather { tiles } => u64::from(tiles),
        }
    }
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
        let description = import::load(bundle)?;
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
        let bounds = builder::world_bounds(&description);
        let mut scene = builder::build(description)?;
        let (width, height) = (settings.width, settings.height);
        let (camera, note) = builder::choose_camera(&cameras, bounds, &scene.space, &settings.camera, width, height)?;
        let mut warnings = std::mem::take(&mut scene.warnings);
        warnings.extend(note);
        if scene.lights.is_empty() {
            warnings.push("the scene has no light: the image will be black".into());
        }
        let wants_aim = settings.method == Method::Photon && settings.caustic_photons > 0 && scene.has_diffuse();
        let aim = if wants_aim { AimedEmission::new(&scene) } else { None };
        let plan = Plan::new(&scene, settings, aim.as_ref());
        Ok(PreparedJob { settings: settings.clone(), digest, scene, camera, aim, plan, warnings })
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

    /// What has to be done, in order. The last phase is always the gather pass.
    pub fn phases(&self) -> Vec<Phase> {
        let emission = |map, e: &Option<EmissionPlan>| e.map(|e| Phase::Emission { map, paths: e.paths });
        [emission(MapKind::Global, &self.plan.global), emission(MapKind::Caustic, &self.plan.caustic)]
            .into_iter()
            .flatten()
            .chain([Phase::Gather { tiles: self.grid().len() }])
            .collect()
    }
    /// The tiles of the image.
    pub fn grid(&self) -> TileGrid {
        TileGrid { width: self.settings.width, height: self.settings.height }
    }
    /// The channels of the image.
    pub fn channels(&self) -> ChannelSet {
        ChannelSet::new(&self.settings.layers)
    }
    /// Whether photons of `map` carry directions.
    pub fn photon_directions(&self, _map: MapKind) -> bool {
        false
    }

    /// Traces the photon paths of `range`, in parallel on the current rayon pool.
    pub fn emit(&self, map: MapKind, range: EmissionRange) -> PhotonBatch {
        let (storage, aim) = match map {
            MapKind::Global => (self.plan.global.map_or(Storage::All, |g| g.storage), None),
            MapKind::Caustic => (Storage::Caustic, self.aim.as_ref()),
        };
        let (scene, seed) = (&self.scene, self.settings.seed);
        Emission { scene, kind: map, storage, seed, round: 0, aim }.trace(range)
    }

    /// Builds the search structure over merged photons (`merged.range` = [0, emitted)), in parallel on the current
    /// rayon pool.
    pub fn build_map(&self, kind: MapKind, merged: PhotonBatch) -> PhotonMap {
        PhotonMap::build(kind, merged)
    }

    /// Largest radius `map` is searched with, in world units: given, or chosen from the map's density.
    pub fn gather_radius(&self, map: &PhotonMap) -> f32 {
        let space = &self.scene.space;
        space.length_to_world(photon_map::gather_radius(&self.settings, map, space)) as f32
    }

    /// Renders tile `index`, on the current thread.
    pub fn gather(&self, maps: &PhotonMaps, index: u32) -> Tile {
        let Some(rect) = self.grid().rect(index) else {
            return Tile { index, pixels: Vec::new(), non_finite: 0, rays: 0 };
        };
        let (settings, scene, camera) = (&self.settings, &self.scene, &self.camera);
        match settings.method {
            Method::Path => tile::render(index, rect, settings, camera, &scene.space, |ray, sampler| {
                path::trace(scene, ray, settings.max_depth, sampler)
            }),
            Method::Photon => {
                let gather = GatherSettings::new(settings, maps, &scene.space);
                let mut pass = PhotonGather { scene, maps, settings: gather, buffer: NeighbourBuffer::new() };
                tile::render(index, rect, settings, camera, &scene.space, |ray, sampler| pass.trace(ray, sampler))
            }
        }
    }
}

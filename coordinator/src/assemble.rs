//! Tiles and light image → image. Runs on the compute threads.

use crate::driver::{Image, KeepImage};
use crate::reduce::LightSum;
use crate::store::Store;
use gatherlight_render::export::ImageMetadata;
use gatherlight_render::export::exr;
use gatherlight_render::film::{Accumulator, Film, LightImage};
use gatherlight_render::integrator::Bootstrap;
use gatherlight_render::job::{Inputs, PhotonMaps, PreparedJob};
use std::sync::Arc;

/// What an image is made of.
pub(crate) struct Parts {
    /// The tiles of all rounds.
    pub(crate) film: Accumulator,
    /// Rounds of it that must be complete.
    pub(crate) rounds: u32,
    /// What was splatted, where the method splats.
    pub(crate) light: Option<Light>,
}

/// The light image and what scales it.
pub(crate) struct Light {
    /// The sum over all leases.
    pub(crate) sum: Arc<LightSum>,
    /// The job.
    pub(crate) prepared: Arc<PreparedJob>,
    /// Its bootstrap, where it has one.
    pub(crate) bootstrap: Option<Arc<Bootstrap>>,
    /// Rounds of the gather phase done, or the job's where it has no gather phase.
    pub(crate) rounds: u32,
    /// Units of the splat phase done.
    pub(crate) units: u64,
}

impl Light {
    /// The sum, and the factor on it in the image.
    fn finish(self) -> Result<(LightImage, f64), String> {
        let empty = self.prepared.light_image().ok_or("the method has no light image")?;
        let sum = self.sum.finish(empty).map_err(|e| e.to_string())?;
        let inputs = Inputs { maps: PhotonMaps::default(), bootstrap: self.bootstrap };
        Ok((sum, self.prepared.light_scale(&inputs, self.rounds, self.units)))
    }
}

impl Parts {
    /// The whole film.
    fn film(self) -> Result<Film, String> {
        if self.film.complete_rounds() != self.rounds {
            return Err("tiles are missing from the image".into());
        }
        let light = self.light.map(Light::finish).transpose()?;
        Ok(self.film.finish(light.as_ref().map(|(image, scale)| (image, *scale))))
    }
}

/// Finishes the image as `keep` says.
///
/// # Errors
/// When tiles are missing, or the image cannot be encoded or stored.
pub(crate) fn finish(parts: Parts, metadata: &ImageMetadata, keep: KeepImage, store: &Store) -> Result<Image, String> {
    let film = parts.film()?;
    match keep {
        KeepImage::Film => Ok(Image::Film(film, Box::new(metadata.clone()))),
        KeepImage::Exr => {
            let exr = exr::encode(&film, metadata).map_err(|e| e.to_string())?;
            drop(film);
            store.put(exr.into()).map(Image::Stored).map_err(|e| e.to_string())
        }
    }
}

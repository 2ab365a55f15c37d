//! Tiles and light image → image. Runs on the compute threads.

use crate::driver::{Image, KeepImage, StatedError};
use crate::reduce::LightSum;
use crate::store::Store;
use gatherlight_render::export::ImageMetadata;
use gatherlight_render::export::exr;
use gatherlight_render::film::{Accumulator, Film};
use gatherlight_render::integrator::Bootstrap;
use gatherlight_render::job::PreparedJob;
use std::sync::Arc;

/// What an image is made of.
pub(crate) struct Parts {
    /// The job.
    pub(crate) prepared: Arc<PreparedJob>,
    /// The closed rounds.
    pub(crate) film: Accumulator,
    /// Rounds of it that there must be.
    pub(crate) rounds: u32,
    /// The sum of what was splatted, where the method splats.
    pub(crate) light: Option<Arc<LightSum>>,
    /// The bootstrap, where there is one.
    pub(crate) bootstrap: Option<Arc<Bootstrap>>,
}

impl Parts {
    /// The whole film, and what it says of its error.
    fn film(self) -> Result<(Film, StatedError), String> {
        let Parts { prepared, mut film, rounds, light, bootstrap } = self;
        // A single round is closed here.
        if film.closed_rounds() == 0 && (film.is_round_complete() || prepared.is_splatted()) {
            let sum = |light: Arc<LightSum>| {
                let empty = prepared.light_image().ok_or("the method has no light image")?;
                light.finish(empty).map_err(|e| e.to_string())
            };
            prepared.close(&mut film, light.map(sum).transpose()?.as_ref(), bootstrap.as_deref());
        }
        if film.closed_rounds() != rounds {
            return Err("tiles are missing from the image".into());
        }
        let error = StatedError::of(&film);
        Ok((film.finish(), error))
    }
}

/// Finishes the image as `keep` says.
///
/// # Errors
/// When tiles are missing, or the image cannot be encoded or stored.
pub(crate) fn finish(
    parts: Parts,
    metadata: ImageMetadata,
    keep: KeepImage,
    store: &Store,
) -> Result<(Image, StatedError), String> {
    let (film, error) = parts.film()?;
    let metadata = ImageMetadata { noise: error.noise, bias: error.bias, ..metadata };
    let image = match keep {
        KeepImage::Film => Image::Film(film, Box::new(metadata)),
        KeepImage::Exr => {
            let exr = exr::encode(&film, &metadata).map_err(|e| e.to_string())?;
            drop(film);
            Image::Stored(store.put(exr.into()).map_err(|e| e.to_string())?)
        }
    };
    Ok((image, error))
}

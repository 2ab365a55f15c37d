//! Tiles → image. Runs on the compute threads.

use crate::driver::{Image, KeepImage};
use crate::store::Store;
use gatherlight_render::export::ImageMetadata;
use gatherlight_render::export::exr;
use gatherlight_render::film::Film;

/// Finishes the image as `keep` says.
///
/// # Errors
/// When tiles are missing, or the image cannot be encoded or stored.
pub(crate) fn finish(film: Film, metadata: &ImageMetadata, keep: KeepImage, store: &Store) -> Result<Image, String> {
    if !film.is_complete() {
        return Err("tiles are missing from the image".into());
    }
    match keep {
        KeepImage::Film => Ok(Image::Film(film, Box::new(metadata.clone()))),
        KeepImage::Exr => {
            let exr = exr::encode(&film, metadata).map_err(|e| e.to_string())?;
            drop(film);
            store.put(exr.into()).map(Image::Stored).map_err(|e| e.to_string())
        }
    }
}

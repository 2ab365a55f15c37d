//! Tiles → image. Runs on the compute threads.

use crate::driver::{Image, KeepImage};
use crate::store::Store;
use crate::types::JobStats;
use gatherlight_proto::message::SceneManifest;
use gatherlight_render::export::exr;
use gatherlight_render::export::{ImageMetadata, MapMetadata};
use gatherlight_render::film::Film;
use gatherlight_render::settings::RenderSettings;

/// What the file says of how it was made. Nothing in it depends on who computed what, or when.
pub(crate) fn metadata(manifest: &SceneManifest, settings: &RenderSettings, stats: &JobStats) -> ImageMetadata {
    let map = |m: &crate::types::MapStats| MapMetadata {
        kind: m.kind,
        emitted_count: m.emitted_count,
        stored_count: m.stored_count,
        k: Some(stats.k),
        max_gather_radius: stats.gather_radius,
    };
    ImageMetadata {
        scene_digest: manifest.root.digest.to_string(),
        settings: settings.clone(),
        maps: stats.maps.iter().map(map).collect(),
        plan: Vec::new(),
        non_finite: stats.non_finite,
    }
}

/// Finishes the image as `keep` says.
///
/// # Errors
/// When tiles are missing, or the image cannot be encoded or stored.
pub(crate) fn finish(film: Film, metadata: &ImageMetadata, keep: KeepImage, store: &Store) -> Result<Image, String> {
    if !film.is_complete() {
        return Err("tiles are missing from the image".into());
    }
    match keep {
        KeepImage::Film => Ok(Image::Film(film)),
        KeepImage::Exr => {
            let exr = exr::encode(&film, metadata).map_err(|e| e.to_string())?;
            drop(film);
            store.put(exr.into()).map(Image::Stored).map_err(|e| e.to_string())
        }
    }
}

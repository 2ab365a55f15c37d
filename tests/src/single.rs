//! One job computed straight through its phases, without a cluster.

use gatherlight_render::film::Film;
use gatherlight_render::job::{Phase, PhotonMaps, PreparedJob};
use gatherlight_render::math::Rgb;
use gatherlight_render::photon::{EmissionRange, MapKind};
use gatherlight_render::scene::SceneDigest;
use gatherlight_render::scene::description::SceneDescription;
use gatherlight_render::settings::RenderSettings;
use rayon::prelude::*;
use std::sync::Arc;

/// Prepares `description` with `settings`; panics with the error's text.
pub fn prepare(description: SceneDescription, settings: &RenderSettings) -> PreparedJob {
    PreparedJob::from_description(description, SceneDigest([0; 32]), settings)
        .unwrap_or_else(|e| panic!("the scene does not build: {e}"))
}

/// Emits and builds all maps of `job`.
pub fn maps(job: &PreparedJob) -> PhotonMaps {
    let mut maps = PhotonMaps::default();
    for phase in job.phases() {
        if let Phase::Emission { map, paths } = phase {
            let batch = job.emit(map, EmissionRange { first: 0, end: paths });
            let built = Arc::new(job.build_map(map, batch));
            match map {
                MapKind::Global => maps.global = Some(built),
                MapKind::Caustic => maps.caustic = Some(built),
            }
        }
    }
    maps
}

/// Renders `job` to its film.
pub fn render(job: &PreparedJob) -> Film {
    let maps = maps(job);
    let tiles: Vec<_> = (0..job.grid().len()).into_par_iter().map(|t| job.gather(&maps, t)).collect();
    let mut film = Film::new(job.settings().width, job.settings().height, job.channels());
    for tile in &tiles {
        assert_eq!(tile.non_finite, 0, "samples that are not finite in tile {}", tile.index);
        film.insert(tile).unwrap_or_else(|e| panic!("{e}"));
    }
    film
}

/// Renders a scene made in code.
pub fn render_description(description: SceneDescription, settings: &RenderSettings) -> Film {
    render(&prepare(description, settings))
}

/// Mean colour of the film, in f64.
pub fn mean(film: &Film) -> [f64; 3] {
    let n = film.channels.len();
    let mut sum = [0.0f64; 3];
    for p in film.pixels.chunks_exact(n) {
        for (s, v) in sum.iter_mut().zip(p) {
            *s += f64::from(*v);
        }
    }
    sum.map(|s| s / (film.pixels.len() / n) as f64)
}

/// Colour of pixel (x, y).
pub fn color(film: &Film, x: u32, y: u32) -> Rgb {
    let p = film.pixel(x, y);
    Rgb::new(p[0], p[1], p[2])
}

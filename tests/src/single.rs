//! One job computed straight through its phases, without a cluster.

use gatherlight_render::film::{Accumulator, Film};
use gatherlight_render::job::{Phase, PhotonMaps, PreparedJob};
use gatherlight_render::local;
use gatherlight_render::math::Rgb;
use gatherlight_render::photon::EmissionRange;
use gatherlight_render::scene::SceneDigest;
use gatherlight_render::scene::description::SceneDescription;
use gatherlight_render::settings::RenderSettings;
use std::sync::Arc;

/// Prepares `description` with `settings`; panics with the error's text.
pub fn prepare(description: SceneDescription, settings: &RenderSettings) -> PreparedJob {
    PreparedJob::from_description(description, SceneDigest([0; 32]), settings)
        .unwrap_or_else(|e| panic!("the scene does not build: {e}"))
}

/// Emits and builds the maps of one round of `job`.
pub fn maps(job: &PreparedJob, round: u32) -> PhotonMaps {
    let mut maps = PhotonMaps::default();
    for phase in job.phases() {
        if let Phase::Emission { round: r, map, paths } = phase
            && r == round
        {
            let batch = job.emit(round, map, EmissionRange { first: 0, end: paths });
            maps.insert(Arc::new(job.build_map(map, batch)));
        }
    }
    maps
}

/// Renders `job` to its film: all its phases, in order.
pub fn render(job: &PreparedJob) -> Film {
    accumulate(job).finish()
}

/// Renders all rounds of `job`, whose sums also know their error.
///
/// # Panics
/// When a sample was not finite.
pub fn accumulate(job: &PreparedJob) -> Accumulator {
    let run = local::run(job, |_| true);
    assert_eq!(run.non_finite, 0, "samples or splats that are not finite");
    run.film
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

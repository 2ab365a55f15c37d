//! One job computed straight through its phases, without a cluster.

use gatherlight_render::film::Film;
use gatherlight_render::integrator::Bootstrap;
use gatherlight_render::job::{Inputs, Phase, PhotonMaps, PreparedJob};
use gatherlight_render::math::Rgb;
use gatherlight_render::photon::EmissionRange;
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
    let mut film = job.accumulator();
    let mut splats = None;
    let mut inputs = Inputs::default();
    let (mut rounds, mut units) = (0, 0);
    for phase in job.phases() {
        match phase {
            Phase::Emission { round, .. } => {
                if round == rounds {
                    inputs.maps = maps(job, round);
                    rounds += 1;
                }
            }
            Phase::Bootstrap { paths } => {
                let weights = job.bootstrap(EmissionRange { first: 0, end: paths });
                inputs.bootstrap = Some(Arc::new(Bootstrap::new(weights)));
            }
            Phase::Splat { units: n } => {
                let mut light = job.light_image().expect("a splat phase has a light image");
                job.splat(&inputs, EmissionRange { first: 0, end: n }, &mut light);
                assert_eq!(light.non_finite(), 0, "splats that are not finite");
                splats = Some(light);
                units = n;
            }
            Phase::Gather { round, tiles } => {
                let tile = |t| {
                    let mut own = job.light_image();
                    (job.gather(&inputs, round, t, own.as_mut()), own)
                };
                let rendered: Vec<_> = (0..tiles).into_par_iter().map(tile).collect();
                let mut light = job.light_image();
                for (tile, own) in &rendered {
                    assert_eq!(tile.non_finite, 0, "samples that are not finite in tile {}", tile.index);
                    film.insert(round, tile).unwrap_or_else(|e| panic!("{e}"));
                    if let (Some(light), Some(own)) = (light.as_mut(), own) {
                        light.add(own).unwrap_or_else(|e| panic!("{e}"));
                    }
                }
                assert_eq!(light.as_ref().map_or(0, |l| l.non_finite()), 0, "splats that are not finite");
                film.close(light.as_ref());
            }
        }
    }
    job.finish(film, splats.as_ref(), &inputs, units)
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

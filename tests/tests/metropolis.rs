//! Metropolis light transport: the same light as bidirectional path tracing, the same bits in any order of chains.

use gatherlight_render::film::LightImage;
use gatherlight_render::integrator::Bootstrap;
use gatherlight_render::job::{Inputs, Phase, PreparedJob};
use gatherlight_render::local;
use gatherlight_render::math::Rgb;
use gatherlight_render::photon::EmissionRange;
use gatherlight_render::settings::{Method, RenderSettings};
use gatherlight_tests::agree::{assert_agree, assert_same, block_means, block_means_of};
use gatherlight_tests::welch::Mean;
use gatherlight_tests::{single, transport};
use std::sync::Arc;

const SIDE: u32 = 24;

fn settings() -> RenderSettings {
    let base = RenderSettings { method: Method::Mlt, width: SIDE, height: SIDE, ..Default::default() };
    RenderSettings { chains: 256, mutations: 256, bootstrap: 65_536, ..base }
}

fn agrees_with_bdpt(room: &str, noise: f64) {
    let (name, scene) = transport::rooms().into_iter().find(|(name, _)| *name == room).expect("a room");
    let bdpt = RenderSettings { method: Method::Bdpt, samples: 32, seed: 100, ..settings() };
    assert_agree(name, &scene, [&settings(), &bdpt], 12, 0.0, noise);
}

#[test]
fn diffuse_surfaces() {
    agrees_with_bdpt("diffuse", 0.05);
}

#[test]
fn glossy_to_glossy() {
    agrees_with_bdpt("glossy", 0.08);
}

#[test]
fn mirrors_and_absorbing_glass() {
    agrees_with_bdpt("specular", 0.15);
}

#[test]
fn point_spot_and_directional_lights() {
    agrees_with_bdpt("sunny", 0.08);
}

/// A job that a limit ends has had the first of very many chains: they must start from all of the bootstrap, not from where it begins.
#[test]
fn chains_that_a_limit_cuts_off_start_everywhere() {
    let (name, scene) = transport::rooms().into_iter().find(|(name, _)| *name == "specular").expect("a room");
    let endless = settings().open_ended();
    assert!(endless.is_open_ended() && endless.chains > 1_000 * settings().chains);
    let cut_off = block_means_of(&endless, 16, |settings| {
        let job = single::prepare(scene.clone(), settings);
        local::run(&job, |film| film.samples() < u64::from(self::settings().chains)).film.finish()
    });
    let bdpt = RenderSettings { method: Method::Bdpt, samples: 32, seed: 100, ..settings() };
    let means = [cut_off, block_means(&scene, &bdpt, 16)];
    assert_same(name, ["mlt, cut off", "bdpt"], &means, 0.0, 0.15);
}

#[test]
fn paths_no_longer_than_asked() {
    let (_, scene) = transport::rooms().into_iter().find(|(name, _)| *name == "diffuse").expect("a room");
    for depth in [1, 2, 4] {
        let limited = |s: RenderSettings| RenderSettings { max_depth: Some(depth), ..s };
        let path = RenderSettings { method: Method::Path, samples: 64, seed: 100, ..settings() };
        // Light that is seen directly fills some blocks only: the noise of the others does not matter.
        let noise = if depth == 1 { f64::INFINITY } else { 0.05 };
        assert_agree("diffuse", &scene, [&limited(settings()), &limited(path)], 12, 0.0, noise);
    }
}

fn prepared() -> (PreparedJob, Inputs) {
    let job = single::prepare(transport::glossy_room(), &RenderSettings { bootstrap: 1_000, ..settings() });
    let range = |first, end| EmissionRange { first, end };
    let weights = [range(0, 1), range(1, 700), range(700, 1_000)].into_iter().flat_map(|r| job.bootstrap(r));
    let bootstrap = Some(Arc::new(Bootstrap::new(weights.collect())));
    (job, Inputs { bootstrap, ..Inputs::default() })
}

#[test]
fn bootstrap_and_chains_are_the_same_however_they_are_cut() {
    let (job, inputs) = prepared();
    let whole = job.bootstrap(EmissionRange { first: 0, end: 1_000 });
    assert_eq!(inputs.bootstrap.as_ref().expect("set").weights(), whole);
    let chains = |cuts: &[(u64, u64)]| -> LightImage {
        let mut light = job.light_image().expect("a light image");
        cuts.iter().for_each(|&(first, end)| job.splat(&inputs, 7, EmissionRange { first, end }, &mut light));
        light
    };
    let whole = chains(&[(0, 32)]);
    assert_eq!(whole, chains(&[(20, 32), (0, 1), (1, 20)]));
    let (large, total) = (whole.mutations().large as f64, whole.mutations().total() as f64);
    assert_eq!(whole.mutations().total(), u64::from(SIDE * SIDE) * 256 * 32 / 256);
    // Binomial with p = 0.3.
    assert!((large - 0.3 * total).abs() < 4.5 * (0.21 * total).sqrt(), "{large} of {total}");
    let m = whole.mutations();
    assert!(m.small_accepted > m.small / 3 && m.small_accepted < m.small, "{m:?}");
    assert!(m.large_accepted > 0 && m.large_accepted < m.large / 2, "{m:?}");
}

#[test]
fn the_phases_are_a_bootstrap_and_chains_and_darkness_stays_dark() {
    let (job, _) = prepared();
    let units: u64 = job.phases().iter().filter(|p| p.makes_image()).map(Phase::units).sum();
    assert_eq!((job.phases()[0], units), (Phase::Bootstrap { paths: 1_000 }, 256));
    let mut dark = transport::glossy_room();
    dark.lights.clear();
    dark.materials.iter_mut().for_each(|m| m.emission = Rgb::BLACK);
    let film = single::render_description(dark, &settings());
    assert!(film.pixels.chunks_exact(4).all(|p| p == [0.0, 0.0, 0.0, 1.0]));
}

/// The brightness comes from independent paths, and every large step is one: with few bootstrap paths and many mutations it is far
/// better known than by the bootstrap alone, whose error would never fall.
#[test]
fn the_brightness_gets_better_with_the_mutations() {
    let scene = transport::diffuse_room();
    let means = |mutations: u32| {
        Mean::of((0..24).map(|seed| {
            let s = RenderSettings { seed, mutations, bootstrap: 500, chains: 64, ..settings() };
            single::mean(&single::render_description(scene.clone(), &s)).iter().sum::<f64>()
        }))
    };
    let (few, many) = (means(1), means(256));
    println!(
        "{:.4} ± {:.4} with few mutations, {:.4} ± {:.4} with many",
        few.value,
        few.sigma(),
        many.value,
        many.sigma()
    );
    // 500 + 173 paths against 500 + 44,237 of them.
    assert!(many.sigma() < 0.3 * few.sigma(), "{} is not much less than {}", many.sigma(), few.sigma());
}

//! The error that a render states is its real one: many seeds, small images. The large table, heavy tails included, is in
//! `docs/error.md` (`tests/benches/calibration.rs`).

use gatherlight_render::settings::{Method, RenderSettings};
use gatherlight_tests::calibration::{Calibration, calibrate};
use gatherlight_tests::references::reduced;
use gatherlight_tests::scene;

const SIDE: u32 = 32;
const SEEDS: u64 = 24;

fn calibrated(name: &str, settings: &RenderSettings) -> Calibration {
    let (_, height, truth) = reduced(name, SIDE);
    let settings = RenderSettings { width: SIDE, height, ..settings.clone() };
    let c = calibrate(&scene(&format!("{name}.glb")), &settings, SEEDS, Some(&truth));
    println!("{name}, {}: {c:?}", settings.method.name());
    c
}

/// Intervals of 95 % hold the mean of the other seeds in 93 to 97 % of all pixels, channels and seeds: where tails are light, and where
/// most pixels have had no focused light yet that others have.
#[test]
fn intervals_of_unbiased_methods_hold_what_they_say() {
    for (name, method, samples) in [
        ("cornell-diffuse", Method::Bdpt, 16),
        ("cornell-diffuse", Method::Path, 32),
        ("caustic-ring", Method::Bdpt, 16),
        ("cornell-caustic", Method::Bdpt, 16),
    ] {
        let c = calibrated(name, &RenderSettings { method, samples, ..RenderSettings::default() });
        assert!((0.93..=0.97).contains(&c.coverage), "{name}: {c:?}");
        if name == "cornell-diffuse" {
            assert!((0.8..=1.5).contains(&c.noise), "{name}: {c:?}");
            assert!(c.total.is_some_and(|t| (0.8..=1.5).contains(&t)), "{name}: {c:?}");
        }
    }
}

/// The brightness of all pixels of mlt is in its noise, too, which is told by groups of chains.
#[test]
fn chains_state_their_noise() {
    let mlt = RenderSettings {
        method: Method::Mlt,
        mutations: 32,
        chains: 256,
        bootstrap: 5_000,
        ..RenderSettings::default()
    };
    let c = calibrated("cornell-diffuse", &mlt);
    assert!((0.7..=1.5).contains(&c.noise), "{c:?}");
    // Of a block's chains few have visited a pixel: by itself it covers 75 %.
    assert!((0.9..=0.98).contains(&c.coverage), "{c:?}");
}

/// What density estimation states, noise and blur together, is its real error against the image of another renderer.
#[test]
fn blurred_rounds_state_their_total_error() {
    let progressive = RenderSettings {
        method: Method::Progressive,
        rounds: 32,
        photons: 80_000,
        caustic_photons: 160_000,
        ..RenderSettings::default()
    };
    for name in ["cornell-diffuse", "caustic-ring"] {
        let c = calibrated(name, &progressive);
        assert!(c.total.is_some_and(|t| (0.7..=1.5).contains(&t)), "{name}: {c:?}");
    }
}

/// One set of maps for all passes: what their differences do not show, the maps' own noise and blur, is in the statement, and a few pixels that
/// the edge or a glint of the lamp cuts do not make it.
#[test]
fn passes_that_share_maps_state_their_total_error() {
    let photon = RenderSettings {
        method: Method::Photon,
        samples: 8,
        photons: 25_000,
        caustic_photons: 50_000,
        final_gather: 2,
        k: 50,
        ..RenderSettings::default()
    };
    for name in ["cornell-caustic", "glossy-plates"] {
        let c = calibrated(name, &photon);
        assert!(c.total.is_some_and(|t| (0.7..=1.5).contains(&t)), "{name}: {c:?}");
    }
}

/// Rounds of a radius that is far too large are all blur and hardly any noise: the bias is what is stated.
#[test]
fn a_large_radius_is_seen_as_bias() {
    let blurred = RenderSettings {
        method: Method::Progressive,
        rounds: 64,
        photons: 640_000,
        caustic_photons: 640_000,
        max_radius: Some(0.3),
        ..RenderSettings::default()
    };
    let c = calibrated("caustic-ring", &blurred);
    assert!(c.stated_bias > c.stated_noise, "{c:?}");
    assert!(c.total.is_some_and(|t| (0.5..=1.5).contains(&t)), "{c:?}");
}

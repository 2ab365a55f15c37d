//! All light looked at in one photon map (`--direct-from-map`), by every kernel and search structure.

use gatherlight_render::math::Rgb;
use gatherlight_render::scene::description::{LightKind, MaterialDescription, SceneDescription};
use gatherlight_render::settings::{Estimator, Kernel, Layer, Method, RenderSettings};
use gatherlight_tests::fixtures::{SceneMaker, lamp_in_glass, quad};
use gatherlight_tests::single::{mean, prepare, render_description};
use glam::{DVec3, Vec3};
use std::f64::consts::PI;

fn settings(side: u32, samples: u32) -> RenderSettings {
    RenderSettings {
        width: side,
        height: side,
        samples,
        direct_from_map: true,
        final_gather: 0,
        caustic_photons: 0,
        ..Default::default()
    }
}

/// Mean of green over `seeds` images and its standard error.
fn over_seeds(scene: &SceneDescription, settings: &RenderSettings, seeds: u64) -> (f64, f64) {
    let values: Vec<f64> = (0..seeds)
        .map(|seed| mean(&render_description(scene.clone(), &RenderSettings { seed, ..settings.clone() }))[1])
        .collect();
    let n = seeds as f64;
    let m = values.iter().sum::<f64>() / n;
    (m, (values.iter().map(|v| (v - m).powi(2)).sum::<f64>() / (n - 1.0) / n).sqrt())
}

/// A floor of reflectance 1/2 under a light, seen at one point.
fn floor_under(light: impl Fn(&mut SceneMaker)) -> SceneDescription {
    let mut s = SceneMaker::new();
    let floor = s.material(MaterialDescription::lambert("floor", Rgb::splat(0.5)));
    s.mesh(quad(Vec3::new(-2.0, 0.0, 2.0), Vec3::new(4.0, 0.0, 0.0), Vec3::new(0.0, 0.0, -4.0), floor));
    light(&mut s);
    s.camera(DVec3::new(0.7, 0.5, 0.0), DVec3::ZERO, 0.002);
    s.scene
}

/// Under parallel light the floor's irradiance is the same everywhere, so that every kernel, over k photons or over a fixed
/// radius, has exactly the right mean (García et al. 2012). 96 seeds, six cases: |t| < 4.5 for all with probability above 0.9999.
#[test]
fn every_kernel_has_the_right_mean_under_parallel_light() {
    let scene = floor_under(|s| {
        let direction = DVec3::new(40f64.to_radians().sin(), -(40f64.to_radians().cos()), 0.0);
        s.light(LightKind::Directional, Rgb::splat(2.0), DVec3::Y, direction);
    });
    let expected = 0.5 / PI * 2.0 * 40f64.to_radians().cos();
    for kernel in Kernel::ALL {
        for estimator in Estimator::ALL {
            let s =
                RenderSettings { photons: 5_000, k: 40, max_radius: Some(0.4), kernel, estimator, ..settings(1, 1) };
            let (m, error) = over_seeds(&scene, &s, 96);
            let name = format!("{}, {}", kernel.name(), estimator.name());
            println!("{name}: {:+.2} σ, σ = {:.2} %", (m - expected) / error, 100.0 * error / expected);
            assert!((m - expected).abs() < 4.5 * error, "{name}: {m} ± {error} instead of {expected}");
            assert!(error < 0.03 * expected, "{name}: too noisy to see anything ({error} of {expected})");
        }
    }
}

/// Under a point light at height h, E = I/h². Over a disc of radius r the mean of I h/(h² + d²)^(3/2) is lower by (9/8)·… at
/// most 3 r²/4h² < 0.5 % with r = 0.12 at h = 1.5.
#[test]
fn irradiance_under_a_point_light() {
    let scene = floor_under(|s| {
        s.light(LightKind::Point, Rgb::splat(3.0), DVec3::new(0.0, 1.5, 0.0), DVec3::NEG_Y);
    });
    let s = RenderSettings { photons: 40_000, k: 200, max_radius: Some(0.12), ..settings(1, 1) };
    let (m, error) = over_seeds(&scene, &s, 48);
    let expected = 0.5 / PI * 3.0 / 2.25;
    assert!((m - expected).abs() < 4.5 * error + 0.005 * expected, "{m} ± {error} instead of {expected}");
    assert!(error < 0.02 * expected, "too noisy to see anything: {error}");
}

/// A room lit through glass only: direct light, caustics and indirect light, all from one map, are all the light there is.
/// Within a radius of the room's edges some is lost, as by every estimate over a disc.
#[test]
fn one_map_holds_all_light() {
    let base = settings(24, 4);
    let map = RenderSettings { photons: 200_000, k: 40, ..base.clone() };
    let path = RenderSettings { method: Method::Path, direct_from_map: false, samples: 128, ..base };
    let ((a, ea), (b, eb)) = (over_seeds(&lamp_in_glass(), &map, 8), over_seeds(&lamp_in_glass(), &path, 8));
    println!("map {a} ± {ea}, path {b} ± {eb}");
    assert!((a - b).abs() < 4.5 * ea.hypot(eb) + 0.02 * b, "map {a} ± {ea}, path {b} ± {eb}");
    // There is no other part that could hide a missing one.
    assert!(ea.hypot(eb) < 0.01 * b);
}

#[test]
fn the_plan_has_one_map_and_no_final_gather() {
    let job = prepare(lamp_in_glass(), &RenderSettings { caustic_photons: 1000, ..settings(4, 1) });
    assert!(job.plan().global.is_some() && job.plan().caustic.is_none());
    let reason = |what: &str| job.plan().entries.iter().find(|e| e.what == what).map(|e| e.reason.clone());
    for what in ["caustic photon map", "final gather"] {
        assert!(reason(what).is_some_and(|r| r.contains("--direct-from-map")), "{what}: {:?}", reason(what));
    }
    let refused = |s: RenderSettings| s.validate().unwrap_err().to_string();
    assert!(refused(RenderSettings { final_gather: 1, ..settings(4, 1) }).starts_with("--final-gather"));
    assert!(refused(RenderSettings { layers: vec![Layer::Direct], ..settings(4, 1) }).starts_with("--layers"));
    assert!(refused(RenderSettings { method: Method::Path, ..settings(4, 1) }).starts_with("--direct-from-map"));
}

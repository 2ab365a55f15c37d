//! Recursive ray tracing computes the direct part of light, and nothing else: closed forms, and the layer of that name by path
//! tracing.

use gatherlight_render::film::Film;
use gatherlight_render::math::Rgb;
use gatherlight_render::scene::description::{LightKind, MaterialDescription, SceneDescription};
use gatherlight_render::settings::{Layer, Method, RenderSettings};
use gatherlight_tests::fixtures::{SceneMaker, cuboid, enclosure, quad, sphere};
use gatherlight_tests::single::{mean, render_description};
use glam::{DVec3, Vec3};
use std::f64::consts::PI;

const SIDE: u32 = 24;
const BLOCK: u32 = 8;
const SEEDS: u64 = 12;

fn settings(side: u32, samples: u32) -> RenderSettings {
    RenderSettings { method: Method::Whitted, width: side, height: side, samples, ..Default::default() }
}

/// Mean of green over `seeds` images and its standard error.
fn mean_over_seeds(scene: &SceneDescription, settings: &RenderSettings, seeds: u64) -> (f64, f64) {
    let means: Vec<f64> = (0..seeds)
        .map(|seed| mean(&render_description(scene.clone(), &RenderSettings { seed, ..settings.clone() }))[1])
        .collect();
    mean_and_error(&means)
}

fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let m = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - m).powi(2)).sum::<f64>() / (n - 1.0);
    (m, (variance / n).sqrt())
}

/// Of the light in a closed box that emits Le and reflects ρ, what is emitted and reflected once: Le (1 + ρ). Its twelve
/// triangles are more than are sampled one by one. |t| < 5 for 23 degrees of freedom fails once in 20,000 times.
#[test]
fn an_enclosure_shows_its_first_two_terms() {
    let (m, error) = mean_over_seeds(&enclosure(0.5, 0.25), &settings(8, 32), 24);
    let expected = 0.25 * 1.5;
    assert!((m - expected).abs() < 5.0 * error, "{m} ± {error} instead of {expected}");
    assert!(error < 0.002 * expected, "too noisy to see anything: {error}");
}

/// In a box of perfect mirrors around a black lamp every ray ends at the lamp: radiance Le, however often it was reflected.
#[test]
fn a_mirror_box_is_as_bright_as_its_lamp() {
    let mut s = SceneMaker::new();
    let mirror = s.material(MaterialDescription::metal("mirror", Rgb::WHITE, 0.0));
    let lamp = s.material(MaterialDescription::emitter("lamp", Rgb::splat(3.0)));
    s.mesh(cuboid(Vec3::splat(-1.0), Vec3::splat(1.0), true, mirror));
    s.mesh(sphere(Vec3::new(0.3, 0.1, -0.2), 0.5, 2, false, false, lamp));
    s.camera(DVec3::new(-0.7, -0.6, 0.8), DVec3::new(0.7, -0.4, -1.0), 1.0);
    let (m, error) = mean_over_seeds(&s.scene, &settings(8, 8), 12);
    // A handful of rays meet roulette beyond 32 mirrors; 1e-5 is the rounding of products of reflectances.
    assert!((m - 3.0).abs() < 5.0 * error + 3e-5, "{m} ± {error}");
    assert!(error < 0.02, "{error}");
    let direct = RenderSettings { max_depth: Some(1), ..settings(8, 8) };
    let share = mean_over_seeds(&s.scene, &direct, 4).0 / 3.0;
    assert!(share > 0.01 && share < 0.5, "without mirrors only the lamp itself is seen: {share}");
}

/// More lights than are asked one by one: their irradiances add up. The nearer half is 3 times as bright.
#[test]
fn the_light_of_many_lamps_adds_up() {
    let mut s = SceneMaker::new();
    let floor = s.material(MaterialDescription::lambert("floor", Rgb::splat(0.5)));
    s.mesh(quad(Vec3::new(-2.0, 0.0, 2.0), Vec3::new(4.0, 0.0, 0.0), Vec3::new(0.0, 0.0, -4.0), floor));
    for i in 0..100 {
        let (intensity, height) = if i % 2 == 0 { (0.03, 1.5) } else { (0.01, 1.0) };
        s.light(LightKind::Point, Rgb::splat(intensity), DVec3::new(0.0, height, 0.0), DVec3::NEG_Y);
    }
    s.camera(DVec3::new(0.7, 0.5, 0.0), DVec3::ZERO, 0.002);
    let (m, error) = mean_over_seeds(&s.scene, &settings(1, 1024), 24);
    let expected = 0.5 / PI * (50.0 * 0.03 / 2.25 + 50.0 * 0.01);
    assert!((m - expected).abs() < 5.0 * error + 3e-4 * expected, "{m} ± {error} instead of {expected}");
    assert!(error < 0.003 * expected, "too noisy to see anything: {error}");
}

/// Every kind of lobe under a lamp of two triangles, one of 320, and a point: rough gold, a coated floor, a smooth mirror,
/// glass that is smooth or rough.
fn gallery(many: bool) -> SceneDescription {
    let mut s = SceneMaker::new();
    let wall = s.material(MaterialDescription::lambert("wall", Rgb::new(0.6, 0.5, 0.4)));
    let coated = s.material(MaterialDescription {
        base_color: Rgb::new(0.3, 0.5, 0.6),
        metallic: 0.0,
        roughness: 0.3,
        ..Default::default()
    });
    let gold = s.material(MaterialDescription::metal("gold", Rgb::new(1.0, 0.77, 0.34), 0.4));
    let mirror = s.material(MaterialDescription::metal("mirror", Rgb::splat(0.9), 0.0));
    let glass = s.material(MaterialDescription::glass("glass", 1.5));
    let frosted = s.material(MaterialDescription { roughness: 0.5, ..MaterialDescription::glass("frosted", 1.4) });
    let lamp = s.material(MaterialDescription::emitter("lamp", Rgb::splat(5.0)));
    s.mesh(cuboid(Vec3::splat(-1.0), Vec3::splat(1.0), true, wall));
    s.mesh(quad(Vec3::new(-0.99, -0.98, 0.99), Vec3::X * 1.98, Vec3::Z * -1.98, coated));
    s.mesh(quad(Vec3::new(-0.5, 0.98, -0.5), Vec3::X, Vec3::Z, lamp));
    if many {
        s.mesh(sphere(Vec3::new(0.7, 0.5, -0.7), 0.15, 2, false, false, lamp));
    }
    s.mesh(sphere(Vec3::new(-0.5, -0.6, -0.2), 0.35, 3, true, false, gold));
    s.mesh(cuboid(Vec3::new(0.3, -0.9, -0.6), Vec3::new(0.7, 0.1, -0.5), false, mirror));
    s.mesh(cuboid(Vec3::new(-0.1, -0.9, 0.0), Vec3::new(0.2, -0.5, 0.3), false, glass));
    s.mesh(cuboid(Vec3::new(0.4, -0.9, 0.0), Vec3::new(0.7, -0.5, 0.3), false, frosted));
    s.light(LightKind::Point, Rgb::splat(0.3), DVec3::new(-0.6, 0.3, 0.2), DVec3::NEG_Y);
    s.camera(DVec3::new(0.0, 0.0, 0.95), DVec3::new(0.0, -0.3, 0.0), 1.3);
    s.scene
}

/// Means of three channels over blocks of the layer that starts at channel `at`.
fn blocks(film: &Film, at: usize) -> Vec<f64> {
    let per_side = SIDE / BLOCK;
    let mut sums = vec![0.0; (per_side * per_side) as usize];
    for y in 0..SIDE {
        for x in 0..SIDE {
            let p = &film.pixel(x, y)[at..at + 3];
            sums[(y / BLOCK * per_side + x / BLOCK) as usize] += p.iter().map(|&v| f64::from(v)).sum::<f64>();
        }
    }
    sums.iter().map(|s| s / f64::from(3 * BLOCK * BLOCK)).collect()
}

/// The first channels of the image of `settings` from channel `at` on are the layer `direct` of path tracing. With 9 blocks and
/// 11 degrees of freedom a side, |t| < 4.6 holds for all blocks with probability above 0.999 when the means are equal (Šidák).
fn assert_direct(name: &str, scene: &SceneDescription, settings_of: &RenderSettings, at: usize, noise: f64) {
    let rows = |settings: &RenderSettings, at: usize| -> Vec<Vec<f64>> {
        let settings = RenderSettings { layers: vec![Layer::Direct], ..settings.clone() };
        (0..SEEDS)
            .map(|seed| render_description(scene.clone(), &RenderSettings { seed, ..settings.clone() }))
            .map(|film| blocks(&film, at))
            .collect()
    };
    let path = RenderSettings { method: Method::Path, ..settings(SIDE, 96) };
    let (own, path) = (rows(settings_of, at), rows(&path, 4));
    for i in 0..own[0].len() {
        let column = |rows: &[Vec<f64>]| mean_and_error(&rows.iter().map(|r| r[i]).collect::<Vec<_>>());
        let ((a, ea), (b, eb)) = (column(&own), column(&path));
        let sigma = ea.hypot(eb);
        println!("{name}, block {i}: {a:.5} ± {ea:.5}, path {b:.5} ± {eb:.5}, {:+.2} σ", (a - b) / sigma);
        assert!((a - b).abs() < 4.6 * sigma, "{name}, block {i}: {a} and path {b}, σ = {sigma}");
        assert!(sigma < noise * b, "{name}, block {i}: too noisy to see anything ({sigma} of {b})");
    }
}

#[test]
fn the_image_is_the_direct_layer_of_path_tracing() {
    for many in [false, true] {
        assert_direct(&format!("many {many}"), &gallery(many), &settings(SIDE, 12), 0, 0.03);
    }
}

/// Light that a rough boundary scatters straight to the eye from a lamp on its other side has crossed the body.
#[test]
fn absorption_in_rough_glass_counts_on_the_way_to_a_light() {
    // A lamp inside a body: the only light that reaches a boundary from within without meeting another.
    let mut s = SceneMaker::new();
    let lamp = s.material(MaterialDescription::emitter("lamp", Rgb::splat(5.0)));
    let body = s.material(MaterialDescription {
        roughness: 0.7,
        attenuation_color: Rgb::new(0.2, 0.4, 0.8),
        attenuation_distance: 0.5,
        ..MaterialDescription::glass("body", 1.3)
    });
    s.mesh(cuboid(Vec3::splat(-1.0), Vec3::splat(1.0), false, body));
    s.mesh(cuboid(Vec3::splat(-0.3), Vec3::splat(0.3), false, lamp));
    s.camera(DVec3::new(0.0, 0.0, 5.0), DVec3::ZERO, 0.35);
    let scene = s.scene;
    assert_direct("whitted", &scene, &settings(SIDE, 48), 0, 0.06);
    let photon = RenderSettings { method: Method::Photon, photons: 0, caustic_photons: 0, ..settings(SIDE, 48) };
    assert_direct("photon", &scene, &photon, 4, 0.06);
}

/// It says itself that it leaves light out, and has no layers for it.
#[test]
fn what_is_left_out_is_said() {
    assert!(!Method::Whitted.is_consistent() && Method::Path.is_consistent());
    let job = gatherlight_tests::single::prepare(gallery(false), &settings(4, 1));
    for what in ["indirect light", "caustics"] {
        assert!(job.plan().entries.iter().any(|e| e.what == what && !e.kept && e.reason.contains("whitted")), "{what}");
    }
    let error = RenderSettings { layers: vec![Layer::Caustic], ..settings(4, 1) }.validate().unwrap_err();
    assert!(error.to_string().contains("has no caustic"), "{error}");
}

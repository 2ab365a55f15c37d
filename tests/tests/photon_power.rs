//! Power is conserved: what is stored is what was emitted, reflected as often as the albedo says.

use gatherlight_render::math::Rgb;
use gatherlight_render::photon::MapKind;
use gatherlight_render::photon::aim::AimedEmission;
use gatherlight_render::photon::trace::{Emission, Storage};
use gatherlight_render::scene::description::{LightKind, MaterialDescription, SceneDescription};
use gatherlight_render::scene::{Scene, builder};
use gatherlight_tests::fixtures::{SceneMaker, cuboid, quad, sphere};
use glam::{DVec3, Vec3};
use std::f64::consts::PI;

fn build(d: SceneDescription) -> Scene {
    builder::build(d).unwrap_or_else(|e| panic!("{e}"))
}

/// Mean stored green power per emitted path in world units, with its standard error.
fn stored_power(scene: &Scene, emission: &Emission<'_>, paths: u64) -> (f64, f64) {
    let (mut sum, mut squares) = (0.0, 0.0);
    for i in 0..paths {
        let mut path = 0.0;
        emission.trace_path(i, &mut |p| path += f64::from(p.power.g));
        sum += path;
        squares += path * path;
    }
    let n = paths as f64;
    let (mean, per_world) = (sum / n, 1.0 / (scene.space.scale * scene.space.scale));
    (mean * per_world, ((squares / n - mean * mean) / n).sqrt() * per_world)
}

fn room(albedo: f32, light: impl Fn(&mut SceneMaker)) -> Scene {
    let mut s = SceneMaker::new();
    let wall = s.material(MaterialDescription::lambert("wall", Rgb::splat(albedo)));
    s.mesh(cuboid(Vec3::splat(-3.0), Vec3::splat(3.0), true, wall));
    light(&mut s);
    build(s.scene)
}

fn check(name: &str, power: f64, light: impl Fn(&mut SceneMaker)) {
    // A black wall has no lobe that reads photons, so it stores none.
    for albedo in [0.01f32, 0.5, 0.9] {
        let scene = room(albedo, &light);
        let e = Emission { scene: &scene, kind: MapKind::Global, storage: Storage::All, seed: 1, round: 0, aim: None };
        let (got, error) = stored_power(&scene, &e, 40_000);
        let expected = power / (1.0 - f64::from(albedo));
        // 3e-4: what a small black lamp absorbs.
        assert!(
            (got - expected).abs() < 4.0 * error + 3e-4 * expected,
            "{name}, albedo {albedo}: {got} ± {error} instead of {expected}"
        );
        assert!(error < 0.02 * expected, "{name}: too noisy to see anything");
    }
}

/// In a closed diffuse room every photon is stored at each hit: total stored = Φ / (1 − albedo).
#[test]
fn stored_power_is_emitted_power_over_absorptance() {
    check("point", 4.0 * PI * 2.0, |s| {
        s.light(LightKind::Point, Rgb::splat(2.0), DVec3::new(0.3, 0.2, 0.1), DVec3::NEG_Y);
    });
    // The lamp itself is black: so small that it absorbs below 3e-4 of the light.
    check("square", PI * 1280.0 * 0.0025, |s| {
        let lamp = s.material(MaterialDescription::emitter("lamp", Rgb::splat(1280.0)));
        s.mesh(quad(Vec3::new(-0.025, 2.9, -0.025), Vec3::X * 0.05, Vec3::Z * 0.05, lamp));
    });
    // A spot whose cones coincide but for a hair: the cone's solid angle times the intensity.
    check("spot", 2.0 * PI * (1.0 - 0.4f64.cos()) * 3.0, |s| {
        let kind = LightKind::Spot { inner: 0.399_999_9, outer: 0.4 };
        s.light(kind, Rgb::splat(3.0), DVec3::new(0.0, 2.0, 0.0), DVec3::NEG_Y);
    });
}

/// Adds lights to a scene.
type AddLights = fn(&mut SceneMaker);

/// Emission aimed at specular geometry finds the same focused power as blind emission, with far less noise.
#[test]
fn aimed_emission_is_unbiased() {
    let lights: [(&str, AddLights); 4] = [
        ("area", |s| {
            let lamp = s.material(MaterialDescription::emitter("lamp", Rgb::splat(5.0)));
            s.mesh(quad(Vec3::new(-0.9, 2.9, -0.4), Vec3::X * 0.8, Vec3::Z * 0.8, lamp));
        }),
        ("point", |s| {
            s.light(LightKind::Point, Rgb::splat(2.0), DVec3::new(1.3, 1.2, -0.5), DVec3::NEG_Y);
        }),
        ("spot", |s| {
            let kind = LightKind::Spot { inner: 0.1, outer: 0.7 };
            s.light(kind, Rgb::splat(2.0), DVec3::new(0.0, 2.0, 0.0), DVec3::new(0.4, -2.0, 0.2));
        }),
        ("two", |s| {
            s.light(LightKind::Point, Rgb::splat(2.0), DVec3::new(1.3, 1.2, -0.5), DVec3::NEG_Y);
            s.light(LightKind::Point, Rgb::splat(0.2), DVec3::new(-2.3, -1.2, -0.5), DVec3::NEG_Y);
        }),
    ];
    for (name, light) in lights {
        let mut s = SceneMaker::new();
        let wall = s.material(MaterialDescription::lambert("wall", Rgb::splat(0.5)));
        let mirror = s.material(MaterialDescription::metal("mirror", Rgb::splat(0.9), 0.0));
        let glass = s.material(MaterialDescription::glass("glass", 1.5));
        let gold = s.material(MaterialDescription::metal("gold", Rgb::splat(0.8), 0.3));
        s.mesh(cuboid(Vec3::splat(-3.0), Vec3::splat(3.0), true, wall));
        s.mesh(sphere(Vec3::new(0.5, -0.5, 0.2), 0.5, 3, true, false, glass));
        s.mesh(cuboid(Vec3::new(-1.5, -1.0, -0.5), Vec3::new(-0.5, -0.2, 0.5), false, mirror));
        s.mesh(sphere(Vec3::new(0.6, 0.5, -0.2), 0.3, 3, true, false, gold));
        light(&mut s);
        let scene = build(s.scene);
        let aim = AimedEmission::new(&scene).unwrap_or_else(|| panic!("{name}: nothing to aim at"));
        let emission = |aim, seed| Emission {
            scene: &scene,
            kind: MapKind::Caustic,
            storage: Storage::Caustic,
            seed,
            round: 0,
            aim,
        };
        let (aimed, e1) = stored_power(&scene, &emission(Some(&aim), 3), 100_000);
        let (blind, e2) = stored_power(&scene, &emission(None, 4), 400_000);
        let sigma = (e1 * e1 + e2 * e2).sqrt();
        assert!((aimed - blind).abs() < 4.0 * sigma, "{name}: {aimed} ± {e1}, blind {blind} ± {e2}");
        // Four times the paths halve the error of blind emission.
        assert!(e1 < 2.0 * e2, "{name}: aiming does not help ({e1} against {e2})");
    }
}

#[test]
fn directional_light_is_aimed_too() {
    let mut s = SceneMaker::new();
    let floor = s.material(MaterialDescription::lambert("floor", Rgb::splat(0.5)));
    let glass = s.material(MaterialDescription::glass("glass", 1.5));
    s.mesh(quad(Vec3::new(-5.0, 0.0, 5.0), Vec3::X * 10.0, Vec3::Z * -10.0, floor));
    s.mesh(sphere(Vec3::new(0.5, 0.8, 0.2), 0.5, 3, true, false, glass));
    s.light(LightKind::Directional, Rgb::splat(2.0), DVec3::Y, DVec3::new(0.3, -1.0, 0.2));
    let scene = build(s.scene);
    let aim = AimedEmission::new(&scene).unwrap();
    let emission =
        |aim, seed| Emission { scene: &scene, kind: MapKind::Caustic, storage: Storage::Caustic, seed, round: 0, aim };
    let (aimed, e1) = stored_power(&scene, &emission(Some(&aim), 3), 50_000);
    let (blind, e2) = stored_power(&scene, &emission(None, 4), 800_000);
    assert!((aimed - blind).abs() < 4.0 * (e1 * e1 + e2 * e2).sqrt(), "{aimed} ± {e1}, blind {blind} ± {e2}");
    // A sphere intercepts E π r²; nearly all of it is focused onto the floor, the rest is reflected into the sky.
    assert!(aimed > 0.8 * 2.0 * PI * 0.25 && aimed < 2.0 * PI * 0.25 * 1.01, "{aimed}");
}

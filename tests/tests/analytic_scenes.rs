//! Scenes whose radiance is known in closed form, for every method that applies.

use gatherlight_render::math::Rgb;
use gatherlight_render::scene::description::{LightKind, MaterialDescription, SceneDescription};
use gatherlight_render::settings::{Layer, Method, RenderSettings};
use gatherlight_tests::fixtures::{SceneMaker, cuboid, enclosure, quad, sphere};
use gatherlight_tests::single::{color, mean, render_description};
use gatherlight_tests::welch::Mean;
use glam::{DVec3, Vec3};
use std::f64::consts::PI;

/// Of methods with rounds, as many rounds as samples, each with a light path, and a radius too small to blur anything. Of Metropolis
/// light transport, whose brightness is the bootstrap's, as many bootstrap paths as cost about the same.
fn settings(method: Method, side: u32, samples: u32) -> RenderSettings {
    let base = RenderSettings { method, width: side, height: side, samples, ..Default::default() };
    if method == Method::Mlt {
        return RenderSettings { mutations: 1, chains: 8, bootstrap: 16 * u64::from(samples), ..base };
    }
    if !method.has_rounds() {
        return base;
    }
    let photons = u64::from(samples);
    RenderSettings { rounds: samples, photons, caustic_photons: photons, max_radius: Some(0.01), ..base }
}

/// Whether the standard error is told by independent seeds: of methods that have rounds, splats or chains.
fn needs_seeds(method: Method) -> bool {
    method.has_rounds() || !method.layers().contains(&Layer::Variance)
}

fn assert_close(what: &str, got: f64, expected: f64, tolerance: f64) {
    let error = got / expected - 1.0;
    assert!(error.abs() <= tolerance, "{what}: {got} instead of {expected} ({:+.3} %)", error * 100.0);
}

/// Mean over all pixels and its standard error from the spread of the pixels, for images that should be uniform.
fn uniform_statistics(description: SceneDescription, settings: &RenderSettings) -> (f64, f64) {
    let film = render_description(description, settings);
    let n = f64::from(settings.width * settings.height);
    let m = mean(&film)[1];
    let variance: f64 = (0..settings.height)
        .flat_map(|y| (0..settings.width).map(move |x| (x, y)))
        .map(|(x, y)| (f64::from(color(&film, x, y).g) - m).powi(2))
        .sum::<f64>()
        / (n - 1.0);
    (m, (variance / n).sqrt())
}

/// Radiance inside a closed box that emits Le and reflects ρ everywhere is Le / (1 − ρ).
#[test]
fn enclosure_by_unbiased_methods() {
    for (method, samples) in [(Method::Path, 64), (Method::Bdpt, 32)] {
        for albedo in [0.5f32, 0.9] {
            let (m, error) = uniform_statistics(enclosure(albedo, 0.25), &settings(method, 24, samples));
            let expected = 0.25 / (1.0 - f64::from(albedo));
            let name = method.name();
            assert!((m - expected).abs() < 4.0 * error, "{name}, {albedo}: {m} ± {error} instead of {expected}");
            assert!(error / expected < 0.005, "the test is too noisy to see anything: {error}");
        }
    }
}

/// A chain lands all over the image: the mean of the image is that of the bootstrap.
#[test]
fn enclosure_by_metropolis_light_transport() {
    for albedo in [0.5f32, 0.9] {
        let scene = enclosure(albedo, 0.25);
        let film =
            |seed| render_description(scene.clone(), &RenderSettings { seed, ..settings(Method::Mlt, 24, 4096) });
        let m = Mean::of((0..16).map(|seed| mean(&film(seed))[1]));
        let expected = 0.25 / (1.0 - f64::from(albedo));
        assert!((m.value - expected).abs() < 5.0 * m.sigma(), "{albedo}: {} ± {}, not {expected}", m.value, m.sigma());
        assert!(m.sigma() / expected < 0.01, "the test is too noisy to see anything: {}", m.sigma());
    }
}

/// Photon mapping loses light within a gather radius of the box's edges (a quarter of the disc hangs over), so the mean
/// may lie below by the share of area within half a radius of an edge, and not above.
#[test]
fn enclosure_by_photon_mapping() {
    for albedo in [0.5f32, 0.9] {
        let s = RenderSettings { photons: 400_000, ..settings(Method::Photon, 24, 32) };
        let (m, error) = uniform_statistics(enclosure(albedo, 0.25), &s);
        let expected = 0.25 / (1.0 - f64::from(albedo));
        assert_close(&format!("albedo {albedo} ± {error}"), m, expected, 0.01);
    }
}

/// A lamp over a Lambertian plane seen by one pixel, radiance = ρ/π · E; with its standard error.
fn radiance_under(light: impl Fn(&mut SceneMaker), method: Method) -> (f64, f64) {
    let mut s = SceneMaker::new();
    let floor = s.material(MaterialDescription::lambert("floor", Rgb::splat(0.5)));
    s.mesh(quad(Vec3::new(-2.0, 0.0, 2.0), Vec3::new(4.0, 0.0, 0.0), Vec3::new(0.0, 0.0, -4.0), floor));
    light(&mut s);
    // A narrow view of the origin from the side, under the lamp.
    s.camera(DVec3::new(0.7, 0.5, 0.0), DVec3::ZERO, 0.002);
    if needs_seeds(method) {
        let samples = if method.has_rounds() { 512 } else { 4096 };
        let green = from_seeds(&s.scene, &settings(method, 1, samples))[1];
        return (green.value, green.sigma());
    }
    let layers = vec![Layer::Variance];
    let film = render_description(s.scene, &RenderSettings { photons: 20_000, layers, ..settings(method, 1, 65_536) });
    let pixel = film.pixel(0, 0);
    (f64::from(pixel[1]), (f64::from(pixel[5]) / 65_536.0).sqrt())
}

/// The channels of the first pixel, over 24 seeds.
fn from_seeds(scene: &SceneDescription, settings: &RenderSettings) -> [Mean; 3] {
    let pixel = |seed| {
        let film = render_description(scene.clone(), &RenderSettings { seed, ..settings.clone() });
        [0, 1, 2].map(|c| f64::from(film.pixel(0, 0)[c]))
    };
    let pixels: Vec<[f64; 3]> = (0..24).map(pixel).collect();
    [0, 1, 2].map(|c| Mean::of(pixels.iter().map(|p| p[c])))
}

/// Four standard errors, and 3e-4 for the pixel's width and a sphere's tessellation.
fn check_light(name: &str, irradiance: f64, light: impl Fn(&mut SceneMaker)) {
    for method in Method::ALL {
        let (got, error) = radiance_under(&light, method);
        let expected = 0.5 / PI * irradiance;
        assert!(
            (got - expected).abs() < 4.0 * error + 3e-4 * expected,
            "{name}, {}: {got} ± {error} instead of {expected}",
            method.name()
        );
        assert!(error < 0.01 * expected, "{name}: too noisy to see anything ({error} of {expected})");
    }
}

#[test]
fn irradiance_under_a_point_light() {
    check_light("point", 3.0 / 2.25, |s| {
        s.light(LightKind::Point, Rgb::splat(3.0), DVec3::new(0.0, 1.5, 0.0), DVec3::NEG_Y);
    });
}

#[test]
fn irradiance_under_a_spot_light() {
    // Inside the inner cone a spot is a point light, here at 30° to the plane's normal: E = I cos³θ / h².
    let cos = (30f64).to_radians().cos();
    let h = 1.2;
    check_light("spot", 5.0 * cos.powi(3) / (h * h), |s| {
        let position = DVec3::new(0.0, h, h * 30f64.to_radians().tan());
        let kind = LightKind::Spot { inner: 0.3, outer: 0.5 };
        s.light(kind, Rgb::splat(5.0), position, -position);
    });
}

#[test]
fn irradiance_under_a_directional_light() {
    check_light("directional", 2.0 * 40f64.to_radians().cos(), |s| {
        let direction = DVec3::new(40f64.to_radians().sin(), -(40f64.to_radians().cos()), 0.0);
        s.light(LightKind::Directional, Rgb::splat(2.0), DVec3::Y, direction);
    });
}

/// A square lamp of side 2a at height h over the point: four corner terms of the classic configuration factor,
/// E = 4 L · ½ [X/√(1+X²) atan(Y/√(1+X²)) + Y/√(1+Y²) atan(X/√(1+Y²))] with X = Y = a/h.
#[test]
fn irradiance_under_a_square_light() {
    let (a, h) = (0.5f64, 1.0f64);
    let x = a / h;
    let s = (1.0 + x * x).sqrt();
    let irradiance = 4.0 * 7.0 * 0.5 * 2.0 * (x / s * (x / s).atan());
    check_light("square", irradiance, |m| {
        let lamp = m.material(MaterialDescription::emitter("lamp", Rgb::splat(7.0)));
        let a = a as f32;
        m.mesh(quad(Vec3::new(-a, h as f32, -a), Vec3::X * 2.0 * a, Vec3::Z * 2.0 * a, lamp));
    });
}

/// A uniform sphere lamp of radius r at height h: E = π L (r/h)². The tessellation's radius is corrected so that its
/// projected area is the sphere's.
#[test]
fn irradiance_under_a_sphere_light() {
    let (r, h) = (0.3f64, 1.1f64);
    check_light("sphere", PI * 4.0 * (r / h).powi(2), |m| {
        let lamp = m.material(MaterialDescription::emitter("lamp", Rgb::splat(4.0)));
        let mesh = sphere(Vec3::new(0.0, h as f32, 0.0), r as f32, 5, false, false, lamp);
        m.mesh(mesh);
    });
}

/// A slab of glass at normal incidence: with all inter-reflections T = (1 − R)/(1 + R), R = ((n − 1)/(n + 1))².
#[test]
fn transmission_of_a_glass_slab() {
    for ior in [1.0f32, 1.5, 2.4] {
        let mut s = SceneMaker::new();
        let lamp = s.material(MaterialDescription::emitter("lamp", Rgb::splat(1.0)));
        let glass = s.material(MaterialDescription::glass("glass", ior));
        s.mesh(quad(Vec3::new(-1.0, -1.0, -1.0), Vec3::X * 2.0, Vec3::Y * 2.0, lamp));
        s.mesh(cuboid(Vec3::new(-1.0, -1.0, -0.2), Vec3::new(1.0, 1.0, 0.2), false, glass));
        s.camera(DVec3::new(0.0, 0.0, 2.0), DVec3::ZERO, 0.002);
        let r = (f64::from(ior - 1.0) / f64::from(ior + 1.0)).powi(2);
        for method in Method::ALL {
            let samples = if method.has_rounds() { 4096 } else { 65_536 };
            let expected = (1.0 - r) / (1.0 + r);
            let (got, sigma) = if method == Method::Mlt {
                let green = from_seeds(&s.scene, &settings(method, 1, 4096))[1];
                assert!(green.sigma() < 0.01 * expected, "too noisy to see anything: {}", green.sigma());
                (green.value, green.sigma())
            } else {
                let film = render_description(s.scene.clone(), &settings(method, 1, samples));
                // Standard error of a Bernoulli-like estimate, below 0.002 (0.008) of the value; 4 σ.
                (f64::from(color(&film, 0, 0).g), (expected * (1.0 - expected) / f64::from(samples)).sqrt())
            };
            assert!(
                (got - expected).abs() <= 4.0 * sigma + 1e-6,
                "n = {ior}, {}: {got} instead of {expected} (σ = {sigma})",
                method.name()
            );
        }
    }
}

/// Beer and Lambert: a slab of thickness d that attenuates to colour c over distance D transmits c^(d/D) per passage.
#[test]
fn attenuation_in_a_body() {
    let mut s = SceneMaker::new();
    let lamp = s.material(MaterialDescription::emitter("lamp", Rgb::splat(1.0)));
    let glass = s.material(MaterialDescription {
        attenuation_color: Rgb::new(0.5, 0.25, 1.0),
        attenuation_distance: 0.8,
        ..MaterialDescription::glass("tinted", 1.0)
    });
    s.mesh(quad(Vec3::new(-1.0, -1.0, -1.0), Vec3::X * 2.0, Vec3::Y * 2.0, lamp));
    s.mesh(cuboid(Vec3::new(-1.0, -1.0, -0.2), Vec3::new(1.0, 1.0, 0.2), false, glass));
    s.camera(DVec3::new(0.0, 0.0, 2.0), DVec3::ZERO, 0.002);
    for method in Method::ALL {
        if method == Method::Mlt {
            for (g, c) in from_seeds(&s.scene, &settings(method, 1, 4096)).into_iter().zip([0.5f64, 0.25, 1.0]) {
                let (value, sigma) = (g.value, g.sigma());
                assert!((value - c.sqrt()).abs() <= 4.6 * sigma, "mlt: {value} ± {sigma} instead of {}", c.sqrt());
                assert!(sigma < 0.01 * value, "too noisy to see anything: {sigma} of {value}");
            }
            continue;
        }
        let got = color(&render_description(s.scene.clone(), &settings(method, 1, 16)), 0, 0);
        for (g, c) in got.to_array().into_iter().zip([0.5f64, 0.25, 1.0]) {
            assert_close(method.name(), f64::from(g), c.sqrt(), 1e-4);
        }
    }
}

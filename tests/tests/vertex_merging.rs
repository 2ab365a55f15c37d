//! Vertex connection and merging: the light of its limits, bidirectional path tracing and photon mapping, and of path tracing.

use gatherlight_render::integrator::connect::Connector;
use gatherlight_render::integrator::vcm::Round;
use gatherlight_render::integrator::vertex::{Merging, Start, Walk};
use gatherlight_render::material::{Scatter, TransportMode};
use gatherlight_render::math::sobol::Sampler;
use gatherlight_render::math::{Purpose, Rgb, ops};
use gatherlight_render::photon::estimate::{for_each_on_surface, irradiance_within};
use gatherlight_render::photon::kernel::Kernel;
use gatherlight_render::photon::pack::{decode_normal, encode_normal};
use gatherlight_render::photon::{EmissionRange, MapKind, PhotonMap};
use gatherlight_render::scene::builder;
use gatherlight_render::scene::description::{LightKind, MaterialDescription, SceneDescription};
use gatherlight_render::settings::{CameraChoice, Merge, Method, RenderSettings};
use gatherlight_tests::agree::assert_agree;
use gatherlight_tests::fixtures::{SceneMaker, cuboid, quad};
use gatherlight_tests::single::render_description;
use gatherlight_tests::transport;
use glam::{DVec3, Vec3};

const SIDE: u32 = 24;

/// Rounds with a light path for each pixel.
fn vcm(rounds: u32) -> RenderSettings {
    let photons = u64::from(SIDE * SIDE * rounds);
    RenderSettings { rounds, photons, ..settings(Method::Vcm, 1) }
}

fn settings(method: Method, samples: u32) -> RenderSettings {
    RenderSettings { method, width: SIDE, height: SIDE, samples, ..Default::default() }
}

/// A radius that nothing lies within: what remains is bidirectional path tracing, whatever the number of light paths.
#[test]
fn without_merging_it_is_bidirectional_path_tracing() {
    let bdpt = RenderSettings { seed: 100, ..settings(Method::Bdpt, 8) };
    for (share, name) in [(1.0, "as many light paths as pixels"), (0.3, "fewer"), (2.6, "more")] {
        let few = RenderSettings { max_radius: Some(1e-5), ..vcm(8) };
        let few = RenderSettings { photons: (few.photons as f64 * share) as u64, ..few };
        assert_agree(name, &transport::glossy_room(), [&few, &bdpt], 12, 0.0, 0.03);
    }
}

/// Unweighted, what merges at a Lambertian surface is Jensen's radiance estimate from the same photons.
#[test]
fn without_connections_it_is_photon_mapping() {
    let mut description = transport::diffuse_room();
    let cameras = std::mem::take(&mut description.cameras);
    let bounds = builder::world_bounds(&description);
    let scene = builder::build(description).expect("a scene");
    let (camera, _) =
        builder::choose_camera(&cameras, bounds, &scene.space, &CameraChoice::First, SIDE, SIDE).expect("a camera");
    let (paths, radius) = (20_000, 0.05f32);
    let job = RenderSettings { photons: paths, rounds: 1, ..vcm(1) };
    let vertices = Round::new(&scene, &camera, &job, radius, 0).emit(EmissionRange { first: 0, end: paths });
    let mut photons = vertices.clone();
    photons.vertices = None;
    // Photons know the side they came from.
    for (normal, direction) in photons.normals.iter_mut().zip(&vertices.vertices.as_ref().expect("vertices").directions)
    {
        let (front, wi) = (decode_normal(*normal), gatherlight_render::photon::pack::decode_direction(*direction));
        if wi.dot(front) < 0.0 {
            *normal = encode_normal(-front);
        }
    }
    let vertices = PhotonMap::build(MapKind::Global, vertices);
    let photons = PhotonMap::build(MapKind::Global, photons);
    let merging = Merging { vc: 0.0, ..Merging::new(paths as f64, radius) };
    let connector = Connector { scene: &scene, camera: &camera, merging, light_paths: 1.0 };
    let per_area = 1.0 / (paths as f32 * ops::PI * radius * radius);
    let walk = Walk { scene: &scene, mode: TransportMode::Radiance, merging, max_length: 1, roulette: false };
    let mut lit = 0;
    for i in 0..2000 {
        let mut sampler = Sampler::new(9, Purpose::Test, 0, 0, i);
        let [x, y] = sampler.next_2d();
        let start = Start::camera(&camera, 1.0, camera.ray(x * SIDE as f32, y * SIDE as f32));
        walk.run(&start, &mut sampler, |v, _| {
            let mut merged = Rgb::BLACK;
            for_each_on_surface(&vertices, v.point.position, v.point.ng, radius * radius, |i| {
                let shares = vertices.vertices().expect("vertices").shares[i as usize].map(f64::from);
                let wi = vertices.direction(i).expect("a direction");
                if let Some(c) = connector.merge(v, wi, vertices.power(i), shares) {
                    merged += c.value * per_area;
                }
            });
            let side = if v.wo.dot(v.point.ng) < 0.0 { -v.point.ng } else { v.point.ng };
            let e = irradiance_within(&photons, v.point.position, side, radius * radius, Kernel::Constant);
            let expected = v.bsdf.diffuse_albedo(v.wo) * e.irradiance * ops::INV_PI;
            lit += u32::from(expected.g > 0.0);
            for c in 0..3 {
                let error = (merged[c] - expected[c]).abs();
                assert!(error <= 1e-4 * expected[c] + 1e-6, "{merged:?} instead of {expected:?}");
            }
        });
    }
    assert!(lit > 1500, "only {lit} of 2000 points see photons");
}

/// Merging loses what lies over edges within a radius of 0.02 of a room of 2, at most about 1 %.
fn agrees_with_path(room: &str) {
    let (name, scene) = transport::rooms().into_iter().find(|(name, _)| *name == room).expect("a room");
    let path = RenderSettings { seed: 100, ..settings(Method::Path, 48) };
    let vcm = RenderSettings { max_radius: Some(0.02), ..vcm(12) };
    assert_agree(name, &scene, [&vcm, &path], 12, 0.01, 0.03);
}

#[test]
fn diffuse_surfaces() {
    agrees_with_path("diffuse");
}

#[test]
fn mirrors_and_absorbing_glass() {
    agrees_with_path("specular");
}

#[test]
fn textures_and_shading_normals() {
    agrees_with_path("bumpy");
}

#[test]
fn point_spot_and_directional_lights() {
    agrees_with_path("sunny");
}

#[test]
fn orthographic_camera() {
    agrees_with_path("orthographic");
}

/// Longest paths count edges, merged ones too.
#[test]
fn paths_are_as_long_as_asked_for() {
    for max_depth in [2, 3] {
        let path = RenderSettings { seed: 100, max_depth: Some(max_depth), ..settings(Method::Path, 48) };
        let vcm = RenderSettings { max_radius: Some(0.02), max_depth: Some(max_depth), ..vcm(12) };
        let name = format!("at most {max_depth} edges");
        assert_agree(&name, &transport::diffuse_room(), [&vcm, &path], 12, 0.01, 0.03);
    }
}

/// A room that only a point light behind a pane of glass lights: every path to the camera is specular there, so that neither
/// path tracing nor connections find any light but by merging. The camera sees the floor through a second pane.
fn behind_glass() -> SceneDescription {
    let mut s = SceneMaker::new();
    let wall = s.material(MaterialDescription::lambert("wall", Rgb::new(0.6, 0.5, 0.4)));
    let pane = s.material(MaterialDescription {
        volume: false,
        base_color: Rgb::splat(0.9),
        ..MaterialDescription::glass("pane", 1.5)
    });
    s.mesh(cuboid(Vec3::splat(-1.0), Vec3::splat(1.0), true, wall));
    s.mesh(quad(Vec3::new(-1.0, 0.6, 1.0), Vec3::X * 2.0, Vec3::Z * -2.0, pane));
    s.mesh(quad(Vec3::new(-1.0, -1.0, 0.8), Vec3::X * 2.0, Vec3::Y * 2.0, pane));
    s.light(LightKind::Point, Rgb::splat(3.0), DVec3::new(0.2, 0.8, 0.1), DVec3::NEG_Y);
    s.camera(DVec3::new(0.0, 0.0, 0.95), DVec3::new(0.0, -0.5, 0.0), 1.2);
    s.scene
}

/// Specular–diffuse–specular light, which only photons reach: the same as progressive photon mapping finds. Both lose a little
/// over edges.
#[test]
fn specular_diffuse_specular_light_is_that_of_photon_mapping() {
    let radius = Some(0.05);
    let photons = 6_000 * 16;
    let progressive = RenderSettings {
        rounds: 16,
        photons,
        caustic_photons: photons,
        max_radius: radius,
        seed: 100,
        ..settings(Method::Progressive, 1)
    };
    let vcm = RenderSettings { max_radius: radius, photons, ..vcm(16) };
    assert_agree("behind glass", &behind_glass(), [&vcm, &progressive], 12, 0.02, 0.03);
}

/// Rounds computed apart are the same rounds: only the order of sums differs.
#[test]
fn independent_rounds_are_the_shared_ones() {
    let shared = vcm(6);
    let apart = RenderSettings { merge: Merge::Independent, ..shared.clone() };
    let images = [&shared, &apart].map(|s| render_description(transport::glossy_room(), s));
    for (a, b) in images[0].pixels.iter().zip(&images[1].pixels) {
        assert!((a - b).abs() <= 1e-5 * a.abs().max(1e-3), "{a} {b}");
    }
}

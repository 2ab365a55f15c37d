//! The user's unit and origin change no bit of the image.

use gatherlight_render::film::Film;
use gatherlight_render::math::Rgb;
use gatherlight_render::scene::description::{LightKind, MaterialDescription, Projection, SceneDescription};
use gatherlight_render::settings::{Method, RenderSettings};
use gatherlight_tests::fixtures::{SceneMaker, cuboid, look_along, quad, sphere};
use gatherlight_tests::single::render_description;
use glam::{DAffine3, DMat3, DVec3, Vec3};

/// A room with an area light, a point light, tinted glass, a mirror and a shared, mirrored mesh.
fn room() -> SceneDescription {
    let mut s = SceneMaker::new();
    let wall = s.material(MaterialDescription::lambert("wall", Rgb::new(0.7, 0.5, 0.3)));
    let lamp = s.material(MaterialDescription::emitter("lamp", Rgb::splat(6.0)));
    let mirror = s.material(MaterialDescription::metal("mirror", Rgb::splat(0.9), 0.2));
    let glass = s.material(MaterialDescription {
        attenuation_color: Rgb::new(0.9, 0.5, 0.6),
        attenuation_distance: 0.7,
        ..MaterialDescription::glass("glass", 1.5)
    });
    s.mesh(cuboid(Vec3::splat(-2.0), Vec3::splat(2.0), true, wall));
    s.mesh(quad(Vec3::new(-0.5, 1.75, -0.5), Vec3::X, Vec3::Z, lamp));
    s.mesh(sphere(Vec3::new(0.75, -1.25, 0.5), 0.5, 2, true, false, glass));
    s.mesh(sphere(Vec3::ZERO, 0.5, 2, true, false, mirror));
    let mesh = s.scene.meshes.len() - 1;
    let mut second = s.scene.instances[mesh].clone();
    s.scene.instances[mesh].to_world = DAffine3::from_translation(DVec3::new(-1.0, -1.0, -0.5));
    second.to_world = DAffine3 {
        matrix3: DMat3::from_diagonal(DVec3::new(-0.5, 1.5, 0.5)),
        translation: DVec3::new(0.5, 0.25, -1.25),
    };
    s.scene.instances.push(second);
    s.light(LightKind::Point, Rgb::new(2.0, 3.0, 4.0), DVec3::new(-1.0, 1.0, 1.0), DVec3::NEG_Y);
    s.camera(DVec3::new(0.25, 0.125, 1.75), DVec3::new(0.0, -0.25, 0.0), 1.2);
    s.scene
}

fn scaled(mut d: SceneDescription, f: f64) -> SceneDescription {
    let scale = |a: &mut DAffine3| *a = DAffine3::from_scale(DVec3::splat(f)) * *a;
    d.instances.iter_mut().for_each(|i| scale(&mut i.to_world));
    d.cameras.iter_mut().for_each(|c| scale(&mut c.to_world));
    for l in &mut d.lights {
        scale(&mut l.to_world);
        if l.kind != LightKind::Directional {
            l.intensity *= (f * f) as f32;
        }
    }
    d.materials.iter_mut().for_each(|m| m.attenuation_distance *= f as f32);
    d
}

fn moved(mut d: SceneDescription, by: DVec3) -> SceneDescription {
    let shift = |a: &mut DAffine3| a.translation += by;
    d.instances.iter_mut().for_each(|i| shift(&mut i.to_world));
    d.cameras.iter_mut().for_each(|c| shift(&mut c.to_world));
    d.lights.iter_mut().for_each(|l| shift(&mut l.to_world));
    d
}

fn image(d: SceneDescription, method: Method) -> Film {
    let settings = RenderSettings {
        method,
        width: 24,
        height: 24,
        samples: 4,
        photons: 20_000,
        caustic_photons: 20_000,
        ..Default::default()
    };
    render_description(d, &settings)
}

#[test]
fn scaling_by_powers_of_two_changes_no_bit() {
    for method in Method::ALL {
        let base = image(room(), method);
        assert!(base.pixels.iter().any(|&v| v > 0.1), "the test image is black");
        for exponent in [-20, -1, 20] {
            let other = image(scaled(room(), 2f64.powi(exponent)), method);
            assert!(base.pixels == other.pixels, "{}: scaled by 2^{exponent}, the image changes", method.name());
        }
    }
}

#[test]
fn moving_in_representable_steps_changes_no_bit() {
    for method in Method::ALL {
        let base = image(room(), method);
        for by in [DVec3::new(1024.0, -3.0, 0.5), DVec3::splat(f64::from(1 << 23))] {
            let other = image(moved(room(), by), method);
            assert!(base.pixels == other.pixels, "{}: moved by {by}, the image changes", method.name());
        }
    }
}

#[test]
fn orthographic_cameras_scale_along() {
    let with = |f: f64| {
        let mut d = scaled(room(), f);
        d.cameras[0].projection = Projection::Orthographic { xmag: 1.5 * f, ymag: 1.5 * f };
        d.cameras[0].to_world =
            DAffine3::from_scale(DVec3::splat(f)) * look_along(DVec3::new(0.0, 0.0, 1.75), DVec3::NEG_Z);
        image(d, Method::Path)
    };
    assert!(with(1.0).pixels == with(2f64.powi(10)).pixels);
}

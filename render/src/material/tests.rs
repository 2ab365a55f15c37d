//! Textures, normal maps, alpha masks, absorption and the coat's albedo table.

use super::albedo::{directional, mean};
use super::fresnel::schlick;
use super::microfacet::{distribution, visibility};
use super::texture::{Encoding, srgb_to_linear};
use super::*;
use crate::geometry::SurfacePoint;
use crate::math::{Purpose, Rgb, Stream, warp};
use crate::scene::description::{ImageDescription, MaterialDescription, TextureDescription, TextureRef, Wrap};
use glam::{Vec2, Vec3};

fn image(width: u32, height: u32, rgba: &[u8]) -> ImageDescription {
    ImageDescription { name: String::new(), width, height, rgba: rgba.to_vec() }
}

fn textures(wrap: Wrap, nearest: bool, image: ImageDescription) -> Textures {
    Textures::new(vec![TextureDescription { image: 0, wrap_u: wrap, wrap_v: wrap, nearest }], vec![image])
}

const FIRST: TextureRef = TextureRef { texture: 0, uv_set: 0 };

fn at(t: &Textures, u: f32, v: f32, e: Encoding) -> [f32; 4] {
    t.sample(FIRST, &[Vec2::new(u, v), Vec2::ZERO], e)
}

fn point(tangent: Option<(Vec3, f32)>) -> SurfacePoint {
    SurfacePoint {
        position: Vec3::ZERO,
        error: Vec3::ZERO,
        ng: Vec3::Z,
        ns: Vec3::Z,
        tangent,
        uv: [Vec2::splat(0.5); 2],
        color: [1.0; 4],
        material: 0,
        instance: 0,
        triangle: 0,
    }
}

#[test]
fn srgb_bytes_decode_by_the_standard() {
    // Values of IEC 61966-2-1: 0, the linear toe, mid grey, white.
    for (byte, linear) in
        [(0u8, 0.0f32), (10, 10.0 / 255.0 / 12.92), (128, 0.215_860_5), (188, 0.502_886_5), (255, 1.0)]
    {
        let t = textures(Wrap::Repeat, true, image(1, 1, &[byte, byte, byte, 128]));
        let v = at(&t, 0.5, 0.5, Encoding::Srgb);
        assert!((v[0] - linear).abs() < 1e-6, "{byte}: {}", v[0]);
        assert_eq!(v[3], 128.0 / 255.0);
        assert_eq!(at(&t, 0.5, 0.5, Encoding::Linear)[1], f32::from(byte) / 255.0);
    }
    assert!((srgb_to_linear(0.04045) - 0.04045 / 12.92).abs() < 1e-7);
}

#[test]
fn textures_filter_and_wrap() {
    let row = image(2, 1, &[0, 0, 0, 255, 255, 255, 255, 255]);
    let value = |wrap, nearest, u| at(&textures(wrap, nearest, row.clone()), u, 0.5, Encoding::Linear)[0];
    // Texel centres at 0.25 and 0.75.
    for (wrap, u, expected) in [
        (Wrap::ClampToEdge, 0.25, 0.0),
        (Wrap::ClampToEdge, 0.5, 0.5),
        (Wrap::ClampToEdge, 0.75, 1.0),
        (Wrap::ClampToEdge, 7.0, 1.0),
        (Wrap::ClampToEdge, -7.0, 0.0),
        (Wrap::Repeat, 1.0, 0.5),
        (Wrap::Repeat, 3.25, 0.0),
        (Wrap::Repeat, -0.25, 1.0),
        (Wrap::MirroredRepeat, 1.0, 1.0),
        (Wrap::MirroredRepeat, 1.75, 0.0),
        (Wrap::MirroredRepeat, -0.25, 0.0),
    ] {
        assert!((value(wrap, false, u) - expected).abs() < 1e-6, "{wrap:?} {u}: {}", value(wrap, false, u));
    }
    assert_eq!((value(Wrap::Repeat, true, 0.49), value(Wrap::Repeat, true, 0.51)), (0.0, 1.0));
    // v = 0 is the top row.
    let column = textures(Wrap::ClampToEdge, true, image(1, 2, &[255, 0, 0, 255, 0, 0, 255, 255]));
    assert_eq!(at(&column, 0.5, 0.1, Encoding::Linear)[0], 1.0);
    for u in [f32::NAN, f32::INFINITY, 1e30, -1e30] {
        assert!(value(Wrap::Repeat, false, u).is_finite());
    }
    assert_eq!(Textures::default().sample(FIRST, &[Vec2::ZERO; 2], Encoding::Srgb), [1.0; 4]);
}

#[test]
fn normal_maps_tilt_the_shading_normal() {
    let d = MaterialDescription { normal_texture: Some(FIRST), ..MaterialDescription::lambert("", Rgb::WHITE) };
    // (0.6, 0, 0.8) along the tangent; green flips with the handedness.
    let t = textures(Wrap::Repeat, true, image(1, 1, &[204, 128, 230, 255]));
    let n = Material::new(&d, 1.0).bsdf(&point(Some((Vec3::Y, 1.0))), &t).shading_normal();
    assert!((n - Vec3::new(0.0, 0.6, 0.8)).length() < 0.01, "{n}");
    let up = textures(Wrap::Repeat, true, image(1, 1, &[128, 204, 230, 255]));
    for (handedness, x) in [(1.0, -0.6), (-1.0, 0.6)] {
        let n = Material::new(&d, 1.0).bsdf(&point(Some((Vec3::Y, handedness))), &up).shading_normal();
        assert!((n - Vec3::new(x, 0.0, 0.8)).length() < 0.01, "{n}");
    }
    // Scale 0 flattens; a map that points below the surface is lifted to the horizon.
    let flat = MaterialDescription { normal_scale: 0.0, ..d.clone() };
    assert_eq!(Material::new(&flat, 1.0).bsdf(&point(Some((Vec3::Y, 1.0))), &t).shading_normal(), Vec3::Z);
    let below = textures(Wrap::Repeat, true, image(1, 1, &[255, 128, 0, 255]));
    let n = Material::new(&d, 1.0).bsdf(&point(Some((Vec3::Y, 1.0))), &below).shading_normal();
    assert!(n.z > 0.0 && (n.length() - 1.0).abs() < 1e-6, "{n}");
    // Without tangents there is nothing to map with.
    assert_eq!(Material::new(&d, 1.0).bsdf(&point(None), &t).shading_normal(), Vec3::Z);
}

#[test]
fn alpha_masks_compare_the_product() {
    let d = MaterialDescription {
        alpha_cutoff: Some(0.5),
        base_alpha: 0.8,
        base_color_texture: Some(FIRST),
        ..MaterialDescription::default()
    };
    let m = Material::new(&d, 1.0);
    let uv = [Vec2::splat(0.5); 2];
    for (byte, vertex, passes) in [(255u8, 1.0f32, true), (255, 0.5, false), (128, 1.0, false), (165, 1.0, true)] {
        let t = textures(Wrap::Repeat, true, image(1, 1, &[0, 0, 0, byte]));
        assert_eq!(m.alpha_passes(&uv, &[1.0, 1.0, 1.0, vertex], &t), passes, "{byte} {vertex}");
    }
    assert!(Material::new(&MaterialDescription::default(), 1.0).alpha_passes(&uv, &[0.0; 4], &Textures::default()));
}

#[test]
fn absorption_follows_the_scale_of_the_scene() {
    let d = MaterialDescription {
        attenuation_color: Rgb::new(0.5, 1.0, 0.0),
        attenuation_distance: 2.0,
        ..MaterialDescription::glass("", 1.5)
    };
    for scale in [1.0f32, 1.0 / 1_048_576.0, 1_048_576.0] {
        let t = Material::new(&d, scale).transmittance(2.0 * scale);
        assert!((t.r - 0.5).abs() < 1e-6 && t.g == 1.0 && t.b < 1e-20, "{t:?}");
        assert!(Material::new(&d, scale).transmittance(f32::MAX).is_finite());
        assert_eq!(Material::new(&d, scale).transmittance(0.0), Rgb::WHITE);
    }
    assert!(Material::new(&MaterialDescription::glass("", 1.5), 1.0).absorption().is_none());
    let thin = MaterialDescription { volume: false, ..d };
    assert!(Material::new(&thin, 1.0).absorption().is_none());
}

/// The table against ∫ f·cos dω by cosine-weighted Monte Carlo that knows nothing of visible normals.
#[test]
fn the_albedo_table_is_the_integral_of_the_lobe() {
    let (f0, f90) = (0.2f32, 1.0f32);
    for alpha in [0.3f32, 0.55, 0.97] {
        for cos in [0.15f32, 0.52, 0.93] {
            let wo = Vec3::new((1.0 - cos * cos).sqrt(), 0.0, cos);
            let mut s = Stream::new(41, Purpose::Test, 0, 0);
            let (n, mut sum, mut square) = (200_000, 0.0f64, 0.0f64);
            for _ in 0..n {
                let wi = warp::cosine_hemisphere(s.next_2d());
                let h = wo + wi;
                let f = schlick(Rgb::splat(f0), Rgb::splat(f90), wo.dot(h.normalize())).r
                    * distribution(h, Vec3::Z, alpha)
                    * visibility(cos, wi.z, alpha);
                let v = f64::from(f) * std::f64::consts::PI;
                sum += v;
                square += v * v;
            }
            let mean = sum / f64::from(n);
            let error = ((square / f64::from(n) - mean * mean) / f64::from(n)).sqrt();
            let e = directional(cos, alpha);
            let table = f64::from(f0 * e.a + f90 * e.b);
            assert!((table - mean).abs() < 4.5 * error + 2e-3, "α {alpha}, cos {cos}: {table}, {mean} ± {error}");
        }
    }
}

#[test]
fn the_mean_albedo_is_the_mean_of_the_directional_one() {
    for alpha in [0.0f32, 1e-3, 0.1, 0.5, 1.0] {
        let n = 20_000;
        let (mut a, mut b) = (0.0f64, 0.0f64);
        for k in 0..n {
            let mu = (k as f32 + 0.5) / n as f32;
            let e = directional(mu, alpha);
            a += f64::from(e.a * 2.0 * mu) / f64::from(n);
            b += f64::from(e.b * 2.0 * mu) / f64::from(n);
        }
        let m = mean(alpha);
        assert!((f64::from(m.a) - a).abs() < 1e-4 && (f64::from(m.b) - b).abs() < 1e-4, "{alpha}: {m:?} {a} {b}");
    }
}

/// The factorisation that precomputed irradiance relies on: f_diffuse = ρ(wo)/π · in_weight(wi), mean weight 1.
#[test]
fn a_coated_base_factorises() {
    let d = MaterialDescription {
        metallic: 0.0,
        roughness: 0.4,
        base_color: Rgb::new(0.8, 0.4, 0.1),
        ..MaterialDescription::default()
    };
    let b = Material::new(&d, 1.0).bsdf(&point(None), &Textures::default());
    let wo = Vec3::new(0.3, -0.5, 0.6).normalize();
    let mut s = Stream::new(42, Purpose::Test, 0, 0);
    let (n, mut sum) = (100_000, 0.0f64);
    for _ in 0..n {
        let wi = warp::cosine_hemisphere(s.next_2d());
        let f = b.eval(wo, wi, Lobes::DIFFUSE, TransportMode::Radiance);
        let g = b.diffuse_albedo(wo) * (b.diffuse_in_weight(wi) * crate::math::ops::INV_PI);
        assert!((f.r - g.r).abs() <= 1e-6 * f.r && (f.b - g.b).abs() <= 1e-6 * f.b);
        sum += f64::from(b.diffuse_in_weight(wi));
    }
    // The weight's standard deviation is below 0.2.
    assert!((sum / f64::from(n) - 1.0).abs() < 4.5 * 0.2 / f64::from(n).sqrt());
}

#[test]
fn flags_say_what_a_material_needs() {
    let flags = |d: &MaterialDescription| {
        let m = Material::new(d, 1.0);
        (m.is_pure_lambert(), m.has_diffuse(), m.has_specular_or_glossy(), m.needs_direction())
    };
    assert_eq!(flags(&MaterialDescription::lambert("", Rgb::WHITE)), (true, true, false, false));
    assert_eq!(flags(&MaterialDescription::metal("", Rgb::WHITE, 0.2)), (false, false, true, false));
    assert_eq!(flags(&MaterialDescription::glass("", 1.5)), (false, false, true, false));
    let coat = MaterialDescription { metallic: 0.0, ..MaterialDescription::default() };
    assert_eq!(flags(&coat), (false, true, true, true));
    assert_eq!(Material::new(&MaterialDescription::lambert("", Rgb::WHITE), 1.0).specular_albedo_bound(), 0.0);
    assert_eq!(Material::new(&MaterialDescription::glass("", 1.5), 1.0).specular_albedo_bound(), 1.0);
}

/// Emission leaves the front, or both faces of a double-sided material, through its texture.
#[test]
fn emission_leaves_the_front() {
    let d = MaterialDescription { emissive_texture: Some(FIRST), ..MaterialDescription::emitter("", Rgb::splat(3.0)) };
    let t = textures(Wrap::Repeat, true, image(1, 1, &[255, 0, 255, 255]));
    let m = Material::new(&d, 1.0);
    assert_eq!(m.emission(&point(None), &t, Vec3::Z), Rgb::new(3.0, 0.0, 3.0));
    assert_eq!(m.emission(&point(None), &t, -Vec3::Z), Rgb::BLACK);
    let both = Material::new(&MaterialDescription { double_sided: true, ..d }, 1.0);
    assert_eq!(both.emission(&point(None), &t, -Vec3::Z), Rgb::new(3.0, 0.0, 3.0));
}

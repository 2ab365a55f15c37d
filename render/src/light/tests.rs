//! Irradiance and power of every light against closed forms.

use super::*;
use crate::math::{Purpose, Stream};
use crate::scene::description::{ImageDescription, MaterialDescription, TextureDescription, TextureRef, Wrap};
use glam::{DVec3, Vec2};
use std::f64::consts::PI;

/// Standard errors a mean may be off.
const SIGMAS: f64 = 4.5;

fn triangle(p: [Vec3; 3]) -> EmissiveTriangle {
    EmissiveTriangle { p, uv: [[Vec2::ZERO; 2]; 3], color: [[1.0; 4]; 3], material: 0, instance: 0, triangle: 0 }
}

fn quad(o: Vec3, u: Vec3, v: Vec3) -> [EmissiveTriangle; 2] {
    [triangle([o, o + u, o + u + v]), triangle([o, o + u + v, o + v])]
}

struct Setup {
    materials: Vec<Material>,
    textures: Textures,
}

impl Setup {
    fn new(d: &MaterialDescription) -> Self {
        Setup { materials: vec![Material::new(d, 1.0)], textures: Textures::default() }
    }
    fn ctx(&self) -> LightContext<'_> {
        LightContext { materials: &self.materials, textures: &self.textures }
    }
}

/// Irradiance at `x` with normal `n` by next-event estimation with chosen lights, and its standard error.
fn irradiance(lights: &Lights, ctx: &LightContext, x: Vec3, n: Vec3, count: usize) -> (f64, f64) {
    let mut s = Stream::new(31, Purpose::Test, 0, 0);
    let (mut sum, mut square) = (0.0f64, 0.0f64);
    for _ in 0..count {
        let (i, pmf) = lights.selector().sample(s.next_f32()).unwrap();
        let e = lights.as_slice()[i].sample_li(ctx, x, s.next_2d()).map_or(0.0, |l| {
            f64::from(l.radiance.r) * f64::from(l.wi.dot(n).max(0.0)) / (f64::from(l.pdf) * f64::from(pmf))
        });
        sum += e;
        square += e * e;
    }
    let mean = sum / count as f64;
    (mean, ((square / count as f64 - mean * mean).max(0.0) / count as f64).sqrt())
}

/// Irradiance of a uniform polygon wholly above the horizon: L/2 Σ Θₖ Γₖ·n (Lambert 1760).
fn polygon(p: &[Vec3], x: Vec3, n: Vec3) -> f64 {
    let d: Vec<DVec3> = p.iter().map(|v| (v.as_dvec3() - x.as_dvec3()).normalize()).collect();
    let sum: f64 = (0..d.len())
        .map(|k| {
            let (a, b) = (d[k], d[(k + 1) % d.len()]);
            a.cross(b).normalize().dot(n.as_dvec3()) * a.angle_between(b)
        })
        .sum();
    0.5 * sum.abs()
}

#[test]
fn point_spot_and_directional_irradiance() {
    let setup = Setup::new(&MaterialDescription::default());
    let ctx = setup.ctx();
    let at = Vec3::new(1.0, 2.0, 3.0);
    let (x, n) = (Vec3::new(0.5, -0.2, 0.1), Vec3::Z);
    let d = (at - x).as_dvec3();
    let closed = 7.0 * d.normalize().z / d.length_squared();
    let lamp = |l: Light| Lights::build(&[], vec![l], &ctx);
    let point = lamp(Light::Point(PointLight { position: at, intensity: Rgb::splat(7.0) }));
    assert!((irradiance(&point, &ctx, x, n, 1).0 / closed - 1.0).abs() < 1e-5);
    // A spot that looks 10° away from the receiver, inner 5°, outer 20°: falloff by the formula of the extension.
    let towards = (x - at).normalize();
    let side = towards.any_orthonormal_vector();
    let (ten, five, twenty) = (10f64.to_radians(), 5f64.to_radians(), 20f64.to_radians());
    let axis = towards * ten.cos() as f32 + side * ten.sin() as f32;
    let spot = lamp(Light::Spot(SpotLight::new(at, axis, Rgb::splat(7.0), five, twenty)));
    let falloff = ((ten.cos() - twenty.cos()) / (five.cos() - twenty.cos())).powi(2);
    assert!((irradiance(&spot, &ctx, x, n, 1).0 / (closed * falloff) - 1.0).abs() < 1e-4);
    let sun = DirectionalLight {
        direction: Vec3::new(0.0, 0.6, -0.8),
        irradiance: Rgb::splat(3.0),
        scene_center: Vec3::ZERO,
        scene_radius: 1.0,
    };
    assert!((irradiance(&lamp(Light::Directional(sun)), &ctx, x, n, 1).0 / (3.0 * 0.8) - 1.0).abs() < 1e-6);
}

#[test]
fn quad_irradiance_is_lamberts_formula() {
    let setup = Setup::new(&MaterialDescription::emitter("", Rgb::splat(5.0)));
    let ctx = setup.ctx();
    // From almost touching to a millionth of the solid angle; facing down.
    for (size, height) in [(1.0f32, 0.01f32), (1.0, 1.0), (0.3, 2.0), (1e-3, 1.0), (1e-6, 1.0)] {
        let (u, v) = (Vec3::Y * size, Vec3::X * size);
        let o = Vec3::new(-0.5 * size, -0.4 * size, height);
        let lights = Lights::build(&quad(o, u, v), Vec::new(), &ctx);
        let n = Vec3::new(0.1, 0.05, 1.0).normalize();
        let closed = 5.0 * polygon(&[o, o + u, o + u + v, o + v], Vec3::ZERO, n);
        let (mean, error) = irradiance(&lights, &ctx, Vec3::ZERO, n, 40_000);
        // A quad of 1e-6 at distance 1 has vertices rounded to 6e-8: 6 % of the side along an axis at worst.
        let rounding = if size < 1e-5 { 0.15 } else { 2e-4 };
        assert!((mean - closed).abs() < SIGMAS * error + rounding * closed, "{size}: {mean} ± {error}, {closed}");
        assert!(error < 0.01 * mean, "{size}: {mean} ± {error}");
        let power = f64::from(lights.total_power().r) / (5.0 * PI * f64::from(size).powi(2));
        assert!((power - 1.0).abs() < rounding, "{power}");
    }
}

/// A sphere's irradiance on a receiver that faces it is πL(R/d)².
#[test]
fn sphere_irradiance() {
    let setup = Setup::new(&MaterialDescription::emitter("", Rgb::splat(2.0)));
    let ctx = setup.ctx();
    let (rings, sectors, radius, height) = (64, 128, 0.5f64, 1.25f32);
    let vertex = |i: usize, j: usize| {
        let (theta, phi) = (PI * i as f64 / rings as f64, 2.0 * PI * (j % sectors) as f64 / sectors as f64);
        let d = DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
        (d * radius).as_vec3() + Vec3::Z * height
    };
    let mut triangles = Vec::new();
    for i in 0..rings {
        for j in 0..sectors {
            let (a, b, c, d) = (vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1));
            triangles.push(triangle([a, b, c]));
            triangles.push(triangle([a, c, d]));
        }
    }
    let lights = Lights::build(&triangles, Vec::new(), &ctx);
    let (mean, error) = irradiance(&lights, &ctx, Vec3::ZERO, Vec3::Z, 200_000);
    let closed = 2.0 * PI * (radius / f64::from(height)).powi(2);
    // Facets cut (π/rings)²/8 off the radius: 3e-4, twice that off the solid angle.
    assert!((mean - closed).abs() < SIGMAS * error + 1e-3 * closed, "{mean} ± {error}, {closed}");
}

/// The falloff of a spot of 0.01°, whose cosines differ by less than f32 can hold: a direction's rounding of 6e-8 is
/// 3.4e-4 of the half-angle, which moves the falloff by at most 4 times that.
#[test]
fn a_tiny_spot_keeps_its_falloff() {
    let outer = 0.01f64.to_radians();
    let axis = Vec3::new(0.3, -0.7, 0.5).normalize();
    let spot = SpotLight::new(Vec3::ZERO, axis, Rgb::WHITE, 0.0, outer);
    let exact = axis.as_dvec3().normalize();
    let side = exact.any_orthonormal_vector();
    for share in [0.0f64, 0.1, 0.5, 0.9, 0.99, 1.01, 2.0] {
        let a = outer * share;
        let closed = (1.0 - share * share).max(0.0).powi(2);
        let x = (exact * a.cos() + side * a.sin()).as_vec3();
        let e = spot.sample_li(x).map_or(0.0, |l| f64::from(l.radiance.r));
        assert!((e - closed).abs() < 4.0 * 3.4e-4, "{share}: {e} {closed}");
    }
}

/// Mean of the emitted photons' power, and the closed form.
fn emitted(light: &Light, ctx: &LightContext, count: usize) -> (f64, f64) {
    let mut s = Stream::new(32, Purpose::Test, 0, 0);
    let (mut sum, mut square) = (0.0f64, 0.0f64);
    for _ in 0..count {
        let p = light.sample_le(ctx, s.next_2d(), s.next_2d()).map_or(0.0, |e| f64::from(e.power.r));
        sum += p;
        square += p * p;
    }
    let mean = sum / count as f64;
    (mean, ((square / count as f64 - mean * mean).max(0.0) / count as f64).sqrt())
}

#[test]
fn emitted_power_is_the_closed_form_from_1e_minus_20_to_1e20() {
    let one = MaterialDescription::emitter("", Rgb::WHITE);
    for scale in [1e-20f32, 1.0, 1e20] {
        for double_sided in [false, true] {
            let d = MaterialDescription { emission: Rgb::splat(scale), double_sided, ..one.clone() };
            let setup = Setup::new(&d);
            let ctx = setup.ctx();
            let lights =
                Lights::build(&[triangle([Vec3::ZERO, Vec3::X, Vec3::Y * 0.5])], Vec::new(), &ctx).as_slice().to_vec();
            let closed = PI * 0.25 * if double_sided { 2.0 } else { 1.0 };
            let (mean, error) = emitted(&lights[0], &ctx, 1000);
            let scale = f64::from(scale);
            assert!((mean / scale - closed).abs() < SIGMAS * error / scale + 1e-6 * closed, "{mean}");
            assert!((f64::from(lights[0].power().r) / scale - closed).abs() < 1e-6);
        }
        let setup = Setup::new(&one);
        for (inner, outer) in [(0.0f64, 90.0f64), (20.0, 45.0), (0.0, 0.01), (0.009, 0.01), (30.0, 30.0)] {
            let (inner, outer) = (inner.to_radians(), outer.to_radians());
            let spot = Light::Spot(SpotLight::new(Vec3::ZERO, Vec3::X, Rgb::splat(scale), inner, outer));
            // Midpoint rule for 2π∫ falloff sinθ dθ, the falloff as the extension writes it, in the form of half angles.
            let h = |a: f64| 2.0 * (a / 2.0).sin().powi(2);
            let n = 100_000;
            let closed: f64 = (0..n)
                .map(|k| {
                    let t = outer * (k as f64 + 0.5) / n as f64;
                    let f = ((h(outer) - h(t)) / (h(outer) - h(inner))).min(1.0);
                    let f = if t <= inner { 1.0 } else { f * f };
                    2.0 * PI * f * t.sin() * outer / n as f64
                })
                .sum();
            let (mean, _) = emitted(&spot, &setup.ctx(), 200);
            assert!((mean / (f64::from(scale) * closed) - 1.0).abs() < 1e-4, "{inner} {outer}: {mean} {closed}");
        }
    }
}

/// A texture whose left half is black, on a triangle that covers more of the right: mean and photons agree with the
/// covered share.
#[test]
fn textured_emission_is_integrated() {
    let d = MaterialDescription {
        emissive_texture: Some(TextureRef { texture: 0, uv_set: 0 }),
        ..MaterialDescription::emitter("", Rgb::splat(4.0))
    };
    let image =
        ImageDescription { name: String::new(), width: 2, height: 1, rgba: vec![0, 0, 0, 255, 255, 255, 255, 255] };
    let texture = TextureDescription { image: 0, wrap_u: Wrap::ClampToEdge, wrap_v: Wrap::ClampToEdge, nearest: true };
    let setup = Setup { materials: vec![Material::new(&d, 1.0)], textures: Textures::new(vec![texture], vec![image]) };
    let ctx = setup.ctx();
    let mut t = triangle([Vec3::ZERO, Vec3::X, Vec3::Y]);
    t.uv = [[Vec2::ZERO; 2], [Vec2::X; 2], [Vec2::Y; 2]];
    let lights = Lights::build(&[t], Vec::new(), &ctx);
    let light = &lights.as_slice()[0];
    // u = x > 0.5 covers a quarter of the triangle.
    let closed = 4.0 * PI * 0.5 * 0.25;
    let (mean, error) = emitted(light, &ctx, 100_000);
    assert!((mean - closed).abs() < SIGMAS * error, "{mean} ± {error}, {closed}");
    assert!((f64::from(light.power().r) / closed - 1.0).abs() < 0.1, "{:?}", light.power());
}

/// One lit texel among a million, missed by the subdivision, still leaves the light a chance; a black texture none.
#[test]
fn a_single_lit_texel_is_not_lost() {
    let d = MaterialDescription {
        emissive_texture: Some(TextureRef { texture: 0, uv_set: 0 }),
        ..MaterialDescription::emitter("", Rgb::splat(4.0))
    };
    for lit in [true, false] {
        let mut image = ImageDescription { name: String::new(), width: 1024, height: 1024, rgba: vec![0; 4 << 20] };
        if lit {
            image.rgba[4 * (301 * 1024 + 205)..][..3].fill(255);
        }
        let texture = TextureDescription { image: 0, wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat, nearest: false };
        let setup =
            Setup { materials: vec![Material::new(&d, 1.0)], textures: Textures::new(vec![texture], vec![image]) };
        let mut t = triangle([Vec3::ZERO, Vec3::X, Vec3::Y]);
        t.uv = [[Vec2::ZERO; 2], [Vec2::X; 2], [Vec2::Y; 2]];
        let lights = Lights::build(&[t], Vec::new(), &setup.ctx());
        assert_eq!(!lights.selector().is_empty(), lit);
    }
}

#[test]
fn nothing_is_nan_at_tiny_distant_and_degenerate_lights() {
    let setup = Setup::new(&MaterialDescription::emitter("", Rgb::splat(1e20)));
    let ctx = setup.ctx();
    let mut shapes = vec![
        triangle([Vec3::ZERO; 3]),
        triangle([Vec3::ZERO, Vec3::X, Vec3::X * 2.0]),
        triangle([Vec3::ZERO, Vec3::X, Vec3::new(0.5, 1e-7, 0.0)]),
    ];
    for size in [1e-20f32, 1e-12, 1e-6, 1.0] {
        shapes.push(triangle([Vec3::ZERO, Vec3::X * size, Vec3::Y * size]));
    }
    let lights = Lights::build(&shapes, Vec::new(), &ctx);
    assert_eq!(lights.selector().pmf(0), 0.0);
    assert_eq!(lights.selector().pmf(1), 0.0);
    let mut s = Stream::new(33, Purpose::Test, 0, 0);
    for light in lights.as_slice() {
        for from in [1e-12f32, 1e-6, 1e-3, 1.0, 1e3].into_iter().flat_map(|d| {
            [Vec3::Z * d, Vec3::new(0.3, 0.3, d), Vec3::new(d, d, 1e-9), Vec3::new(d, 0.0, 0.0), Vec3::ZERO]
        }) {
            for _ in 0..50 {
                if let Some(l) = light.sample_li(&ctx, from, s.next_2d()) {
                    let good = l.pdf > 0.0 && l.pdf.is_finite() && l.wi.is_finite() && l.radiance.is_finite();
                    assert!(good && l.shadow_target.is_finite() && l.distance > 0.0, "{from} {l:?}");
                    let pdf = light.pdf_li(from, l.wi, l.distance);
                    assert!(pdf >= 0.0 && pdf.is_finite(), "{from} {pdf}");
                }
                if let Some(e) = light.sample_le(&ctx, s.next_2d(), s.next_2d()) {
                    assert!(e.power.is_finite() && e.origin.is_finite() && e.direction.is_finite(), "{e:?}");
                }
            }
        }
    }
}

/// Photons start off the light's own plane, on the side they fly to, and shadow rays end before it.
#[test]
fn origins_and_targets_are_off_the_surface() {
    let setup = Setup::new(&MaterialDescription::emitter("", Rgb::WHITE));
    let ctx = setup.ctx();
    let t = triangle([Vec3::new(0.7, 0.1, 1.3), Vec3::new(1.1, -0.6, 1.1), Vec3::new(1.2, 0.9, 0.8)]);
    let lights = Lights::build(&[t], Vec::new(), &ctx);
    let light = &lights.as_slice()[0];
    let n = (t.p[1] - t.p[0]).as_dvec3().cross((t.p[2] - t.p[0]).as_dvec3()).normalize();
    let height = |p: Vec3| (p.as_dvec3() - t.p[0].as_dvec3()).dot(n);
    let from = (t.p[0] + t.p[1] + t.p[2]) / 3.0 + n.as_vec3();
    let mut s = Stream::new(34, Purpose::Test, 0, 0);
    for _ in 0..10_000 {
        let e = light.sample_le(&ctx, s.next_2d(), s.next_2d()).unwrap();
        assert!(height(e.origin) > 0.0 && height(e.origin) < 1e-5);
        let l = light.sample_li(&ctx, from, s.next_2d()).unwrap();
        assert!(height(l.shadow_target) > 0.0 && height(l.shadow_target) < 1e-5);
    }
}

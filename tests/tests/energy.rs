//! Energy, reciprocity and extremes of every material, against closed forms.

use gatherlight_render::material::{Bsdf, Lobes, Scatter, TransportMode};
use gatherlight_render::math::{Purpose, Rgb, Stream, warp};
use gatherlight_render::scene::description::MaterialDescription;
use gatherlight_tests::fixtures;
use glam::Vec3;

use TransportMode::{Importance, Radiance};

/// Standard errors a mean may be off: 4.5 is passed by chance once in 150,000.
const SIGMAS: f64 = 4.5;

fn bsdf(d: &MaterialDescription) -> Bsdf {
    fixtures::bsdf(d, Vec3::Z, Vec3::Z)
}

fn towards(cos: f32) -> Vec3 {
    Vec3::new((1.0 - cos * cos).sqrt(), 0.0, cos)
}

fn dielectric(roughness: f32) -> MaterialDescription {
    MaterialDescription { metallic: 0.0, roughness, ..MaterialDescription::default() }
}

fn glass(roughness: f32, volume: bool) -> MaterialDescription {
    MaterialDescription { roughness, volume, ..MaterialDescription::glass("", 1.5) }
}

/// Every kind of material in white, so that nothing but its lobes' own losses absorbs.
fn white_materials() -> Vec<(String, MaterialDescription)> {
    let mut all = vec![("lambert".to_string(), MaterialDescription::lambert("", Rgb::WHITE))];
    for r in [0.0, 1e-6, 1e-3, 0.05, 0.3, 1.0] {
        all.push((format!("metal {r}"), MaterialDescription::metal("", Rgb::WHITE, r)));
        all.push((format!("coat {r}"), dielectric(r)));
        all.push((format!("half metal {r}"), MaterialDescription { metallic: 0.5, ..dielectric(r) }));
        all.push((format!("dense coat {r}"), MaterialDescription { ior: 3.0, ..dielectric(r) }));
        for volume in [false, true] {
            all.push((format!("glass {r} {volume}"), glass(r, volume)));
            for ior in [1.0, 1.0 + 1e-6, 3.0] {
                all.push((format!("glass {r} {volume} ior {ior}"), MaterialDescription { ior, ..glass(r, volume) }));
            }
            let mix = MaterialDescription { transmission: 0.5, metallic: 0.25, volume, ..dielectric(r) };
            all.push((format!("everything {r} {volume}"), mix));
        }
    }
    all
}

/// Mean and standard error of the sampled weight's red channel.
fn mean_weight(b: &Bsdf, wo: Vec3, mode: TransportMode, count: usize) -> (f64, f64) {
    let mut s = Stream::new(21, Purpose::Test, 0, 0);
    let (mut sum, mut square) = (0.0f64, 0.0f64);
    for _ in 0..count {
        let [u0, u1] = s.next_2d();
        let w = b.sample(wo, [u0, u1, s.next_f32()], Lobes::ALL, mode).map_or(0.0, |x| f64::from(x.weight.r));
        sum += w;
        square += w * w;
    }
    let n = count as f64;
    let mean = sum / n;
    (mean, ((square / n - mean * mean).max(0.0) / n).sqrt())
}

#[test]
fn nothing_reflects_more_than_it_receives() {
    for (name, d) in white_materials() {
        let b = bsdf(&d);
        for cos in [1.0, 0.7, 0.2, 0.01, -0.4] {
            let (mean, error) = mean_weight(&b, towards(cos), Importance, 20_000);
            // 2e-3: interpolation of the coat's albedo table.
            assert!(mean <= 1.0 + SIGMAS * error + 2e-3, "{name}, cos {cos}: {mean} ± {error}");
        }
    }
}

/// White surfaces without microfacet losses send everything on, whatever the angle.
#[test]
fn white_furnace() {
    let smooth = [
        MaterialDescription::lambert("", Rgb::WHITE),
        MaterialDescription::metal("", Rgb::WHITE, 0.0),
        dielectric(0.0),
        MaterialDescription { ior: 3.0, ..dielectric(0.0) },
        glass(0.0, true),
        glass(0.0, false),
        MaterialDescription { transmission: 0.5, metallic: 0.25, ..dielectric(0.0) },
    ];
    for (i, d) in smooth.iter().enumerate() {
        for cos in [1.0, 0.7, 0.2, 0.01, -0.4, -0.9] {
            let (mean, error) = mean_weight(&bsdf(d), towards(cos), Importance, 20_000);
            assert!((mean - 1.0).abs() <= SIGMAS * error + 1e-5, "{i}, cos {cos}: {mean} ± {error}");
        }
    }
    // A rough coat gives the base what its own facets lose: still white but for the table's interpolation.
    for roughness in [0.1, 0.37, 0.8] {
        for cos in [1.0, 0.7, 0.2] {
            let (mean, error) = mean_weight(&bsdf(&dielectric(roughness)), towards(cos), Importance, 100_000);
            assert!((mean - 1.0).abs() <= SIGMAS * error + 2e-3, "coat {roughness}, cos {cos}: {mean} ± {error}");
        }
    }
}

/// Radiance is divided by η² when it crosses, power is not: means R + (1 − R)/η² and 1.
#[test]
fn refraction_scales_radiance_and_not_power() {
    let r = 0.04f64;
    for (wo, eta) in [(Vec3::Z, 1.5f64), (-Vec3::Z, 1.0 / 1.5)] {
        let (mean, error) = mean_weight(&bsdf(&glass(0.0, true)), wo, Radiance, 50_000);
        let expected = r + (1.0 - r) / (eta * eta);
        assert!((mean - expected).abs() < SIGMAS * error + 1e-5, "{mean} ± {error}, expected {expected}");
    }
}

/// f(wo, wi) in one mode is f(wi, wo) in the other (Veach 1997, eq. 5.14 with 3.19), so reflection is symmetric and
/// transmission symmetric but for η².
#[test]
fn scattering_is_reciprocal() {
    let mut s = Stream::new(22, Purpose::Test, 0, 0);
    for (name, d) in white_materials() {
        let b = bsdf(&d);
        if !b.lobes().intersects(Lobes::NON_DIRAC) || d.roughness < 0.05 && d.specular > 0.0 {
            continue;
        }
        for _ in 0..5000 {
            let (wo, wi) = (warp::uniform_sphere(s.next_2d()), warp::uniform_sphere(s.next_2d()));
            let (f, g) = (b.eval(wo, wi, Lobes::ALL, Radiance).r, b.eval(wi, wo, Lobes::ALL, Importance).r);
            assert!((f - g).abs() <= 1e-3 * f.max(g) + 2e-6, "{name} {wo} {wi}: {f} {g}");
            if wo.z * wi.z > 0.0 {
                let h = b.eval(wi, wo, Lobes::ALL, Radiance).r;
                assert!((f - h).abs() <= 1e-3 * f.max(h) + 1e-7, "{name}: {f} {h}");
            }
        }
    }
}

/// Unpolarised Fresnel reflectance in f64, from the angles.
fn fresnel(cos_i: f64, eta: f64) -> f64 {
    let cos_t = (1.0 - (1.0 - cos_i * cos_i) / (eta * eta)).sqrt();
    let s = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
    let p = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
    0.5 * (s * s + p * p)
}

/// A plane-parallel slab transmits (1 − R)/(1 + R), all internal reflections included: in closed form as a thin wall,
/// and by walking between the faces of a solid one.
#[test]
fn a_slab_transmits_by_its_closed_form() {
    for ior in [1.1f32, 1.5, 3.0] {
        for cos in [1.0f32, 0.6, 0.2] {
            let r = fresnel(f64::from(cos), f64::from(ior));
            let expected = (1.0 - r) / (1.0 + r);
            let wo = towards(cos);
            let thin = bsdf(&MaterialDescription { ior, ..glass(0.0, false) });
            let x = thin.sample(wo, [0.5, 0.5, 0.999_999], Lobes::ALL, Radiance).unwrap();
            assert!(x.transmitted && (x.wi + wo).length() < 1e-6);
            assert!((f64::from(x.weight.r * x.pdf) - expected).abs() < 1e-5, "{ior} {cos}");

            let solid = bsdf(&MaterialDescription { ior, ..glass(0.0, true) });
            let mut s = Stream::new(23, Purpose::Test, 0, 0);
            let (n, mut through) = (100_000, 0);
            for _ in 0..n {
                // Both faces have their outside at +z of their own frame; the lower one is seen upside down.
                let (mut w, mut lower, mut inside) = (wo, false, false);
                loop {
                    let x = solid.sample(w, [0.5, 0.5, s.next_f32()], Lobes::ALL, Importance).unwrap();
                    assert!((x.weight.r - 1.0).abs() < 1e-5);
                    if inside && x.transmitted || !inside && !x.transmitted {
                        through += usize::from(inside && lower);
                        break;
                    }
                    // It crosses the slab; in the frame of the face it reaches it comes from the inside again.
                    inside = true;
                    lower = !lower;
                    w = Vec3::new(-x.wi.x, -x.wi.y, x.wi.z);
                }
            }
            let p = f64::from(through as u32) / f64::from(n as u32);
            let error = (expected * (1.0 - expected) / f64::from(n as u32)).sqrt();
            assert!((p - expected).abs() < SIGMAS * error + 1e-6, "{ior} {cos}: {p} {expected}");
        }
    }
}

#[test]
fn everything_stays_finite_at_the_extremes() {
    let mut s = Stream::new(24, Purpose::Test, 0, 0);
    for (name, white) in white_materials() {
        for base_color in [Rgb::WHITE, Rgb::BLACK, Rgb::new(1e-20, 0.0, 1.0)] {
            let d = MaterialDescription { base_color, ..white.clone() };
            let b = bsdf(&d);
            for cos in [1.0, 0.5, 1e-3, 1e-7, 1e-20, 0.0, -1e-20, -1e-7, -0.5, -1.0] {
                let wo = towards(cos);
                for k in 0..200 {
                    let mode = if k % 2 == 0 { Radiance } else { Importance };
                    let [u0, u1] = if k < 8 { [0.999_999_94 * (k & 1) as f32, 0.0] } else { s.next_2d() };
                    let u = [u0, u1, s.next_f32()];
                    let wi = match b.sample(wo, u, Lobes::ALL, mode) {
                        None => warp::uniform_sphere(s.next_2d()),
                        Some(x) => {
                            let good = x.weight.is_finite() && x.weight.r >= 0.0 && x.pdf.is_finite() && x.pdf > 0.0;
                            assert!(good && x.wi.is_finite(), "{name} {cos} {x:?}");
                            x.wi
                        }
                    };
                    let (f, pdf) = (b.eval(wo, wi, Lobes::ALL, mode), b.pdf(wo, wi, Lobes::ALL, mode));
                    assert!(f.is_finite() && f.r >= 0.0 && pdf.is_finite() && pdf >= 0.0, "{name} {cos}: {f:?} {pdf}");
                    assert!(b.albedo(wo).is_finite() && b.importance_correction(wo, wi).is_finite());
                }
            }
        }
    }
}

/// The albedos that roulette uses are those that sampling finds.
#[test]
fn roulette_albedos_match_the_samples() {
    for d in [
        MaterialDescription::lambert("", Rgb::splat(0.7)),
        MaterialDescription::metal("", Rgb::splat(0.6), 0.0),
        MaterialDescription::metal("", Rgb::splat(0.6), 0.6),
        MaterialDescription { base_color: Rgb::splat(0.5), ..dielectric(0.4) },
        MaterialDescription { base_color: Rgb::splat(0.5), ..glass(0.0, true) },
    ] {
        let b = bsdf(&d);
        for cos in [1.0, 0.5, 0.15, -0.6] {
            let wo = towards(cos);
            let (mean, error) = mean_weight(&b, wo, Importance, 100_000);
            let (diffuse, rest) = b.roulette_albedos(wo);
            let albedo = f64::from(diffuse.r + rest.r);
            assert!((mean - albedo).abs() < SIGMAS * error + 2e-3, "{d:?} cos {cos}: {mean} ± {error}, {albedo}");
        }
    }
}

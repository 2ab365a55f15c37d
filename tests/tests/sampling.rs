//! Every sampling routine of materials and lights against its pdf, by chi².

use gatherlight_render::light::{
    DirectionalLight, EmissiveTriangle, Light, LightContext, Lights, PointLight, SpotLight,
};
use gatherlight_render::material::{Bsdf, Lobes, Material, Scatter, Textures, TransportMode};
use gatherlight_render::math::{Purpose, Rgb, Stream};
use gatherlight_render::scene::description::MaterialDescription;
use gatherlight_tests::chi_square::{SphereGrid, chi_square, sidak, test_directions};
use gatherlight_tests::fixtures::bsdf;
use glam::{Vec2, Vec3};

/// Probability that any of the tests of this file fails although all is well.
const SIGNIFICANCE: f64 = 0.01;
/// An upper bound on the number of tests that share it.
const TESTS: usize = 1000;
const SAMPLES: usize = 100_000;
const MODES: [TransportMode; 2] = [TransportMode::Radiance, TransportMode::Importance];

/// One of each combination of lobes, rough enough that f32 directions resolve the density well.
fn materials() -> Vec<(String, MaterialDescription)> {
    let color = Rgb::new(0.8, 0.5, 0.2);
    let glass = |roughness, volume| MaterialDescription { roughness, volume, ..MaterialDescription::glass("", 1.5) };
    let dielectric = |roughness| MaterialDescription {
        metallic: 0.0,
        base_color: color,
        roughness,
        ..MaterialDescription::default()
    };
    let mut all = vec![("lambert".to_string(), MaterialDescription::lambert("", color))];
    for r in [0.03, 0.1, 0.4, 1.0] {
        all.push((format!("metal {r}"), MaterialDescription::metal("", color, r)));
        all.push((format!("glass {r}"), glass(r, true)));
        all.push((format!("thin glass {r}"), glass(r, false)));
        all.push((format!("coat {r}"), dielectric(r)));
    }
    all.push(("smooth coat".into(), dielectric(0.0)));
    all.push(("half metal".into(), MaterialDescription { metallic: 0.5, ..dielectric(0.3) }));
    all.push(("smooth half metal".into(), MaterialDescription { metallic: 0.5, ..dielectric(0.0) }));
    for volume in [false, true] {
        let d = MaterialDescription { transmission: 0.5, metallic: 0.25, volume, ..dielectric(0.3) };
        all.push((format!("everything, volume {volume}"), d.clone()));
        all.push((format!("smooth everything, volume {volume}"), MaterialDescription { roughness: 0.0, ..d }));
    }
    all.push(("dense glass".into(), MaterialDescription { ior: 3.0, ..glass(0.3, true) }));
    all.push(("air".into(), MaterialDescription { ior: 1.0, ..glass(0.3, true) }));
    all
}

/// Where the density of reflection or transmission peaks, and how narrow it is there.
fn grid_for(b: &Bsdf, wo: Vec3, d: &MaterialDescription, transmitted: bool) -> SphereGrid {
    let n = b.shading_normal() * b.shading_normal().dot(wo).signum();
    let cos_o = wo.dot(n);
    let axis = if !transmitted {
        n * (2.0 * cos_o) - wo
    } else if !d.volume {
        -wo
    } else {
        // Snell's law; at total internal reflection along the surface.
        let eta = if wo.z > 0.0 { d.ior } else { 1.0 / d.ior };
        let cos_t = (1.0 - (1.0 - cos_o * cos_o) / (eta * eta)).max(0.0).sqrt();
        n * (cos_o / eta - cos_t) - wo / eta
    };
    let alpha = d.roughness * d.roughness;
    let narrow = b.lobes().contains(Lobes::GLOSSY) && alpha < 0.2;
    if narrow { SphereGrid::new(axis, f64::from(alpha), 20, 12) } else { SphereGrid::new(n, 1.0, 16, 16) }
}

fn check_bsdf(name: &str, d: &MaterialDescription, ng: Vec3, ns: Vec3, wo: Vec3, lobes: Lobes, mode: TransportMode) {
    let b = bsdf(d, ng, ns);
    if !b.lobes().intersects(lobes.intersection(Lobes::NON_DIRAC)) {
        return;
    }
    let sides: &[bool] = if d.transmission > 0.0 { &[false, true] } else { &[false] };
    for &transmitted in sides {
        let mut s = Stream::new(11, Purpose::Test, 0, 0);
        let r = test_directions(
            &grid_for(&b, wo, d, transmitted),
            SAMPLES,
            || {
                let [u0, u1] = s.next_2d();
                let sample = b.sample(wo, [u0, u1, s.next_f32()], lobes, mode)?;
                // A Dirac direction is a failure as far as the solid-angle pdf is concerned.
                (!sample.is_specular() && sample.transmitted == transmitted).then_some(sample.wi)
            },
            |wi| {
                let crosses = (wo.dot(ng) > 0.0) != (wi.dot(ng) > 0.0);
                if crosses == transmitted { f64::from(b.pdf(wo, wi, lobes, mode)) } else { 0.0 }
            },
        );
        let limit = sidak(SIGNIFICANCE, TESTS);
        assert!(r.p_value > limit, "{name}, {mode:?}, {lobes:?}, wo {wo}, ns {ns}, {transmitted}: {r:?}");
    }
}

#[test]
fn bsdf_directions_follow_their_pdf() {
    let z = Vec3::Z;
    for (name, d) in materials() {
        for wo in
            [Vec3::new(0.0, 0.0, 1.0), Vec3::new(0.6, 0.3, 0.5), Vec3::new(-0.9, 0.3, 0.1), Vec3::new(0.3, -0.5, -0.7)]
        {
            for mode in MODES {
                check_bsdf(&name, &d, z, z, wo.normalize(), Lobes::ALL, mode);
            }
        }
    }
}

#[test]
fn subsets_of_lobes_follow_their_pdf() {
    let wo = Vec3::new(0.6, 0.3, 0.5).normalize();
    for (name, d) in materials() {
        for lobes in [Lobes::DIFFUSE, Lobes::GLOSSY] {
            check_bsdf(&name, &d, Vec3::Z, Vec3::Z, wo, lobes, TransportMode::Radiance);
        }
    }
}

#[test]
fn tilted_shading_normals_follow_their_pdf() {
    let ns = Vec3::new(0.5, 0.2, 0.7).normalize();
    for (name, d) in materials() {
        // The last is above the surface and below the shading normal's horizon.
        for wo in [Vec3::new(0.1, 0.3, 0.8), Vec3::new(-0.3, 0.8, -0.6), Vec3::new(-0.9, -0.3, 0.2)] {
            for mode in MODES {
                check_bsdf(&name, &d, Vec3::Z, ns, wo.normalize(), Lobes::ALL, mode);
            }
        }
    }
}

/// The weight is f·cos/pdf, the pdf that of `pdf`, and the direction on the side it claims.
#[test]
fn samples_agree_with_eval_and_pdf() {
    let mut s = Stream::new(12, Purpose::Test, 0, 0);
    for (name, d) in materials() {
        for ns in [Vec3::Z, Vec3::new(0.5, 0.2, 0.7).normalize()] {
            let b = bsdf(&d, Vec3::Z, ns);
            for k in 0..4000 {
                let mode = MODES[k % 2];
                let wo = gatherlight_render::math::warp::uniform_sphere(s.next_2d());
                let [u0, u1] = s.next_2d();
                let Some(x) = b.sample(wo, [u0, u1, s.next_f32()], Lobes::ALL, mode) else { continue };
                assert!(
                    (x.wi.length() - 1.0).abs() < 1e-5 && x.weight.is_finite() && x.pdf.is_finite(),
                    "{name} {x:?}"
                );
                assert_eq!((wo.z > 0.0) != (x.wi.z > 0.0), x.transmitted, "{name}");
                if x.is_specular() {
                    continue;
                }
                let pdf = b.pdf(wo, x.wi, Lobes::ALL, mode);
                assert!((pdf / x.pdf - 1.0).abs() < 1e-4, "{name}: {pdf} {}", x.pdf);
                let w = b.eval(wo, x.wi, Lobes::ALL, mode) * (b.cos(x.wi) / x.pdf);
                for k in 0..3 {
                    assert!((w[k] - x.weight[k]).abs() <= 1e-4 * x.weight[k], "{name}: {w:?} {:?}", x.weight);
                }
            }
        }
    }
}

fn emitter(p: [Vec3; 3]) -> EmissiveTriangle {
    EmissiveTriangle { p, uv: [[Vec2::ZERO; 2]; 3], color: [[1.0; 4]; 3], material: 0, instance: 0, triangle: 0 }
}

/// Sub-triangles along an edge: cells of the test below.
const CELLS: usize = 8;

/// The cell that holds the point of the triangle in direction `w`.
fn triangle_cell(p: [Vec3; 3], from: Vec3, w: Vec3) -> usize {
    let [p0, p1, p2] = p.map(|v| v.as_dvec3());
    let (w, e1, e2, s) = (w.as_dvec3(), p1 - p0, p2 - p0, from.as_dvec3() - p0);
    let det = e1.dot(w.cross(e2));
    let b = [s.dot(w.cross(e2)) / det, w.dot(s.cross(e1)) / det].map(|v| v.clamp(0.0, 1.0) * CELLS as f64);
    let (i, j) = ((b[0] as usize).min(CELLS - 1), (b[1] as usize).min(CELLS - 1));
    // Rounding may carry a point over the hypotenuse.
    let (i, j) = if i + j >= CELLS { (i, CELLS - 1 - i) } else { (i, j) };
    let inverted = b[0] - i as f64 + b[1] - j as f64 > 1.0 && i + j + 1 < CELLS;
    2 * (i * CELLS + j) + usize::from(inverted)
}

/// Probability of each cell: ∫ pdf·cosθ/d² dA by a fine midpoint rule.
fn triangle_expectation(p: [Vec3; 3], from: Vec3, light: &Light) -> Vec<f64> {
    const FINE: usize = CELLS * 32;
    let e = p.map(|v| v.as_dvec3());
    let cross = (e[1] - e[0]).cross(e[2] - e[0]);
    let (area, normal) = (0.5 * cross.length(), cross.normalize());
    let mut expected = vec![0.0; 2 * CELLS * CELLS];
    for i in 0..FINE {
        for j in 0..FINE - i {
            for shift in if i + j + 1 < FINE { &[1.0, 2.0][..] } else { &[1.0] } {
                let b1 = (i as f64 + shift / 3.0) / FINE as f64;
                let b2 = (j as f64 + shift / 3.0) / FINE as f64;
                let d = e[0] + (e[1] - e[0]) * b1 + (e[2] - e[0]) * b2 - from.as_dvec3();
                let w = d.normalize();
                let pdf = f64::from(light.pdf_li(from, w.as_vec3(), d.length() as f32));
                expected[triangle_cell(p, from, w.as_vec3())] +=
                    pdf * w.dot(normal).abs() / d.length_squared() * area / (FINE * FINE) as f64;
            }
        }
    }
    expected
}

#[test]
fn directions_to_triangles_follow_their_pdf() {
    let triangles = [
        [Vec3::new(-0.5, -0.4, 0.0), Vec3::new(0.6, -0.3, 0.1), Vec3::new(0.1, 0.7, -0.1)],
        [Vec3::new(-1.0, 0.0, 0.0), Vec3::new(1.0, 0.02, 0.0), Vec3::new(0.9, 0.05, 0.0)],
    ];
    let near = [Vec3::new(0.1, 0.0, 0.5), Vec3::new(0.3, 0.2, 0.02), Vec3::new(2.0, -1.0, 1.5)];
    let far = [Vec3::new(3.0, 9.0, 40.0), Vec3::new(0.3, -0.1, -0.4)];
    let textures = Textures::default();
    for double_sided in [false, true] {
        let d = MaterialDescription { double_sided, ..MaterialDescription::emitter("", Rgb::WHITE) };
        let materials = [Material::new(&d, 1.0)];
        let ctx = LightContext { materials: &materials, textures: &textures };
        for p in triangles {
            let lights = Lights::build(&[emitter(p)], Vec::new(), &ctx);
            let light = &lights.as_slice()[0];
            for from in near.into_iter().chain(far) {
                let mut s = Stream::new(13, Purpose::Test, 0, 0);
                let mut expected = triangle_expectation(p, from, light);
                let mut observed = vec![0.0; expected.len()];
                let mut failures = 0;
                for _ in 0..SAMPLES {
                    let Some(x) = light.sample_li(&ctx, from, s.next_2d()) else {
                        failures += 1;
                        continue;
                    };
                    let pdf = light.pdf_li(from, x.wi, x.distance);
                    assert!((pdf / x.pdf - 1.0).abs() < 1e-3, "{pdf} {}", x.pdf);
                    observed[triangle_cell(p, from, x.wi)] += 1.0;
                }
                let total: f64 = expected.iter().sum();
                if !double_sided && from.z < 0.0 {
                    assert_eq!((total, failures), (0.0, SAMPLES));
                    continue;
                }
                assert!((total - 1.0).abs() < 2e-3 && failures == 0, "from {from}: {total}, {failures} failures");
                expected.iter_mut().for_each(|e| *e *= SAMPLES as f64 / total);
                let r = chi_square(&observed, &expected);
                assert!(r.p_value > sidak(SIGNIFICANCE, TESTS), "{p:?} from {from}: {r:?}");
            }
        }
    }
}

#[test]
fn emitted_directions_follow_their_pdf() {
    let textures = Textures::default();
    let one_sided = MaterialDescription::emitter("", Rgb::WHITE);
    let two_sided = MaterialDescription { double_sided: true, ..one_sided.clone() };
    let materials = [Material::new(&one_sided, 1.0), Material::new(&two_sided, 1.0)];
    let ctx = LightContext { materials: &materials, textures: &textures };
    let p = [Vec3::new(-0.5, -0.4, 0.0), Vec3::new(0.6, -0.3, 0.1), Vec3::new(0.1, 0.7, -0.1)];
    let axis = Vec3::new(0.2, -0.5, 0.8).normalize();
    let spot = |inner: f64, outer: f64| {
        Light::Spot(SpotLight::new(Vec3::ONE, axis, Rgb::WHITE, inner.to_radians(), outer.to_radians()))
    };
    let punctual = vec![
        Light::Point(PointLight { position: Vec3::ONE, intensity: Rgb::WHITE }),
        spot(0.0, 90.0),
        spot(20.0, 45.0),
        spot(0.0, 1.0),
        spot(0.9, 1.0),
    ];
    let scales = [1.0, 1.0, 1.0, 1.0, 0.4, 0.006, 0.006];
    let lights = Lights::build(&[emitter(p), EmissiveTriangle { material: 1, ..emitter(p) }], punctual, &ctx);
    for (i, (light, scale)) in lights.as_slice().iter().zip(scales).enumerate() {
        let mut s = Stream::new(14, Purpose::Test, 0, 0);
        let point = light.sample_point(&ctx, [0.3, 0.4]).unwrap();
        let r = test_directions(
            &SphereGrid::new(point.normal.unwrap_or(axis), scale, 32, 16),
            SAMPLES,
            || {
                let x = light.sample_le(&ctx, s.next_2d(), s.next_2d())?;
                let pdf = light.pdf_direction(&point, x.direction);
                // The tiniest falloff is a difference of cosines: compare with the mean density.
                assert!(
                    (pdf - x.pdf_direction).abs() <= 1e-3 * (pdf + (1.0 / (scale * scale)) as f32),
                    "{i}: {pdf} {}",
                    x.pdf_direction
                );
                Some(x.direction)
            },
            |w| f64::from(light.pdf_direction(&point, w)),
        );
        assert!(r.p_value > sidak(SIGNIFICANCE, TESTS), "light {i}: {r:?}");
    }
}

/// Points on a triangle and on a directional light's disc: equal counts in cells of equal area.
#[test]
fn emitted_positions_are_uniform() {
    let textures = Textures::default();
    let materials = [Material::new(&MaterialDescription::emitter("", Rgb::WHITE), 1.0)];
    let ctx = LightContext { materials: &materials, textures: &textures };
    let lights = Lights::build(&[emitter([Vec3::ZERO, Vec3::X * 2.0, Vec3::Y])], Vec::new(), &ctx);
    let mut s = Stream::new(15, Purpose::Test, 0, 0);
    // Strips of equal area parallel to one edge, and to the other.
    let mut strips = [[0.0; 40]; 2];
    for _ in 0..SAMPLES {
        let x = lights.as_slice()[0].sample_le(&ctx, s.next_2d(), s.next_2d()).unwrap();
        for (strip, c) in strips.iter_mut().zip([x.origin.x / 2.0, x.origin.y]) {
            let below = 1.0 - (1.0 - c) * (1.0 - c);
            strip[((below * 40.0) as usize).min(39)] += 1.0;
        }
    }
    let sun =
        DirectionalLight { direction: -Vec3::Z, irradiance: Rgb::WHITE, scene_center: Vec3::ZERO, scene_radius: 1.5 };
    let mut rings = [0.0; 40];
    for _ in 0..SAMPLES {
        let o = sun.sample_le(s.next_2d()).origin;
        rings[(((o.x * o.x + o.y * o.y) / 2.25 * 40.0) as usize).min(39)] += 1.0;
        assert!(o.z > 1.5);
    }
    for counts in [strips[0], strips[1], rings] {
        let r = chi_square(&counts, &[SAMPLES as f64 / 40.0; 40]);
        assert!(r.p_value > sidak(SIGNIFICANCE, TESTS), "{r:?}");
    }
}

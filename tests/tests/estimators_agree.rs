//! Photon mapping and path tracing are two estimators of the same light: they agree within their joint standard error.

use gatherlight_render::film::Film;
use gatherlight_render::math::Rgb;
use gatherlight_render::scene::description::{MaterialDescription, SceneDescription};
use gatherlight_render::settings::{Estimator, Layer, Method, RenderSettings};
use gatherlight_tests::fixtures::{SceneMaker, cuboid, lamp_in_glass, quad, sphere};
use gatherlight_tests::single::render_description;
use glam::{DVec3, Vec3};

const SIDE: u32 = 24;
const BLOCK: u32 = 6;
const SEEDS: u64 = 12;

/// Means of the image's blocks, one row a seed.
fn block_means(scene: &SceneDescription, settings: &RenderSettings) -> Vec<Vec<f64>> {
    (0..SEEDS)
        .map(|seed| blocks(&render_description(scene.clone(), &RenderSettings { seed, ..settings.clone() })))
        .collect()
}

fn blocks(film: &Film) -> Vec<f64> {
    let per_side = SIDE / BLOCK;
    let mut sums = vec![0.0; (per_side * per_side) as usize];
    for y in 0..SIDE {
        for x in 0..SIDE {
            let p = film.pixel(x, y);
            let sum: f64 = p[..3].iter().map(|&v| f64::from(v)).sum();
            sums[(y / BLOCK * per_side + x / BLOCK) as usize] += sum;
        }
    }
    sums.iter().map(|s| s / f64::from(3 * BLOCK * BLOCK)).collect()
}

/// Mean and squared standard error of column `i`.
fn column(rows: &[Vec<f64>], i: usize) -> (f64, f64) {
    let n = rows.len() as f64;
    let mean = rows.iter().map(|r| r[i]).sum::<f64>() / n;
    let variance = rows.iter().map(|r| (r[i] - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, variance / n)
}

fn base() -> RenderSettings {
    RenderSettings { width: SIDE, height: SIDE, ..Default::default() }
}

/// z-test per block. With 16 blocks and 11 degrees of freedom a side, |t| < 4.6 holds for all blocks with probability
/// above 0.999 when the means are equal (Šidák); `bias` is the density estimate's share, on top.
fn assert_agree(name: &str, scene: &SceneDescription, photon: &RenderSettings, path: &RenderSettings, bias: f64) {
    let (a, b) = (block_means(scene, photon), block_means(scene, path));
    for i in 0..a[0].len() {
        let ((ma, va), (mb, vb)) = (column(&a, i), column(&b, i));
        let sigma = (va + vb).sqrt();
        println!(
            "{name}, block {i}: photon {ma:.5}, path {mb:.5}, {:+.2} σ (σ = {:.2} %)",
            (ma - mb) / sigma,
            100.0 * sigma / mb
        );
        assert!(
            (ma - mb).abs() < 4.6 * sigma + bias * mb,
            "{name}, block {i}: photon {ma} and path {mb} differ by {:.1} σ",
            (ma - mb).abs() / sigma
        );
        assert!(sigma < 0.03 * mb, "{name}, block {i}: too noisy to see anything ({sigma} of {mb})");
    }
}

#[test]
fn a_room_lit_through_glass() {
    let photon = RenderSettings { samples: 16, photons: 200_000, caustic_photons: 400_000, ..base() };
    let path = RenderSettings { method: Method::Path, samples: 256, ..base() };
    assert_agree("lamp in glass", &lamp_in_glass(), &photon, &path, 0.0);
}

/// Rough gold, a coated floor and a glossy mirror: every lobe, lit by a lamp that both methods find easily.
fn glossy_room() -> SceneDescription {
    let mut s = SceneMaker::new();
    let wall = s.material(MaterialDescription::lambert("wall", Rgb::new(0.6, 0.5, 0.4)));
    let coated = s.material(MaterialDescription {
        base_color: Rgb::new(0.3, 0.5, 0.6),
        metallic: 0.0,
        roughness: 0.4,
        ..Default::default()
    });
    let gold = s.material(MaterialDescription::metal("gold", Rgb::new(1.0, 0.77, 0.34), 0.5));
    let half = s.material(MaterialDescription { metallic: 0.5, roughness: 0.6, ..Default::default() });
    let lamp = s.material(MaterialDescription::emitter("lamp", Rgb::splat(5.0)));
    s.mesh(cuboid(Vec3::splat(-1.0), Vec3::splat(1.0), true, wall));
    s.mesh(quad(Vec3::new(-0.99, -0.98, 0.99), Vec3::X * 1.98, Vec3::Z * -1.98, coated));
    s.mesh(quad(Vec3::new(-0.5, 0.98, -0.5), Vec3::X, Vec3::Z, lamp));
    s.mesh(sphere(Vec3::new(-0.4, -0.6, -0.2), 0.35, 3, true, false, gold));
    s.mesh(cuboid(Vec3::new(0.2, -0.98, -0.5), Vec3::new(0.6, -0.3, 0.0), false, half));
    s.camera(DVec3::new(0.0, 0.0, 0.95), DVec3::new(0.0, -0.3, 0.0), 1.3);
    s.scene
}

#[test]
fn a_room_of_glossy_surfaces() {
    let photon = RenderSettings { samples: 16, photons: 200_000, caustic_photons: 400_000, ..base() };
    let path = RenderSettings { method: Method::Path, samples: 256, ..base() };
    assert_agree("glossy room", &glossy_room(), &photon, &path, 0.005);
}

/// The parts of light are the same for both methods, layer by layer.
#[test]
fn layers_hold_the_same_light() {
    let layers = vec![Layer::Direct, Layer::Indirect, Layer::Caustic];
    let mean = |method, samples| {
        let settings = RenderSettings {
            method,
            samples,
            layers: layers.clone(),
            photons: 200_000,
            caustic_photons: 400_000,
            ..base()
        };
        let film = render_description(lamp_in_glass(), &settings);
        let n = film.channels.len();
        let count = (film.pixels.len() / n) as f64;
        [4, 7, 10].map(|at| film.pixels.chunks_exact(n).map(|p| f64::from(p[at + 1])).sum::<f64>() / count)
    };
    let (photon, path) = (mean(Method::Photon, 16), mean(Method::Path, 512));
    for ((layer, a), b) in layers.iter().zip(photon).zip(path) {
        assert!((a / b - 1.0).abs() < 0.02, "{}: photon {a}, path {b}", layer.name());
    }
}

/// The hash grid with its fixed radius estimates the same light as k nearest neighbours.
#[test]
fn hash_grid_and_kd_tree_agree() {
    let mean = |estimator| {
        let settings = RenderSettings {
            estimator,
            samples: 8,
            photons: 200_000,
            caustic_photons: 200_000,
            final_gather: 2,
            ..base()
        };
        gatherlight_tests::single::mean(&render_description(lamp_in_glass(), &settings))[1]
    };
    let (tree, hash) = (mean(Estimator::KdTree), mean(Estimator::Hash));
    assert!(tree != hash, "the estimator has no effect");
    assert!((tree / hash - 1.0).abs() < 0.01, "k-d tree {tree}, hash grid {hash}");
}

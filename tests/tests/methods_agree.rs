//! All consistent methods see the same light: on every scene, every pair of methods, over independent seeds, in blocks of
//! the image and in the whole.
//!
//! What may differ is stated, not tolerated. A method that estimates density within a radius r is biased by c·rᵖ: p = 2 inside
//! smooth light on flat surfaces (the estimate's second moment; Silverman 1986, §4.2), p = 1 where a rim of surface or shadow
//! cuts the disc. Two renders with radii r and r/2 and means C and F therefore put the limit between F − (C − F)/3 (p = 2) and
//! F − (C − F) (p = 1), and two methods agree when these intervals do, within the noise of Welch's t-test. Where there is no
//! bias, the interval is a point and no slack is given.

use gatherlight_render::film::Film;
use gatherlight_render::import;
use gatherlight_render::scene::description::SceneDescription;
use gatherlight_render::settings::{Method, RenderSettings};
use gatherlight_tests::chi_square::sidak;
use gatherlight_tests::scene;
use gatherlight_tests::single::render_description;
use gatherlight_tests::welch::Mean;

const WIDTH: u32 = 24;
const HEIGHT: u32 = 18;
const BLOCK: u32 = 6;
/// Regions of an image: its blocks, and last the whole.
const REGIONS: usize = (WIDTH / BLOCK * (HEIGHT / BLOCK)) as usize + 1;
const SEEDS: u64 = 8;
/// Probability that one scene's test fails although all methods are right.
const SIGNIFICANCE: f64 = 1e-3;
/// What Markov chains add to the noise that is allowed: their samples hang together, and a rare bright path that no bootstrap
/// path met is missing from the whole image. They need many more mutations than a test has for what the others see at once.
const CHAIN_NOISE: f64 = 0.12;

/// A scene and the work that makes it tell methods apart.
struct Case {
    file: &'static str,
    /// Camera paths a pixel.
    samples: u32,
    /// First gather radius in metres.
    radius: f32,
    /// Multiple of the usual number of photons.
    photons: u64,
    /// Noise of the difference of two methods, as a share of the light in the middle one of the regions, above which the test
    /// would not be worth its name.
    noise: f64,
    /// Methods that cannot show this scene's light in bounded work, and why.
    fails: &'static [(Method, &'static str)],
}

impl Case {
    fn excuse(&self, method: Method) -> Option<&'static str> {
        self.fails.iter().find(|(m, _)| *m == method).map(|(_, why)| *why)
    }

    /// Most noise of the difference of two methods.
    fn allowed_noise(&self, methods: [Method; 2]) -> f64 {
        self.noise + if methods.contains(&Method::Mlt) { CHAIN_NOISE } else { 0.0 }
    }
}

/// Whether `method` reads densities within a radius, and is biased while it is not 0.
fn has_radius(method: Method) -> bool {
    matches!(method, Method::Photon | Method::Progressive | Method::Vcm)
}

/// Settings of `method`; `fine` halves the radius of a density estimate, with four times the photons.
fn settings(case: &Case, method: Method, fine: bool) -> RenderSettings {
    let more = if fine { 4 } else { 1 };
    let base = RenderSettings { method, width: WIDTH, height: HEIGHT, ..Default::default() };
    // Enough to see that an excuse is needed.
    let s = if case.excuse(method).is_some() { case.samples / 4 } else { case.samples };
    match method {
        Method::Whitted | Method::Path => RenderSettings { samples: s, ..base },
        Method::Bdpt => RenderSettings { samples: (s / 4).max(1), ..base },
        Method::Mlt => RenderSettings { mutations: (s / 2).max(1), chains: 64, bootstrap: 65_536, ..base },
        // k stays: the radius of k photons halves by itself, and so does the bound on it.
        Method::Photon => RenderSettings {
            samples: (s / 4).max(1),
            final_gather: 1,
            photons: 10_000 * case.photons * more,
            caustic_photons: 20_000 * case.photons * more,
            k: 30,
            ..base
        },
        Method::Progressive | Method::Vcm => {
            let max_radius = Some(if fine { 0.5 * case.radius } else { case.radius });
            let photons = 20_000 * case.photons * more;
            RenderSettings { rounds: (s / 2).max(1), photons, caustic_photons: photons, max_radius, ..base }
        }
    }
}

/// Mean of red, green and blue in each region.
fn regions(film: &Film) -> [f64; REGIONS] {
    let mut means = [0.0; REGIONS];
    let share = f64::from(3 * BLOCK * BLOCK);
    for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
        let value: f64 = film.pixel(x, y)[..3].iter().map(|&v| f64::from(v)).sum();
        means[(y / BLOCK * (WIDTH / BLOCK) + x / BLOCK) as usize] += value / share;
        means[REGIONS - 1] += value / (share * (REGIONS - 1) as f64);
    }
    means
}

/// What a method says of each region: both ends of the interval that holds its limit.
struct Claim {
    method: Method,
    ends: Vec<[Mean; 2]>,
}

fn means(scene: &SceneDescription, settings: &RenderSettings, first_seed: u64) -> Vec<Mean> {
    let rows: Vec<_> = (0..SEEDS)
        .map(|seed| RenderSettings { seed: first_seed + seed, ..settings.clone() })
        .map(|settings| regions(&render_description(scene.clone(), &settings)))
        .collect();
    (0..REGIONS).map(|i| Mean::of(rows.iter().map(|row| row[i]))).collect()
}

fn claim(case: &Case, scene: &SceneDescription, method: Method) -> Claim {
    let ends = if has_radius(method) {
        let coarse = means(scene, &settings(case, method, false), 0);
        let fine = means(scene, &settings(case, method, true), SEEDS);
        let limits = |(c, f): (&Mean, &Mean)| [f.combined(4.0 / 3.0, *c, -1.0 / 3.0), f.combined(2.0, *c, -1.0)];
        coarse.iter().zip(&fine).map(limits).collect()
    } else {
        means(scene, &settings(case, method, false), 0).into_iter().map(|m| [m, m]).collect()
    };
    Claim { method, ends }
}

/// Probability of intervals as far apart as these if the limits are one.
fn p_value(a: &[Mean; 2], b: &[Mean; 2]) -> f64 {
    let differences: Vec<Mean> = a.iter().flat_map(|a| b.iter().map(|b| a.combined(1.0, *b, -1.0))).collect();
    let apart = differences.iter().all(|d| d.value > 0.0) || differences.iter().all(|d| d.value < 0.0);
    if apart { differences.iter().map(|d| d.p_value()).fold(0.0, f64::max) } else { 1.0 }
}

/// Noise of the difference in the middle one of the regions, as a share of the light there. (A rare glint of a lamp makes one
/// region noisy, and leaves the others able to tell.)
fn noise(a: &Claim, b: &Claim) -> f64 {
    let of = |(a, b): (&[Mean; 2], &[Mean; 2])| {
        a[0].combined(1.0, b[0], -1.0).sigma() / (0.5 * (a[0].value + b[0].value)).abs()
    };
    let mut all: Vec<f64> = a.ends.iter().zip(&b.ends).map(of).collect();
    all.sort_by(f64::total_cmp);
    all[REGIONS / 2]
}

fn agree(case: &Case) {
    let scene = import::load(&scene(case.file)).unwrap_or_else(|e| panic!("{e}"));
    let claims: Vec<Claim> =
        Method::ALL.into_iter().filter(|m| *m != Method::Whitted).map(|m| claim(case, &scene, m)).collect();
    let pairs = claims.iter().enumerate().flat_map(|(i, a)| claims[i + 1..].iter().map(move |b| (a, b)));
    let pairs: Vec<_> = pairs.collect();
    let level = sidak(SIGNIFICANCE, REGIONS * pairs.len());
    let mut wrong = Vec::new();
    for (a, b) in pairs {
        let name = format!("{}: {} and {}", case.file, a.method.name(), b.method.name());
        let worst = (0..REGIONS).map(|i| (p_value(&a.ends[i], &b.ends[i]), i)).min_by(|a, b| a.0.total_cmp(&b.0));
        let (p, i) = worst.expect("regions");
        let (noise, [a0, a1], [b0, b1]) = (noise(a, b), a.ends[i], b.ends[i]);
        println!(
            "{name}: noise {:.2} %; least p {p:.1e}, in region {i}: {:.4} … {:.4} and {:.4} … {:.4}",
            100.0 * noise,
            a0.value,
            a1.value,
            b0.value,
            b1.value
        );
        let excuse = case.excuse(a.method).or(case.excuse(b.method));
        match (excuse, noise > case.allowed_noise([a.method, b.method])) {
            // What a method never meets is missing without noise.
            (Some(why), noisy) if noisy || p < level => println!("  not compared: {why}"),
            (Some(_), _) => wrong.push(format!("{name}: need no excuse any more")),
            (None, true) => wrong.push(format!("{name}: too noisy to tell anything")),
            (None, false) if p < level => wrong.push(format!("{name}: region {i} differs, p = {p:.1e} < {level:.1e}")),
            (None, false) => {}
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn in_the_cornell_box() {
    agree(&Case { file: "cornell-diffuse.glb", samples: 384, radius: 0.06, photons: 3, noise: 0.01, fails: &[] });
}

#[test]
fn on_the_caustics_of_glass_and_mirror() {
    agree(&Case { file: "cornell-caustic.glb", samples: 192, radius: 0.06, photons: 1, noise: 0.05, fails: &[] });
}

#[test]
fn around_a_ring_of_rough_gold() {
    agree(&Case { file: "rough-gold-ring.glb", samples: 256, radius: 0.06, photons: 1, noise: 0.04, fails: &[] });
}

#[test]
fn where_all_light_is_indirect() {
    agree(&Case { file: "hidden-lamp.glb", samples: 256, radius: 0.1, photons: 3, noise: 0.06, fails: &[] });
}

#[test]
fn behind_a_door_ajar() {
    agree(&Case { file: "door-ajar.glb", samples: 384, radius: 0.12, photons: 4, noise: 0.2, fails: &[] });
}

/// Nothing can be connected through the water: neither a diffuse point below it with the lamp, nor with the eye, nor with a
/// point above. Such paths are found only where one walk happens to meet the lamp of 8 cm (or the eye, which none does), and
/// chains are not led to them by anything they meet before.
#[test]
fn in_a_pool() {
    const WHY: &str = "specular–diffuse–specular paths leave no two neighbours to connect (Veach 1997, §10.3.5)";
    let fails = &[(Method::Path, WHY), (Method::Bdpt, WHY), (Method::Mlt, WHY)];
    agree(&Case { file: "pool.glb", samples: 256, radius: 0.06, photons: 1, noise: 0.04, fails });
}

#[test]
fn between_glossy_plates() {
    agree(&Case { file: "glossy-plates.glb", samples: 192, radius: 0.08, photons: 1, noise: 0.04, fails: &[] });
}

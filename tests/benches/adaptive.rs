//! What `--adaptive` is worth: error at equal samples, and error times computing time, with and without it, on scenes with a
//! reference.
//!
//! `cargo bench --bench adaptive -- [SEEDS] [SCENE …]`: one thread; means over the seeds.

use gatherlight_render::film::Film;
use gatherlight_render::job::PreparedJob;
use gatherlight_render::settings::{Layer, Method, RenderSettings};
use gatherlight_tests::processes::{Whose, cpu_seconds};
use gatherlight_tests::{references, scene, single};

/// Pixels across.
const WIDTH: u32 = 128;
const SEEDS: u64 = 8;
const CASES: [(&str, Method, u32); 8] = [
    ("cornell-diffuse", Method::Path, 64),
    ("cornell-diffuse", Method::Photon, 32),
    ("cornell-caustic", Method::Path, 64),
    ("cornell-caustic", Method::Photon, 32),
    ("caustic-ring", Method::Photon, 32),
    ("glossy-plates", Method::Path, 64),
    ("rough-gold-ring", Method::Path, 64),
    ("door-ajar", Method::Path, 64),
];

/// Mean over pixels and channels of the squared error relative to the reference, or to its mean where that is greater.
fn relative_mse(film: &Film, truth: &[f64]) -> f64 {
    let values = film.pixels.chunks_exact(film.channels.len()).flat_map(|p| &p[..3]).map(|&v| f64::from(v));
    let floor = truth.iter().sum::<f64>() / truth.len() as f64;
    let square = |(v, t): (f64, &f64)| ((v - t) / t.abs().max(floor)).powi(2);
    values.zip(truth).map(square).sum::<f64>() / truth.len() as f64
}

/// Relative MSE, CPU seconds, samples a pixel.
fn run(name: &str, settings: &RenderSettings, truth: &[f64]) -> [f64; 3] {
    let job = PreparedJob::prepare(&scene(&format!("{name}.glb")), settings).unwrap_or_else(|e| panic!("{e}"));
    let before = cpu_seconds(Whose::Own);
    let film = single::render(&job);
    let seconds = cpu_seconds(Whose::Own) - before;
    let pixels = film.pixels.chunks_exact(film.channels.len());
    let samples = pixels.map(|p| f64::from(p[4])).sum::<f64>() / f64::from(settings.width * settings.height);
    [relative_mse(&film, truth), seconds, samples]
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    // `cargo test --benches` would run it too.
    if !std::env::args().any(|a| a == "--bench") {
        return;
    }
    let seeds = arguments.first().and_then(|a| a.parse().ok()).unwrap_or(SEEDS);
    let wanted = |name: &str| arguments.len() < 2 || arguments[1..].iter().any(|a| a == name);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    println!("| scene | method | samples | relMSE | CPU s | relMSE × CPU s, adaptive : even |");
    println!("|---|---|---|---|---|---|");
    for (name, method, samples) in CASES.into_iter().filter(|(name, ..)| wanted(name)) {
        let (width, height, truth) = references::reduced(name, WIDTH);
        let base = RenderSettings { width, height, samples, ..RenderSettings::for_method(method) };
        let mut means = [[0.0; 3]; 2];
        for seed in 1..=seeds {
            for (adaptive, mean) in [false, true].into_iter().zip(&mut means) {
                let settings = RenderSettings { adaptive, seed, layers: vec![Layer::Samples], ..base.clone() };
                let found = pool.install(|| run(name, &settings, &truth));
                mean.iter_mut().zip(found).for_each(|(m, v)| *m += v / seeds as f64);
            }
        }
        let [even, adaptive] = means;
        println!(
            "| {name} | {} | {:.1} → {:.1} | {:.2e} → {:.2e} | {:.2} → {:.2} | {:.2} |",
            method.name(),
            even[2],
            adaptive[2],
            even[0],
            adaptive[0],
            even[1],
            adaptive[1],
            adaptive[0] * adaptive[1] / (even[0] * even[1])
        );
    }
}

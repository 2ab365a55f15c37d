//! Whether the stated errors are true: the table of `docs/error.md`.
//!
//! `cargo bench --bench calibration -- [SEEDS] [SCENE …] [METHOD …]`: relative errors, stated and real, of every method on each scene, or
//! of those named.

use gatherlight_render::settings::{Method, RenderSettings};
use gatherlight_tests::calibration::calibrate;
use gatherlight_tests::references;
use gatherlight_tests::scene;

/// Pixels across.
const WIDTH: u32 = 64;
const SEEDS: u64 = 100;
/// Scenes, with the names of their references.
const SCENES: [&str; 6] = ["cornell-diffuse", "cornell-caustic", "caustic-ring", "pool", "glossy-plates", "door-ajar"];

fn settings(method: Method, height: u32) -> RenderSettings {
    let base = RenderSettings { method, width: WIDTH, height, ..RenderSettings::default() };
    match method {
        Method::Whitted => RenderSettings { samples: 16, ..base },
        Method::Path => RenderSettings { samples: 32, ..base },
        Method::Bdpt => RenderSettings { samples: 16, ..base },
        Method::Mlt => RenderSettings { mutations: 32, chains: 256, bootstrap: 20_000, ..base },
        Method::Photon => {
            RenderSettings { samples: 8, photons: 50_000, caustic_photons: 100_000, final_gather: 2, k: 50, ..base }
        }
        Method::Progressive => RenderSettings { rounds: 32, photons: 160_000, caustic_photons: 320_000, ..base },
        Method::Vcm => RenderSettings { rounds: 16, photons: 65_536, ..base },
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    // `cargo test --benches` would run it too.
    if !std::env::args().any(|a| a == "--bench") {
        return;
    }
    let seeds = arguments.first().and_then(|a| a.parse().ok()).unwrap_or(SEEDS);
    let named: Vec<&str> = arguments.iter().skip(1).map(String::as_str).collect();
    let is_method = |name: &&str| Method::ALL.iter().any(|m| m.name() == *name);
    let (methods, scenes): (Vec<&str>, Vec<&str>) = named.into_iter().partition(is_method);
    let wanted = |names: &[&str], name: &str| names.is_empty() || names.contains(&name);
    println!("{seeds} seeds, images {WIDTH} pixels wide; relative errors");
    println!(
        "| scene | method | coverage | noise, stated : real | stated noise | stated bias | real error | stated : real | real, unbounded |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for name in SCENES.into_iter().filter(|n| wanted(&scenes, n)) {
        let (_, height, truth) = references::reduced(name, WIDTH);
        for method in Method::ALL.into_iter().filter(|m| wanted(&methods, m.name())) {
            let reference = method.is_consistent().then_some(&truth[..]);
            let c = calibrate(&scene(&format!("{name}.glb")), &settings(method, height), seeds, reference);
            let percent = |v: f64| format!("{:.2} %", 100.0 * v);
            println!(
                "| {name} | {} | {:.1} % | {:.2} | {} | {} | {} | {} | {} |",
                method.name(),
                100.0 * c.coverage,
                c.noise,
                percent(c.stated_noise),
                percent(c.stated_bias),
                c.real_total.map_or("–".into(), percent),
                c.total.map_or("–".into(), |t| format!("{t:.2}")),
                c.unbounded.map_or("–".into(), percent)
            );
        }
    }
}

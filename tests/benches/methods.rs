//! Camera samples per second of every method on three scenes, and photon paths per second, with everything that a render
//! does after its scene is read: emission, trees, gathering.
//!
//! With `GATHERLIGHT_FIGURES` in the environment it prints a table of rates per CPU second instead of criterion's figures.

#![allow(missing_docs)] // criterion_group! makes a public function.

use criterion::{Criterion, SamplingMode, Throughput, criterion_group};
use gatherlight_render::job::PreparedJob;
use gatherlight_render::photon::{EmissionRange, MapKind};
use gatherlight_render::settings::{Method, RenderSettings};
use gatherlight_tests::{scene, single};
use std::hint::black_box;
use std::time::{Duration, Instant};

const SCENES: [&str; 3] = ["cornell-diffuse.glb", "cornell-caustic.glb", "pool.glb"];
const SIDE: u32 = 64;
/// Samples, mutations or rounds: as many camera paths a pixel as each method traces for them.
const SAMPLES: u32 = 16;
/// Photon paths of each map, over all rounds.
const PHOTONS: u64 = 64 * 1024;
/// Turns of the table; the fastest counts.
const TURNS: usize = 3;

fn prepare(name: &str, method: Method) -> PreparedJob {
    let settings = RenderSettings {
        method,
        width: SIDE,
        height: SIDE,
        samples: SAMPLES,
        mutations: SAMPLES,
        rounds: SAMPLES,
        photons: PHOTONS,
        caustic_photons: PHOTONS,
        ..Default::default()
    };
    PreparedJob::prepare(&scene(name), &settings).unwrap_or_else(|e| panic!("{e}"))
}

/// Samples of the whole image.
fn samples() -> u64 {
    u64::from(SIDE * SIDE * SAMPLES)
}

fn emit(job: &PreparedJob, map: MapKind) -> usize {
    job.emit(0, map, EmissionRange { first: 0, end: PHOTONS }).positions.len()
}

fn bench(c: &mut Criterion) {
    for name in SCENES {
        let mut group = c.benchmark_group(format!("methods/{name}"));
        group.sampling_mode(SamplingMode::Flat).sample_size(10).measurement_time(Duration::from_secs(3));
        group.throughput(Throughput::Elements(samples()));
        for method in Method::ALL {
            let job = prepare(name, method);
            group.bench_function(method.name(), |b| b.iter(|| black_box(single::render(&job))));
        }
        group.throughput(Throughput::Elements(PHOTONS));
        let job = prepare(name, Method::Photon);
        for (map, label) in [(MapKind::Global, "photons"), (MapKind::Caustic, "caustic photons")] {
            group.bench_function(label, |b| b.iter(|| black_box(emit(&job, map))));
        }
        group.finish();
    }
}

/// CPU seconds of this process, where the system tells, so that other work on the machine does not count; else seconds.
fn cpu_seconds(since: Instant) -> f64 {
    let nanoseconds = |task: std::fs::DirEntry| -> Option<f64> {
        let text = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
        text.split(' ').next()?.parse().ok()
    };
    let tasks = std::fs::read_dir("/proc/self/task");
    let sum: f64 = tasks.into_iter().flatten().flatten().filter_map(nanoseconds).sum();
    if sum > 0.0 { sum * 1e-9 } else { since.elapsed().as_secs_f64() }
}

/// Thousands of `units` a CPU second, the best of a few turns.
fn rate<T>(units: u64, mut work: impl FnMut() -> T) -> f64 {
    let epoch = Instant::now();
    let turn = |_| {
        let started = cpu_seconds(epoch);
        black_box(work());
        cpu_seconds(epoch) - started
    };
    units as f64 * 1e-3 / (0..TURNS).map(turn).fold(f64::INFINITY, f64::min)
}

/// The table: thousands of samples, or photon paths, a CPU second.
fn figures() {
    println!("{:<22}{}", "k/s of CPU", SCENES.map(|s| format!("{s:>22}")).concat());
    for method in Method::ALL {
        let rates = SCENES.map(|name| {
            let job = prepare(name, method);
            format!("{:>22.1}", rate(samples(), || single::render(&job)))
        });
        println!("{:<22}{}", method.name(), rates.concat());
    }
    for (map, label) in [(MapKind::Global, "photon paths"), (MapKind::Caustic, "caustic photon paths")] {
        let rates = SCENES.map(|name| {
            let job = prepare(name, Method::Photon);
            format!("{:>22.1}", rate(PHOTONS, || emit(&job, map)))
        });
        println!("{label:<22}{}", rates.concat());
    }
}

criterion_group!(benches, bench);

fn main() {
    if std::env::var_os("GATHERLIGHT_FIGURES").is_some() {
        return figures();
    }
    benches();
    Criterion::default().configure_from_args().final_summary();
}

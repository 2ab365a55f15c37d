//! One merged map a round, or independent rounds? The error that each reaches in equal time with 1, 2, 4 and 8 workers.
//!
//! Workers and network are simulated, the light transport is not: every step of a round is timed here on one thread, a model
//! turns the times and the bytes into the duration of a job on so many workers, each way gets as many rounds as fit into the
//! time, and what those rounds compute is rendered and held against a reference image.
//!
//! The model. Every worker and the coordinator have one core and one link to the same switch; the coordinator sends each worker
//! its own copy of a map, as it does today.
//! *Shared*: emission, upload, merge, broadcast and gather of successive rounds overlap (the scheduler's window), so that
//! a round takes as long as its slowest resource, and the first one the sum of all steps.
//! *Dense*: the same, with as many times the photons a round as there are workers, which is what their memory together holds.
//! *Independent*: each worker computes whole rounds, and one light image from each is sent at the end.
//!
//! `cargo bench -p gatherlight-tests --bench merging [-- SECONDS]`: seconds of each job, default 4.

use gatherlight_proto::payload;
use gatherlight_render::film::compare::compare;
use gatherlight_render::job::{Inputs, Phase, PreparedJob};
use gatherlight_render::math::Rgb;
use gatherlight_render::photon::EmissionRange;
use gatherlight_render::settings::{Merge, Method, RenderSettings};
use gatherlight_tests::references::image;
use gatherlight_tests::{scene, single};
use std::sync::Arc;
use std::time::Instant;

const SCENES: [&str; 2] = ["cornell-caustic", "pool"];
const WORKERS: [u64; 4] = [1, 2, 4, 8];
/// Photon paths of each map that one worker's memory holds, in the model.
const PATHS: u64 = 100_000;
/// Bytes a second of each link: 1 Gbit/s.
const LINK: f64 = 125e6;
/// Rounds that are timed.
const TIMED: u32 = 3;

/// What a round costs: seconds of one core, and bytes.
#[derive(Clone, Copy, Debug, Default)]
struct Costs {
    emission: f64,
    build: f64,
    gather: f64,
    photon_bytes: f64,
    map_bytes: f64,
    result_bytes: f64,
}

fn settings(name: &str, method: Method, merge: Merge, denser: u64, rounds: u32) -> RenderSettings {
    let (width, height, _) = image(name);
    let paths = match method {
        // A light path for each pixel.
        Method::Vcm => u64::from(width * height),
        _ => PATHS,
    };
    let photons = paths * denser * u64::from(rounds);
    let caustic_photons = if method == Method::Vcm { 0 } else { photons };
    RenderSettings {
        method,
        merge,
        rounds,
        photons,
        caustic_photons,
        width,
        height,
        ..RenderSettings::for_method(method)
    }
}

fn prepare(name: &str, settings: &RenderSettings) -> PreparedJob {
    PreparedJob::prepare(&scene(&format!("{name}.glb")), settings).unwrap_or_else(|e| panic!("{e}"))
}

fn timed<T>(seconds: &mut f64, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = work();
    *seconds += start.elapsed().as_secs_f64();
    result
}

/// Means over a few rounds of a shared job, on the current pool.
fn costs(job: &PreparedJob) -> Costs {
    let mut c = Costs::default();
    let mut inputs = Inputs::default();
    for phase in job.phases().into_iter().filter(|p| p.round() < TIMED) {
        match phase {
            Phase::Emission { round, map, paths } => {
                let batch = timed(&mut c.emission, || job.emit(round, map, EmissionRange { first: 0, end: paths }));
                c.photon_bytes += payload::photons::encode_batch(&batch).len() as f64;
                let built = timed(&mut c.build, || job.build_map(map, batch));
                c.map_bytes += payload::map::encode_map(&built).len() as f64;
                inputs.maps.insert(Arc::new(built));
            }
            Phase::Gather { round, tiles } => {
                let mut light = job.light_image();
                let rendered: Vec<_> = timed(&mut c.gather, || {
                    (0..tiles).map(|t| job.gather(&inputs, round, t, light.as_mut())).collect()
                });
                let bytes = payload::gather::encode(&rendered, job.channels().len(), light.as_ref());
                c.result_bytes += bytes.len() as f64;
            }
            Phase::Bootstrap { .. } | Phase::SampleMap { .. } | Phase::Splat { .. } => {}
        }
    }
    let n = f64::from(TIMED);
    let Costs { emission, build, gather, photon_bytes, map_bytes, result_bytes } = c;
    Costs {
        emission: emission / n,
        build: build / n,
        gather: gather / n,
        photon_bytes: photon_bytes / n,
        map_bytes: map_bytes / n,
        result_bytes: result_bytes / n,
    }
}

/// Rounds with shared maps that end within `seconds`.
fn shared_rounds(c: &Costs, workers: u64, seconds: f64) -> u32 {
    let p = workers as f64;
    let (work, upload) = ((c.emission + c.gather) / p, (c.photon_bytes + c.result_bytes) / LINK);
    let broadcast = c.map_bytes * p / LINK;
    let first = work + upload + c.build + broadcast;
    let each = work.max(upload).max(c.build).max(broadcast);
    (1.0 + (seconds - first) / each).max(1.0) as u32
}

/// Independent rounds that end within `seconds`; `image_bytes` is what each worker sends at the end.
fn independent_rounds(c: &Costs, workers: u64, image_bytes: f64, seconds: f64) -> u32 {
    let round = c.emission + c.build + c.gather;
    let computing = seconds - image_bytes * workers as f64 / LINK;
    ((computing / round) as u64 * workers).max(workers) as u32
}

fn error(name: &str, job: &PreparedJob) -> f64 {
    let (width, height, reference) = image(name);
    let pixels: Vec<Rgb> = single::render(job).rgb();
    let size = |pixels| (width as usize, height as usize, pixels);
    compare(size(pixels.as_slice()), size(reference.as_slice())).unwrap_or_else(|e| panic!("{e}")).relative_mse
}

fn on_one_thread<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool").install(work)
}

fn main() {
    // `cargo test --benches` would run it too.
    if !std::env::args().any(|a| a == "--bench") {
        return;
    }
    let seconds = std::env::args().filter_map(|a| a.parse().ok()).next().unwrap_or(4.0);
    println!("{seconds} s a job, links of 1 Gbit/s; relMSE (rounds)\n");
    println!("| scene | method | workers | shared | dense | independent |");
    println!("|---|---|---|---|---|---|");
    for name in SCENES {
        for method in [Method::Progressive, Method::Vcm] {
            let job = |merge, denser, rounds| prepare(name, &settings(name, method, merge, denser, rounds));
            let base = job(Merge::Shared, 1, TIMED);
            let one = on_one_thread(|| costs(&base));
            let alone = job(Merge::Independent, 1, 1);
            let mut light = alone.light_image().expect("independent rounds have one");
            alone.splat(&Inputs::default(), 0, EmissionRange { first: 0, end: 1 }, &mut light);
            let image_bytes = payload::light::encode(&light).len() as f64;
            for workers in WORKERS {
                let cell = |job: &PreparedJob, rounds: u32| format!("{:.2e} ({rounds})", error(name, job));
                let rounds = shared_rounds(&one, workers, seconds);
                let shared = cell(&job(Merge::Shared, 1, rounds), rounds);
                let dense = if workers == 1 {
                    "the same".into()
                } else {
                    let c = job(Merge::Shared, workers, TIMED);
                    let rounds = shared_rounds(&on_one_thread(|| costs(&c)), workers, seconds);
                    cell(&job(Merge::Shared, workers, rounds), rounds)
                };
                let rounds = independent_rounds(&one, workers, image_bytes, seconds);
                let alone = cell(&job(Merge::Independent, 1, rounds), rounds);
                println!("| {name} | {} | {workers} | {shared} | {dense} | {alone} |", method.name());
            }
        }
    }
}

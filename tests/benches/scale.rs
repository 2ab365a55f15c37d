//! How far adding workers makes a job faster: parallel efficiency at 1 to 1,000 workers, by the real scheduler under a virtual
//! network and clock.
//!
//! The rates are measured here, on one thread, on cornell-caustic; the machines are a model. Every worker and the coordinator
//! have [`THREADS`] threads, each as fast as the one measured, and one full-duplex link. A worker computes one lease at a time
//! while results travel. The coordinator's link takes in one result after the other; a map is built by all of its threads, travels
//! as the relay's plan has it, and is decoded by each worker. Efficiency is the computing time of all leases over workers × time
//! until the job ends.
//!
//! `cargo bench -p gatherlight-tests --bench scale`: the table; `-- --real`: real processes against the model instead, 1 to 8 workers
//! that are slowed so that two cores are enough for all of them; `-- --shares [path | photon]`: the same where each has a fixed share
//! of a core; `-- --events`: the real time of the scheduler itself.

#[path = "scale/real.rs"]
mod real;
#[path = "scale/shares.rs"]
mod shares;

use gatherlight::schedule::Policy;
use gatherlight_proto::payload;
use gatherlight_render::job::{Inputs, Phase, PreparedJob};
use gatherlight_render::photon::merge::Merger;
use gatherlight_render::photon::{EmissionRange, MapKind};
use gatherlight_render::settings::{Method, RenderSettings};
use gatherlight_tests::pipeline::Link;
use gatherlight_tests::scene;
use gatherlight_tests::simulation::{Conditions, Costs, Report, simulate};
use std::sync::Arc;
use std::time::{Duration, Instant};

const WORKERS: [usize; 5] = [1, 8, 64, 512, 1_000];
const GBITS: [f64; 3] = [1.0, 10.0, 100.0];
/// Threads of a machine.
const THREADS: f64 = 16.0;
/// Photon paths of the large job.
const PATHS: u64 = 1_000_000_000;
/// Its image and samples a pixel.
const IMAGE: (u32, u32, u32) = (7_680, 4_320, 64);
/// Rounds of the job in rounds.
const ROUNDS: u32 = 64;
/// Photon paths and camera samples a pixel that are timed.
const TIMED: (u64, u32) = (300_000, 4);

/// Seconds of one thread, and bytes.
#[derive(Clone, Copy, Debug)]
struct Rates {
    path: f64,
    /// Of a tile, for each sample a pixel.
    tile_sample: f64,
    stored_per_path: f64,
    photon_bytes: f64,
    tile_bytes: f64,
    decode_photon: f64,
    build_photon: f64,
    /// Of a map that a worker decodes, with the irradiance that it computes there.
    read_photon: f64,
}

fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let begun = Instant::now();
    let result = work();
    (result, begun.elapsed().as_secs_f64())
}

/// Measured on the current pool.
fn measure(method: Method) -> Rates {
    let (paths, samples) = TIMED;
    let settings = RenderSettings {
        method,
        width: 128,
        height: 128,
        samples,
        rounds: 1,
        photons: paths,
        caustic_photons: 0,
        ..RenderSettings::for_method(method)
    };
    let bundle = scene("cornell-caustic.glb");
    let job = PreparedJob::prepare(&bundle, &settings).unwrap_or_else(|e| panic!("{e}"));
    let range = EmissionRange { first: 0, end: paths };
    let mut inputs = Inputs::default();
    let mut rates = Rates {
        path: 0.0,
        tile_sample: 0.0,
        stored_per_path: 0.0,
        photon_bytes: 0.0,
        tile_bytes: 0.0,
        decode_photon: 0.0,
        build_photon: 0.0,
        read_photon: 0.0,
    };
    if job.phases().iter().any(|p| matches!(p, Phase::Emission { .. })) {
        let (batch, emission) = timed(|| job.emit(0, MapKind::Global, range));
        let photons = batch.len() as f64;
        let (encoded, encode) = timed(|| payload::photons::encode_batch(&batch));
        let directions = job.photon_directions(MapKind::Global);
        let (decoded, decode) =
            timed(|| payload::photons::decode_batch(&encoded, range, directions).expect("is whole"));
        let (map, build) = timed(|| {
            let mut merger = Merger::new(MapKind::Global, range);
            merger.insert(decoded).expect("is new");
            let map = job.build_map(MapKind::Global, merger.finish().expect("is whole"));
            (payload::map::encode_map(&map), map)
        });
        let (read, reading) = timed(|| payload::map::decode_map(&map.0, MapKind::Global, u64::MAX).expect("is whole"));
        inputs.maps.insert(Arc::new(read));
        rates = Rates {
            path: (emission + encode) / paths as f64,
            stored_per_path: photons / paths as f64,
            photon_bytes: encoded.len().max(map.0.len()) as f64 / photons,
            decode_photon: decode / photons,
            build_photon: build / photons,
            read_photon: reading / photons,
            ..rates
        };
    }
    let tiles = job.grid().len();
    // The samples may be divided among passes over the image.
    let pass = |round| (0..tiles).map(|t| job.gather(&inputs, round, t, None)).collect::<Vec<_>>();
    // Irradiance at a map's photons is computed by whoever asks for it first: by every worker, whatever the number of tiles.
    let (rendered, cold) = timed(|| pass(0));
    let warm = timed(|| pass(0)).1;
    let photons = rates.stored_per_path * paths as f64;
    if photons > 0.0 {
        rates.read_photon += (cold - warm).max(0.0) / photons;
    }
    let gather = warm + timed(|| (1..job.rounds()).map(pass).collect::<Vec<_>>()).1;
    let bytes = payload::gather::encode(&rendered, job.channels().len(), None).len();
    let tiles = f64::from(tiles);
    Rates { tile_sample: gather / tiles / f64::from(samples), tile_bytes: bytes as f64 / tiles, ..rates }
}

/// A job of the table.
struct Large {
    title: &'static str,
    method: Method,
    phases: Vec<Phase>,
    /// Samples a pixel of one round.
    samples: f64,
}

fn tiles() -> u32 {
    IMAGE.0.div_ceil(16) * IMAGE.1.div_ceil(16)
}

fn jobs() -> Vec<Large> {
    let (map, samples) = (MapKind::Global, f64::from(IMAGE.2));
    let emission = |round, paths| Phase::Emission { round, map, paths };
    let gather = |round| Phase::Gather { round, tiles: tiles() };
    let rounds = |round| [emission(round, PATHS / u64::from(ROUNDS)), gather(round)];
    // As the programs divide them into passes.
    let as_it_is = |title, method| {
        let (width, height, samples) = IMAGE;
        let settings = RenderSettings {
            method,
            width,
            height,
            samples,
            photons: PATHS,
            caustic_photons: 0,
            ..RenderSettings::for_method(method)
        };
        let job = PreparedJob::prepare(&scene("cornell-caustic.glb"), &settings).expect("a scene");
        Large { title, method, phases: job.phases(), samples: f64::from(samples) / f64::from(job.rounds()) }
    };
    vec![
        as_it_is("path", Method::Path),
        as_it_is("photon, one map", Method::Photon),
        Large {
            title: "progressive, 64 rounds",
            method: Method::Progressive,
            phases: (0..ROUNDS).flat_map(rounds).collect(),
            samples: samples / f64::from(ROUNDS),
        },
    ]
}

/// The model's costs on machines of [`THREADS`] threads. A coordinator that closes a round reads each pixel once, and writes each to
/// the file at the end.
fn costs(r: &Rates, samples: f64, gbit: f64) -> Costs {
    let pixels = f64::from(IMAGE.0) * f64::from(IMAGE.1);
    Costs {
        link: Link { bytes_per_second: gbit * 125e6, latency: 200e-6 },
        path: r.path / THREADS,
        tile: r.tile_sample * samples / THREADS,
        stored_per_path: r.stored_per_path,
        photon_bytes: r.photon_bytes,
        tile_bytes: r.tile_bytes,
        decode_photon: r.decode_photon / THREADS,
        build_photon: r.build_photon / THREADS,
        read_photon: r.read_photon / THREADS,
        close: pixels * 20e-9 / THREADS,
    }
}

/// Seconds that one worker would compute.
fn work(phases: &[Phase], c: &Costs) -> f64 {
    let seconds = |p: &Phase| p.units() as f64 * if p.makes_image() { c.tile } else { c.path };
    phases.iter().map(seconds).sum()
}

fn run(phases: &[Phase], workers: usize, costs: Costs, policy: Policy) -> Report {
    let phases = phases.to_vec();
    let costs = Some(costs);
    simulate(1, &Conditions { workers, jobs: 1, phases, costs, policy, delay: 200, ..Conditions::fair() })
}

fn on_one_thread<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool").install(work)
}

fn table() {
    println!("| job | Gbit/s | {} |", WORKERS.map(|w| format!("{w} workers")).join(" | "));
    println!("|---|---|{}", "---|".repeat(WORKERS.len()));
    for large in jobs() {
        let rates = on_one_thread(|| measure(large.method));
        eprintln!("{}: {rates:?}", large.title);
        for gbit in GBITS {
            let c = costs(&rates, large.samples, gbit);
            let cell = |workers: usize| {
                let (report, wall) = timed(|| run(&large.phases, workers, c, Policy::default()));
                let seconds = report.elapsed as f64 * 1e-6;
                let efficiency = work(&large.phases, &c) / (workers as f64 * seconds);
                let (received, maps) = (report.result_bytes as f64 * 1e-9, report.broadcast_bytes as f64 * 1e-9);
                eprintln!(
                    "{}, {gbit} Gbit/s, {workers}: {seconds:.1} s, idle {:.3}, results {received:.1} GB, maps {maps:.1} GB, \
                     {} leases again; simulated in {wall:.1} s",
                    large.title, report.idle_fraction, report.retried
                );
                format!("{:.0} % ({seconds:.0} s)", efficiency * 100.0)
            };
            println!("| {} | {gbit} | {} |", large.title, WORKERS.map(cell).join(" | "));
        }
    }
}

/// Real time of the scheduler itself, which is one thread's: with a thousand workers it takes in some thousand events a second.
fn events() {
    // A tail that is long: the oldest leases are repeated by whoever has nothing to do.
    let policy = Policy { twin_after: Duration::from_millis(500), ..Policy::default() };
    for workers in [10, 1_000] {
        let (paths, tiles) = (1_000_000 * workers as u64, 130 * workers as u32);
        let conditions =
            Conditions { workers, paths, tiles, jobs: 1, stall: 0.01, policy: policy.clone(), ..Conditions::fair() };
        // The quickest of some runs: other programs have the same processors.
        let costs = (1..4).map(|seed| {
            let Report { events, scheduler_time, .. } = simulate(seed, &conditions);
            (scheduler_time.as_secs_f64() * 1e6 / events as f64, events)
        });
        let (micros, events) = costs.min_by(|a, b| a.0.total_cmp(&b.0)).expect("some");
        println!("{workers} workers: {events} events, {micros:.2} µs each");
    }
}

fn main() {
    // `cargo test --benches` would run it too.
    if !std::env::args().any(|a| a == "--bench") {
        return;
    }
    let has = |flag: &str| std::env::args().any(|a| a == flag);
    if has("--shares") {
        shares::compare(has);
    } else if has("--real") {
        real::compare();
    } else if has("--events") {
        events();
    } else {
        table();
    }
}

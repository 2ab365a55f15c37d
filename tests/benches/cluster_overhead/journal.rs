//! What it costs that results are on the disk before they count: the same job with the journal and without, in turns.

use super::median;
use gatherlight::server::ServeConfig;
use gatherlight_render::settings::{Method, RenderSettings};
use gatherlight_tests::cluster::{Coordinator, finished_exr, request};
use gatherlight_tests::processes::{Whose, cpu_seconds};
use gatherlight_tests::scene;
use gatherlight_worker::{Faults, WorkerConfig};

/// Pairs of each job; the medians count.
const TURNS: usize = 7;
/// Of the medians, of both CPU and elapsed time.
const AIM: f64 = 1.03;

/// CPU seconds of everything, and seconds of the job. Coordinator, client and `workers` of one thread are in this process, joined by
/// gRPC over TCP.
fn run(settings: &RenderSettings, workers: usize, journal: bool) -> (f64, f64) {
    let runtime =
        tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().expect("a runtime");
    let store = tempfile::tempdir().expect("a directory");
    let before = cpu_seconds(Whose::Own);
    let elapsed = runtime.block_on(async {
        let listen = "127.0.0.1:0".parse().expect("an address");
        let config = ServeConfig { threads: 1, journal, ..ServeConfig::new(listen, store.path().to_owned()) };
        let coordinator = Coordinator::start_with(config).await;
        let worker = |i| WorkerConfig { threads: 1, faults: Faults::default(), ..WorkerConfig::new(format!("w{i}")) };
        let _workers: Vec<_> = (0..workers).map(|i| coordinator.worker_with(worker(i))).collect();
        let client = coordinator.client().await;
        let id = client.submit(&request(&scene("cornell-caustic.glb"), settings), |_, _| {}).await.expect("is taken");
        finished_exr(&client, id).await;
        client.get(id).await.expect("is known").elapsed.as_secs_f64()
    });
    (cpu_seconds(Whose::Own) - before, elapsed)
}

/// Jobs of many leases: photons, whose results are large; tiles; and rounds, after which the film is kept.
fn jobs() -> [(&'static str, RenderSettings); 3] {
    let of = |method| RenderSettings { method, width: 192, height: 192, ..RenderSettings::for_method(method) };
    let (photons, caustic_photons) = (2_000_000, 2_000_000);
    [
        ("photon", RenderSettings { photons, caustic_photons, samples: 2, ..of(Method::Photon) }),
        ("path", RenderSettings { samples: 48, ..of(Method::Path) }),
        (
            "progressive",
            RenderSettings { rounds: 24, photons: 40_000, caustic_photons: 40_000, ..of(Method::Progressive) },
        ),
    ]
}

/// Compares the jobs that `wanted` names, or all.
pub(crate) fn compare(wanted: impl Fn(&str) -> bool) {
    let all = !jobs().iter().any(|(name, _)| wanted(name));
    println!("| job | CPU with | without | ratio | elapsed with | without | ratio |\n|---|---|---|---|---|---|---|");
    for (name, settings) in jobs().into_iter().filter(|(name, _)| all || wanted(name)) {
        let mut runs: [Vec<(f64, f64)>; 2] = Default::default();
        for turn in 0..TURNS {
            // Whoever is first changes from turn to turn.
            for second in [false, true] {
                let journal = second != (turn % 2 == 0);
                runs[usize::from(journal)].push(run(&settings, 1, journal));
            }
            let [without, with] = [0, 1].map(|journal: usize| runs[journal][turn]);
            eprintln!("{name}: CPU {:.3}, elapsed {:.3}", with.0 / without.0, with.1 / without.1);
        }
        let medians =
            |of: fn(&(f64, f64)) -> f64| [1, 0].map(|journal: usize| median(runs[journal].iter().map(of).collect()));
        let ([cpu, cpu_without], [elapsed, elapsed_without]) = (medians(|r| r.0), medians(|r| r.1));
        let (cpu_ratio, ratio) = (cpu / cpu_without, elapsed / elapsed_without);
        println!(
            "| {name} | {cpu:.2} s | {cpu_without:.2} s | {cpu_ratio:.3} | {elapsed:.2} s | {elapsed_without:.2} s | {ratio:.3} |"
        );
        if cpu_ratio.max(ratio) > AIM {
            println!("above the aim of {AIM}");
        }
    }
}

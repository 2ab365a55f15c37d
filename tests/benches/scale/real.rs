//! The model against real programs on this machine.

use super::{costs, measure, on_one_thread, run, timed};
use gatherlight::schedule::Policy;
use gatherlight_render::job::{Phase, PreparedJob};
use gatherlight_render::settings::{Method, RenderSettings};
use gatherlight_tests::cluster::{Coordinator, finished_exr, request};
use gatherlight_tests::scene;
use gatherlight_tests::simulation::Costs;
use gatherlight_worker::{Faults, WorkerConfig};
use std::time::Duration;

/// Sleep for each photon path and each tile, beside which what is computed is little: so that eight workers share two cores.
const PER_PATH: Duration = Duration::from_micros(25);
const PER_TILE: Duration = Duration::from_millis(40);

fn settings() -> RenderSettings {
    RenderSettings {
        method: Method::Photon,
        width: 256,
        height: 256,
        samples: 1,
        photons: 400_000,
        caustic_photons: 0,
        ..RenderSettings::for_method(Method::Photon)
    }
}

/// Leases that are short beside the job of some seconds, as those of a second are beside one of minutes.
fn policy() -> Policy {
    Policy { target_lease: Duration::from_millis(100), min_paths: 256, probe_paths: 1_024, ..Policy::default() }
}

/// Workers that sleep, on this machine's coordinator; seconds of the job.
fn real(workers: usize, prepared: &PreparedJob) -> f64 {
    let runtime =
        tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().expect("a runtime");
    let store = tempfile::tempdir().expect("a directory");
    runtime.block_on(async {
        let coordinator = Coordinator::start(store.path(), policy()).await;
        let faults = Faults { per_path: PER_PATH, per_tile: PER_TILE, ..Faults::default() };
        let worker = |i| WorkerConfig { threads: 1, faults: faults.clone(), ..WorkerConfig::new(format!("w{i}")) };
        let _workers: Vec<_> = (0..workers).map(|i| coordinator.worker_with(worker(i))).collect();
        let client = coordinator.client().await;
        while client.workers().await.expect("is answered").len() < workers {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        let bundle = scene("cornell-caustic.glb");
        let id = client.submit(&request(&bundle, prepared.settings()), |_, _| {}).await.expect("is taken");
        finished_exr(&client, id).await;
        client.get(id).await.expect("is known").elapsed.as_secs_f64()
    })
}

/// Prints both times and efficiencies for 1 to 8 workers.
pub(crate) fn compare() {
    let prepared = PreparedJob::prepare(&scene("cornell-caustic.glb"), &settings()).expect("a scene");
    let rates = on_one_thread(|| measure(Method::Photon));
    let large = costs(&rates, 1.0, 10.0);
    // One thread each, and the sleep.
    let c = Costs {
        path: rates.path + PER_PATH.as_secs_f64(),
        tile: rates.tile_sample + PER_TILE.as_secs_f64(),
        decode_photon: rates.decode_photon,
        build_photon: rates.build_photon,
        read_photon: rates.read_photon,
        close: 0.02,
        ..large
    };
    let phases: Vec<Phase> = prepared.phases();
    println!("| workers | real | model | real efficiency | efficiency of the model |\n|---|---|---|---|---|");
    let mut first = None;
    for workers in [1, 2, 4, 8] {
        let (seconds, _) = timed(|| real(workers, &prepared));
        let modelled = run(&phases, workers, c, policy()).elapsed as f64 * 1e-6;
        let (real_one, model_one) = *first.get_or_insert((seconds, modelled));
        let efficiency = |one: f64, now: f64| 100.0 * one / (workers as f64 * now);
        println!(
            "| {workers} | {seconds:.2} s | {modelled:.2} s | {:.0} % | {:.0} % |",
            efficiency(real_one, seconds),
            efficiency(model_one, modelled)
        );
    }
}

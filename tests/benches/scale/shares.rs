//! The model against real programs, each with a fixed share of a core: control groups of Linux (v1, controller `cpu`).

use super::{costs, measure, on_one_thread, run, timed};
use gatherlight::client::connect;
use gatherlight::schedule::Policy;
use gatherlight_render::job::PreparedJob;
use gatherlight_render::settings::{Method, RenderSettings};
use gatherlight_tests::cluster::{finished_exr, request};
use gatherlight_tests::processes::{serve, worker};
use gatherlight_tests::scene;
use gatherlight_tests::simulation::Costs;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Of a core: what a worker gets, and what the coordinator gets. Eight workers and the coordinator fit into two cores.
const WORKER: f64 = 0.2;
const COORDINATOR: f64 = 0.3;
/// Microseconds after which a share begins anew.
const PERIOD_US: f64 = 10_000.0;
/// Weight beside what else runs on the machine, whose own is 1,024: the most there is.
const WEIGHT: u64 = 262_144;
const CONTROLLER: &str = "/sys/fs/cgroup/cpu";

/// Processes that have a share of a core together. All of them must have ended, or left, before it is dropped.
struct Share(PathBuf);

impl Share {
    fn of(core: f64, name: &str) -> Self {
        let path = Path::new(CONTROLLER).join(format!("gatherlight-{}-{name}", std::process::id()));
        std::fs::create_dir(&path).unwrap_or_else(|e| panic!("{}: {e}; needs cgroup v1 and root", path.display()));
        let share = Share(path);
        share.set("cpu.shares", WEIGHT);
        share.set("cpu.cfs_period_us", PERIOD_US as u64);
        share.set("cpu.cfs_quota_us", (PERIOD_US * core) as u64);
        share
    }
    fn set(&self, file: &str, value: u64) {
        std::fs::write(self.0.join(file), value.to_string()).unwrap_or_else(|e| panic!("{file}: {e}"));
    }
    /// Takes in a process with all its threads.
    fn admit(&self, process: u32) {
        self.set("cgroup.procs", process.into());
    }
    /// Runs `work` in this process with the share.
    fn within<T>(&self, work: impl FnOnce() -> T) -> T {
        self.admit(std::process::id());
        let result = work();
        Share::leave();
        result
    }
    fn leave() {
        let all = Path::new(CONTROLLER).join("cgroup.procs");
        std::fs::write(all, std::process::id().to_string()).expect("can be left");
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        // What was killed just now may still be counted there.
        for _ in 0..100 {
            if std::fs::remove_dir(&self.0).is_ok() {
                return;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

fn settings(method: Method) -> RenderSettings {
    RenderSettings {
        method,
        width: 256,
        height: 256,
        samples: if method == Method::Path { 40 } else { 8 },
        photons: 500_000,
        caustic_photons: 0,
        ..RenderSettings::for_method(method)
    }
}

/// Seconds of the job with so many workers.
async fn real(workers: usize, settings: &RenderSettings) -> f64 {
    let store = tempfile::tempdir().expect("a directory");
    let shares: Vec<_> = (0..workers).map(|i| Share::of(WORKER, &format!("w{i}"))).collect();
    let coordinators = Share::of(COORDINATOR, "coordinator");
    let (coordinator, url) = serve(store.path());
    coordinators.admit(coordinator.id());
    let mut running = Vec::new();
    for (i, share) in shares.iter().enumerate() {
        running.push(worker(&url, &format!("w{i}")));
        share.admit(running[i].id());
    }
    let client = connect(&url, 5).await.unwrap_or_else(|e| panic!("{e}"));
    while client.workers().await.expect("is answered").len() < workers {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let id = client.submit(&request(&scene("cornell-caustic.glb"), settings), |_, _| {}).await.expect("is taken");
    finished_exr(&client, id).await;
    client.get(id).await.expect("is known").elapsed.as_secs_f64()
}

fn compare_one(method: Method) {
    let (settings, bundle) = (settings(method), scene("cornell-caustic.glb"));
    let share = Share::of(WORKER, "measured");
    let ((prepared, preparation), rates) = share.within(|| {
        on_one_thread(|| (timed(|| PreparedJob::prepare(&bundle, &settings).expect("a scene")), measure(method)))
    });
    drop(share);
    eprintln!("{method:?}: {rates:?}, {preparation:.2} s to prepare the scene");
    let samples = f64::from(settings.samples) / f64::from(prepared.rounds());
    let large = costs(&rates, samples, 10.0);
    let at_coordinator = |seconds: f64| seconds * WORKER / COORDINATOR;
    let pixels = f64::from(settings.width) * f64::from(settings.height);
    let c = Costs {
        path: rates.path,
        tile: rates.tile_sample * samples,
        decode_photon: at_coordinator(rates.decode_photon),
        build_photon: at_coordinator(rates.build_photon),
        read_photon: rates.read_photon,
        close: pixels * 20e-9 / COORDINATOR,
        ..large
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    println!("| job | workers | real | model | real efficiency | efficiency of the model |\n|---|---|---|---|---|---|");
    let mut first = None;
    for workers in [1, 2, 4, 8] {
        let seconds = runtime.block_on(real(workers, &settings));
        let simulated = run(&prepared.phases(), workers, c, Policy::default()).elapsed as f64 * 1e-6;
        // Large jobs do not notice the scene; every worker prepares it, all at once.
        let modelled = simulated + preparation;
        let (real_one, model_one) = *first.get_or_insert((seconds, modelled));
        let efficiency = |one: f64, now: f64| 100.0 * one / (workers as f64 * now);
        println!(
            "| {} | {workers} | {seconds:.1} s | {modelled:.1} s | {:.0} % | {:.0} % |",
            method.name(),
            efficiency(real_one, seconds),
            efficiency(model_one, modelled)
        );
    }
}

/// Prints both times and efficiencies for 1 to 8 workers, for the kinds of job that `wanted` names, or for both.
pub(crate) fn compare(wanted: impl Fn(&str) -> bool) {
    let kinds = [("path", Method::Path), ("photon", Method::Photon)];
    let all = !kinds.iter().any(|(name, _)| wanted(name));
    kinds.into_iter().filter(|(name, _)| all || wanted(name)).for_each(|(_, method)| compare_one(method));
}

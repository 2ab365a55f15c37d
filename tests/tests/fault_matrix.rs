//! Each phase × each fault, with the real programs as processes: the image has the same bits, and what it cost is printed
//! (`cargo test --test fault_matrix -- --nocapture`).

use gatherlight::types::{JobProgress, JobState};
use gatherlight_render::settings::{Merge, Method, RenderSettings};
use gatherlight_tests::cluster::{finished_exr, request, watch_until};
use gatherlight_tests::processes::{Process, worker};
use gatherlight_tests::proxy::Cable;
use gatherlight_tests::real_cluster::{RealCluster, right_pixels, settings};
use gatherlight_tests::{pixel_sha256, scene};
use gatherlight_worker::{Connector, Faults, WorkerConfig};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::sync::Mutex;

/// Where a job is when the fault strikes.
#[derive(Clone, Copy, Debug)]
enum Moment {
    Emission,
    Merge,
    Gather,
    Bootstrap,
    Splat,
    Rounds,
    IndependentRounds,
}

impl Moment {
    const ALL: [Moment; 7] = [
        Moment::Emission,
        Moment::Merge,
        Moment::Gather,
        Moment::Bootstrap,
        Moment::Splat,
        Moment::Rounds,
        Moment::IndependentRounds,
    ];
    fn settings(self) -> RenderSettings {
        match self {
            Moment::Emission | Moment::Merge | Moment::Gather => settings(Method::Photon),
            Moment::Bootstrap | Moment::Splat => settings(Method::Mlt),
            Moment::Rounds => settings(Method::Progressive),
            Moment::IndependentRounds => RenderSettings { merge: Merge::Independent, ..settings(Method::Vcm) },
        }
    }
    fn is_there(self, p: &JobProgress) -> bool {
        let begun = p.done > 0;
        match self {
            Moment::Emission => matches!(p.state, JobState::Emission(_)) && begun,
            // The photons are there and the first tiles are not: merging and broadcasting are too quick to be seen for sure.
            Moment::Merge => p.stats.maps.iter().all(|m| m.emitted_count == m.emitted_total),
            Moment::Gather => p.state == JobState::Gather && begun,
            Moment::Bootstrap => p.state == JobState::Bootstrap && begun,
            Moment::Splat => p.state == JobState::Splat && begun,
            Moment::Rounds => p.stats.rounds_done >= 3,
            Moment::IndependentRounds => p.stats.units_done >= 3,
        }
    }
}

/// One at a time: two of these on two cores would only wait for each other.
static TURN: Mutex<()> = Mutex::const_new(());

/// Runs a job on three workers for each moment; `strike` does its worst to the cluster at that moment. What it returns lives until
/// the job has ended.
async fn at_every_moment<T>(fault: &str, strike: impl AsyncFn(&mut RealCluster) -> T) {
    let _turn = TURN.lock().await;
    for moment in Moment::ALL {
        let settings = moment.settings();
        let expected = tokio::task::spawn_blocking({
            let settings = settings.clone();
            move || right_pixels(&settings)
        });
        let expected = expected.await.expect("did not panic");
        let mut cluster = RealCluster::start(3).await;
        let submitted = cluster.client.submit(&request(&scene("caustic-ring.glb"), &settings), |_, _| {}).await;
        let id = submitted.unwrap_or_else(|e| panic!("{e}"));
        watch_until(&cluster.client, id, |p| moment.is_there(p)).await;
        let struck = strike(&mut cluster).await;
        let exr = finished_exr(&cluster.client, id).await;
        drop(struck);
        assert_eq!(pixel_sha256(&exr), expected, "{fault} at {moment:?}");
        let last = cluster.client.get(id).await.unwrap_or_else(|e| panic!("{e}"));
        let (retried, seconds) = (last.stats.retried_leases, last.elapsed.as_secs_f64());
        println!("| {fault} | {moment:?} | {seconds:.1} s | {retried} |");
        assert_eq!(last.stats.disputes, 0);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing() {
    at_every_moment("nothing", async |_| ()).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_is_killed() {
    at_every_moment("worker killed", async |cluster| cluster.workers.remove(0).kill()).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn all_workers_but_one_are_killed() {
    at_every_moment("two workers killed", async |cluster| {
        cluster.workers.drain(..2).for_each(Process::kill);
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_is_frozen() {
    at_every_moment("worker frozen", async |cluster| cluster.workers[0].signal("STOP")).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_is_ten_times_slower() {
    at_every_moment("worker at a tenth of its speed", async |cluster| {
        let (slow, going) = (cluster.workers.remove(0), Arc::new(AtomicBool::new(true)));
        let goes = going.clone();
        let thread = std::thread::spawn(move || {
            while goes.load(Ordering::Relaxed) {
                slow.signal("STOP");
                std::thread::sleep(Duration::from_millis(90));
                slow.signal("CONT");
                std::thread::sleep(Duration::from_millis(10));
            }
        });
        Slowed { going, thread: Some(thread) }
    })
    .await;
}

/// A worker that is stopped and continued in turn, until this is dropped.
struct Slowed {
    going: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Drop for Slowed {
    fn drop(&mut self) {
        self.going.store(false, Ordering::Relaxed);
        drop(self.thread.take().map(std::thread::JoinHandle::join));
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_is_restarted_under_the_same_name() {
    at_every_moment("worker restarted under its name", async |cluster| {
        cluster.workers.remove(0).kill();
        worker(&cluster.url, "worker-0")
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_that_lies_joins() {
    let lies = Faults { corrupt: true, ..Faults::default() };
    at_every_moment("worker with flipped bytes", async |cluster| joins(cluster, lies.clone())).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_that_says_everything_twice_joins() {
    let twice = Faults { deliver_twice: true, ..Faults::default() };
    at_every_moment("worker that delivers twice", async |cluster| joins(cluster, twice.clone())).await;
}

/// A worker in this process, with faults.
fn joins(cluster: &RealCluster, faults: Faults) -> tokio::task::JoinHandle<()> {
    let config = WorkerConfig { threads: 1, faults, ..WorkerConfig::new("faulty") };
    let connector = Connector::url(&cluster.url).unwrap_or_else(|e| panic!("{e}"));
    tokio::spawn(async move { drop(gatherlight_worker::run(config, connector, std::future::pending()).await) })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_loses_the_network() {
    at_every_moment("network cut to a worker that has just joined", async |cluster| {
        let address = cluster.url.trim_start_matches("http://").to_owned();
        let cable = Cable::to(&address);
        let remote = worker(&cable.url, "remote");
        // It has leases by now, or will see none.
        tokio::time::sleep(Duration::from_millis(150)).await;
        cable.set_cut(true);
        (cable, remote)
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_coordinator_is_killed() {
    at_every_moment("coordinator killed and started again", async |cluster| {
        cluster.kill();
        cluster.start_again();
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn everything_is_killed() {
    at_every_moment("coordinator and all workers killed and started again", async |cluster| {
        cluster.kill();
        cluster.workers.drain(..).for_each(Process::kill);
        cluster.start_again();
        cluster.workers = (0..3).map(|i| worker(&cluster.url, &format!("worker-{i}"))).collect();
    })
    .await;
}

//! The real coordinator, killed with SIGKILL in each phase and started again on the same store: its jobs go on, clients that watch or
//! submit come back, and the image has the same bits.

use gatherlight::client::{Client, connect};
use gatherlight::embedded;
use gatherlight::types::{JobId, JobProgress, JobState};
use gatherlight_render::settings::{Merge, Method, RenderSettings};
use gatherlight_tests::cluster::{PATIENCE, finished_exr, request, watch_until};
use gatherlight_tests::processes::{Process, serve_at, worker};
use gatherlight_tests::{film_pixels_sha256, pixel_sha256, scene};
use std::net::TcpListener;
use tempfile::TempDir;

/// A coordinator that can be started again at the same address, with two workers.
struct Cluster {
    store: TempDir,
    address: String,
    coordinator: Option<Process>,
    _workers: [Process; 2],
    client: Client,
}

/// An address of this machine that nobody listens on.
fn free_address() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    listener.local_addr().expect("has an address").to_string()
}

impl Cluster {
    async fn start() -> Self {
        let (store, address) = (tempfile::tempdir().expect("a directory"), free_address());
        let coordinator = serve_at(&address, store.path());
        let url = format!("http://{address}");
        let client = connect(&url, 5).await.unwrap_or_else(|e| panic!("{e}"));
        let workers = ["first", "second"].map(|name| worker(&url, name));
        Cluster { store, address, coordinator: Some(coordinator), _workers: workers, client }
    }
    fn kill(&mut self) {
        self.coordinator.take().expect("runs").kill();
    }
    fn start_again(&mut self) {
        self.coordinator = Some(serve_at(&self.address, self.store.path()));
    }
}

fn settings(method: Method) -> RenderSettings {
    let small = RenderSettings { method, width: 96, height: 80, k: 40, ..RenderSettings::default() };
    match method {
        Method::Progressive | Method::Vcm => {
            RenderSettings { rounds: 24, photons: 40_000, caustic_photons: 40_000, ..small }
        }
        Method::Mlt => RenderSettings { mutations: 64, chains: 64, bootstrap: 200_000, ..small },
        _ => RenderSettings { samples: 16, photons: 500_000, caustic_photons: 300_000, ..small },
    }
}

fn right_pixels(settings: &RenderSettings) -> String {
    let (bundle, settings) = (scene("caustic-ring.glb"), settings.clone());
    let render = move || embedded::render(&bundle, &settings, &embedded::Config::default(), |_| {});
    let result = std::thread::spawn(render).join().expect("did not panic").unwrap_or_else(|e| panic!("{e}"));
    film_pixels_sha256(&result.film)
}

/// Kills the coordinator once `there` is seen of a job, starts it again, and checks the image. Returns the job's last snapshot
/// before and the final one.
async fn killed_in(settings: &RenderSettings, there: impl Fn(&JobProgress) -> bool) -> [JobProgress; 2] {
    let mut cluster = Cluster::start().await;
    let bundle = scene("caustic-ring.glb");
    let submitted = cluster.client.submit(&request(&bundle, settings), |_, _| {}).await;
    let id = submitted.unwrap_or_else(|e| panic!("{e}"));
    let before = watch_until(&cluster.client, id, there).await;
    // Somebody watches throughout.
    let client = cluster.client.clone();
    let watching = tokio::spawn(async move { finished_exr(&client, id).await });
    cluster.kill();
    cluster.start_again();
    let exr = tokio::time::timeout(PATIENCE, watching).await.expect("ends").expect("did not panic");
    assert_eq!(pixel_sha256(&exr), right_pixels(settings));
    let after = cluster.client.get(id).await.unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(after.stats.restarts, 1);
    [before, after]
}

fn is_in(state: fn(&JobState) -> bool, part: f64) -> impl Fn(&JobProgress) -> bool {
    move |p| state(&p.state) && p.done as f64 >= part * p.total as f64 && p.done > 0
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn in_emission() {
    let [before, after] =
        killed_in(&settings(Method::Photon), is_in(|s| matches!(s, JobState::Emission(_)), 0.5)).await;
    // What was accepted before is not traced again.
    let emitted = |p: &JobProgress| p.stats.maps.iter().map(|m| m.emitted_count).sum::<u64>();
    assert!(emitted(&before) > 0);
    assert_eq!(emitted(&after), 800_000);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn in_gather() {
    // Where the samples go is decided by then.
    let adaptive = RenderSettings { adaptive: true, ..settings(Method::Photon) };
    let [before, after] = killed_in(&adaptive, is_in(|s| *s == JobState::Gather, 0.6)).await;
    let whole = after.stats.rays as f64;
    assert!(before.stats.rays as f64 > 0.2 * whole, "{} of {whole} rays before", before.stats.rays);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn between_the_rounds_of_progressive_photon_mapping() {
    killed_in(&settings(Method::Progressive), |p| p.stats.rounds_done >= 9).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn amid_independent_rounds() {
    let settings = RenderSettings { merge: Merge::Independent, ..settings(Method::Vcm) };
    killed_in(&settings, |p| p.stats.units_done >= 9).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn in_bootstrap_and_amid_markov_chains() {
    killed_in(&settings(Method::Mlt), |p| p.state == JobState::Bootstrap && p.done > 0).await;
    killed_in(&settings(Method::Mlt), |p| p.stats.units_done >= 16).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn while_the_image_is_put_together_and_after_the_job_is_done() {
    let mut cluster = Cluster::start().await;
    let settings = RenderSettings { samples: 1, photons: 1_000, caustic_photons: 0, ..settings(Method::Photon) };
    let request = request(&scene("caustic-ring.glb"), &settings);
    let id = cluster.client.submit(&request, |_, _| {}).await.unwrap_or_else(|e| panic!("{e}"));
    let exr = finished_exr(&cluster.client, id).await;
    cluster.kill();
    cluster.start_again();
    // Done jobs are listed as they were, and their images are there.
    let listed = cluster.client.list().await.unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(listed.iter().map(|p| (p.id, p.state.clone())).collect::<Vec<_>>(), [(id, JobState::Done)]);
    assert!(finished_exr(&cluster.client, id).await == exr);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn again_and_again() {
    let mut cluster = Cluster::start().await;
    let settings = RenderSettings { samples: 32, ..settings(Method::Photon) };
    let submit = request(&scene("caustic-ring.glb"), &settings);
    let id: JobId = cluster.client.submit(&submit, |_, _| {}).await.unwrap_or_else(|e| panic!("{e}"));
    for _ in 0..4 {
        tokio::time::sleep(std::time::Duration::from_millis(700)).await;
        cluster.kill();
        cluster.start_again();
    }
    let exr = finished_exr(&cluster.client, id).await;
    assert_eq!(pixel_sha256(&exr), right_pixels(&settings));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_may_submit_while_no_coordinator_runs() {
    let mut cluster = Cluster::start().await;
    cluster.kill();
    let settings = RenderSettings { samples: 1, photons: 1_000, caustic_photons: 0, ..settings(Method::Photon) };
    let (client, submit) = (cluster.client.clone(), request(&scene("caustic-ring.glb"), &settings));
    let submitting = tokio::spawn(async move { client.submit(&submit, |_, _| {}).await });
    tokio::time::sleep(std::time::Duration::from_millis(500)).await;
    cluster.start_again();
    let id = tokio::time::timeout(PATIENCE, submitting).await.expect("ends").expect("did not panic");
    let id = id.unwrap_or_else(|e| panic!("{e}"));
    finished_exr(&cluster.client, id).await;
    assert_eq!(cluster.client.list().await.unwrap_or_else(|e| panic!("{e}")).len(), 1);
}

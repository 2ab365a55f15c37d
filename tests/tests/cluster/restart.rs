//! The real coordinator, killed with SIGKILL in each phase and started again on the same store: its jobs go on, clients that watch or
//! submit come back, and the image has the same bits.

use gatherlight::types::{JobId, JobProgress, JobState};
use gatherlight_render::settings::{Merge, Method, RenderSettings};
use gatherlight_tests::cluster::{PATIENCE, finished_exr, request, watch_until};
use gatherlight_tests::real_cluster::{RealCluster, right_pixels, settings};
use gatherlight_tests::{pixel_sha256, scene};

/// Kills the coordinator once `there` is seen of a job, starts it again, and checks the image. Returns the job's last snapshot
/// before and the final one.
async fn killed_in(settings: &RenderSettings, there: impl Fn(&JobProgress) -> bool) -> [JobProgress; 2] {
    let mut cluster = RealCluster::start(2).await;
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
    let mut cluster = RealCluster::start(2).await;
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
    let mut cluster = RealCluster::start(2).await;
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
    let mut cluster = RealCluster::start(2).await;
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

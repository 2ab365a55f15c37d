//! Full disks, damaged stores and stores that nobody can use: clear errors, and never a wrong image.

use gatherlight::client::connect;
use gatherlight::types::JobState;
use gatherlight_render::settings::{Method, RenderSettings};
use gatherlight_tests::cluster::{finished_exr, request, watch_until};
use gatherlight_tests::processes::{program, serve_at, serve_with_files_up_to, worker};
use gatherlight_tests::real_cluster::{RealCluster, free_address, right_pixels, settings};
use gatherlight_tests::{pixel_sha256, scene};
use std::time::Duration;

async fn right(settings: &RenderSettings) -> String {
    let settings = settings.clone();
    tokio::task::spawn_blocking(move || right_pixels(&settings)).await.expect("did not panic")
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_disk_that_fills_up_costs_the_restart_and_not_the_image() {
    let store = tempfile::tempdir().expect("a directory");
    let address = free_address();
    // Room for the database as it is made and for the image, but not for the photons.
    let limited = serve_with_files_up_to(4 << 20, &address, store.path());
    let url = format!("http://{address}");
    let client = connect(&url, 5).await.unwrap_or_else(|e| panic!("{e}"));
    let _workers = ["a", "b"].map(|name| worker(&url, name));
    let settings = settings(Method::Photon);
    let id = client.submit(&request(&scene("caustic-ring.glb"), &settings), |_, _| {}).await;
    let id = id.unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(pixel_sha256(&finished_exr(&client, id).await), right(&settings).await);
    // After a restart with room again the coordinator serves, whatever it knows of the job.
    limited.kill();
    let _coordinator = serve_at(&address, store.path());
    let again = client.submit(&request(&scene("caustic-ring.glb"), &settings), |_, _| {}).await;
    let again = again.unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(pixel_sha256(&finished_exr(&client, again).await), right(&settings).await);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_damaged_database_is_refused_in_words_and_may_be_moved_away() {
    let mut cluster = RealCluster::start(2).await;
    // Enough of them that the job is not over when the coordinator dies: its results would be nothing but free space.
    let settings = RenderSettings { samples: 128, ..settings(Method::Photon) };
    let bundle = scene("caustic-ring.glb");
    let id = cluster.client.submit(&request(&bundle, &settings), |_, _| {}).await;
    let id = id.unwrap_or_else(|e| panic!("{e}"));
    watch_until(&cluster.client, id, |p| p.state == JobState::Gather && p.done > 20).await;
    cluster.kill();
    // Every result of the gather phase has a flipped bit.
    let path = cluster.store.path().join("jobs.redb");
    let mut bytes = std::fs::read(&path).expect("is there");
    let tiles: Vec<usize> =
        bytes.windows(4).enumerate().filter(|(_, w)| w == b"GLTI").map(|(place, _)| place).collect();
    assert!(tiles.len() >= 4, "{} results are kept", tiles.len());
    for place in tiles {
        bytes[place + 100] ^= 4;
    }
    std::fs::write(&path, bytes).expect("is written");
    let (code, text) = serve_and_end(cluster.store.path()).await;
    assert!(code == Some(1) && text.contains("jobs.redb") && text.contains("move it away"), "{code:?} {text}");
    std::fs::rename(&path, cluster.store.path().join("damaged")).expect("is moved");
    cluster.start_again();
    let again = cluster.client.submit(&request(&bundle, &settings), |_, _| {}).await;
    let again = again.unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(pixel_sha256(&finished_exr(&cluster.client, again).await), right(&settings).await);
}

/// A coordinator that is expected to end by itself, within a minute: its exit code and what it says.
async fn serve_and_end(store: &std::path::Path) -> (Option<i32>, String) {
    let mut command = tokio::process::Command::new(program("gatherlight"));
    command.args(["serve", "--listen", "127.0.0.1:0", "--store"]).arg(store).kill_on_drop(true);
    let ended = tokio::time::timeout(Duration::from_secs(60), command.output()).await;
    let ended = ended.expect("it serves instead").expect("runs");
    (ended.status.code(), String::from_utf8_lossy(&ended.stderr).into_owned())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_whose_scene_is_damaged_fails_and_says_so() {
    let mut cluster = RealCluster::start(2).await;
    let settings = settings(Method::Photon);
    let id = cluster.client.submit(&request(&scene("caustic-ring.glb"), &settings), |_, _| {}).await;
    let id = id.unwrap_or_else(|e| panic!("{e}"));
    watch_until(&cluster.client, id, |p| p.done > 0).await;
    cluster.kill();
    let blobs = std::fs::read_dir(cluster.store.path().join("blobs")).expect("is there");
    for blob in blobs.flatten() {
        std::fs::write(blob.path(), b"rust").expect("is written");
    }
    cluster.start_again();
    let last = watch_until(&cluster.client, id, |p| p.state.is_final()).await;
    let JobState::Failed(reason) = last.state else { panic!("{last:?}") };
    assert!(reason.contains("restart") && reason.contains("damaged"), "{reason}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_store_that_is_no_database_or_is_in_use_is_refused_in_words() {
    let store = tempfile::tempdir().expect("a directory");
    std::fs::write(store.path().join("jobs.redb"), vec![7; 100_000]).expect("is written");
    let (code, text) = serve_and_end(store.path()).await;
    assert!(code == Some(1) && text.contains("as the store") && text.contains("jobs.redb"), "{code:?} {text}");
    std::fs::remove_file(store.path().join("jobs.redb")).expect("was there");
    let _first = serve_at(&free_address(), store.path());
    let (code, text) = serve_and_end(store.path()).await;
    assert!(code == Some(1) && text.contains("another coordinator"), "{code:?} {text}");
}

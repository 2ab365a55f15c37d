//! Two hundred small jobs while workers and coordinator are killed at random: nothing is lost, and nothing piles up.

use gatherlight_render::settings::{Method, RenderSettings};
use gatherlight_tests::cluster::{finished_exr, request};
use gatherlight_tests::processes::{resident, worker};
use gatherlight_tests::random::Random;
use gatherlight_tests::real_cluster::{RealCluster, right_pixels, settings};
use gatherlight_tests::{pixel_sha256, scene};
use std::path::Path;

fn small(seed: u64) -> RenderSettings {
    let methods = [Method::Photon, Method::Path, Method::Progressive, Method::Mlt];
    let method = methods[seed as usize % methods.len()];
    let (photons, caustic_photons) = (3_000, 3_000);
    RenderSettings {
        width: 32,
        height: 24,
        samples: 2,
        rounds: 6,
        mutations: 4,
        chains: 16,
        bootstrap: 2_000,
        photons,
        caustic_photons,
        k: 20,
        ..settings(method)
    }
}

/// Resident memory in bytes and open files of a process.
fn footprint(process: u32) -> (u64, usize) {
    let files = std::fs::read_dir(format!("/proc/{process}/fd")).expect("runs").count();
    (resident(process).expect("runs"), files)
}

fn files_in(directory: &Path) -> usize {
    std::fs::read_dir(directory).expect("a directory").count()
}

async fn run(cluster: &mut RealCluster, jobs: u64, mut strike: impl FnMut(&mut RealCluster, u64)) {
    let bundle = scene("caustic-ring.glb");
    for number in 0..jobs {
        let settings = small(number);
        let id = cluster.client.submit(&request(&bundle, &settings), |_, _| {}).await;
        let id = id.unwrap_or_else(|e| panic!("{e}"));
        strike(cluster, number);
        let exr = finished_exr(&cluster.client, id).await;
        let expected = tokio::task::spawn_blocking(move || right_pixels(&settings)).await.expect("did not panic");
        assert_eq!(pixel_sha256(&exr), expected, "job {number}");
    }
}

#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_hundred_jobs_and_killed_workers_leave_nothing_behind() {
    let mut cluster = RealCluster::start(2).await;
    let mut random = Random(7);
    let mut kill_workers = |cluster: &mut RealCluster, number: u64| {
        if random.next().is_multiple_of(4) {
            let victim = random.next() as usize % cluster.workers.len();
            cluster.workers.remove(victim).kill();
            let fresh = worker(&cluster.url, &format!("fresh-{number}"));
            cluster.workers.push(fresh);
        }
    };
    run(&mut cluster, 60, &mut kill_workers).await;
    let before = footprint(cluster.coordinator_id());
    run(&mut cluster, 140, &mut kill_workers).await;
    let after = footprint(cluster.coordinator_id());
    // Two hundred records of jobs, and an allocator that keeps some pages, but no maps, films or sockets.
    assert!(after.0 < before.0 + (24 << 20), "memory: {} bytes after 60 jobs, {} after 200", before.0, after.0);
    assert!(after.1 <= before.1 + 4, "open files: {} after 60 jobs, {} after 200", before.1, after.1);
    // The scene, and one image of each method.
    assert!(files_in(&cluster.store.path().join("blobs")) <= 1 + 4);
    assert_eq!(files_in(&cluster.store.path().join("partial")), 0);
    assert_eq!(cluster.client.list().await.unwrap_or_else(|e| panic!("{e}")).len(), 200);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_coordinator_that_is_killed_again_and_again_keeps_its_store_small() {
    let mut cluster = RealCluster::start(2).await;
    let mut random = Random(11);
    let mut kill_coordinator = |cluster: &mut RealCluster, _: u64| {
        if random.next().is_multiple_of(3) {
            cluster.kill();
            cluster.start_again();
        }
    };
    run(&mut cluster, 40, &mut kill_coordinator).await;
    let length = std::fs::metadata(cluster.store.path().join("jobs.redb")).expect("is there").len();
    assert!(length < 64 << 20, "{length} bytes for jobs that have ended");
    assert!(files_in(&cluster.store.path().join("blobs")) <= 1 + 4);
}

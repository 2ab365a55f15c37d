//! The image has the same bits for any number of workers and threads, any order of tasks, and whoever is lost on the
//! way.

use gatherlight::embedded::{Config, render};
use gatherlight::types::JobResult;
use gatherlight_render::import::SceneBundle;
use gatherlight_render::settings::{Layer, Method, RenderSettings};
use gatherlight_tests::cluster::{small_leases, small_settings};
use gatherlight_tests::{film_sha256, scene};
use gatherlight_worker::Faults;
use std::sync::LazyLock;
use std::time::Duration;

static RING: LazyLock<SceneBundle> = LazyLock::new(|| scene("caustic-ring.glb"));

fn settings() -> RenderSettings {
    RenderSettings { layers: vec![Layer::Direct, Layer::Caustic, Layer::Variance], ..small_settings() }
}

fn rendered(workers: usize, threads: usize, change: impl FnOnce(&mut Config)) -> JobResult {
    let mut config = Config { workers, threads, policy: small_leases(), ..Config::default() };
    change(&mut config);
    render(&RING, &settings(), &config, |_| {}).unwrap_or_else(|e| panic!("{e}"))
}

static REFERENCE: LazyLock<String> = LazyLock::new(|| {
    let config = Config { threads: 1, ..Config::default() };
    let result = render(&RING, &settings(), &config, |_| {}).unwrap_or_else(|e| panic!("{e}"));
    assert!(result.film.pixels.iter().any(|&v| v > 0.0), "the image is black");
    film_sha256(&result.film)
});

fn assert_same_bits(result: &JobResult) {
    assert_eq!(film_sha256(&result.film), *REFERENCE);
}

/// Straight through the phases, without a cluster: the cluster must not change what is computed.
#[test]
fn the_cluster_computes_what_one_process_computes() {
    let job = gatherlight_render::job::PreparedJob::prepare(&RING, &settings()).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(film_sha256(&gatherlight_tests::single::render(&job)), *REFERENCE);
}

#[test]
fn workers_and_threads_do_not_matter() {
    for (workers, threads) in [(1, 2), (2, 1), (2, 2), (7, 1)] {
        let result = rendered(workers, threads, |_| {});
        assert_same_bits(&result);
        assert_eq!(result.stats.retried_leases, 0, "{workers} workers");
    }
}

#[test]
fn the_order_of_tasks_does_not_matter() {
    for seed in 0..3 {
        assert_same_bits(&rendered(2, 1, |c| c.policy.shuffle = Some(seed)));
    }
}

#[test]
fn a_worker_lost_in_each_phase_does_not_matter() {
    let dies = [
        Faults { die_at_emission: Some(0), ..Faults::default() },
        Faults { die_at_emission: Some(3), ..Faults::default() },
        Faults { die_at_gather: Some(0), ..Faults::default() },
        Faults { die_at_gather: Some(2), ..Faults::default() },
    ];
    for fault in dies {
        // The others are held back a little, so that the one that dies gets its turn.
        let slow = Faults { delay: Duration::from_millis(2), ..Faults::default() };
        let result = rendered(3, 1, |c| c.faults = vec![fault.clone(), slow.clone(), slow]);
        assert_same_bits(&result);
        assert!(result.stats.retried_leases > 0, "{fault:?} did not strike");
    }
}

#[test]
fn results_delivered_twice_or_damaged_do_not_matter() {
    let twice = Faults { deliver_twice: true, ..Faults::default() };
    assert_same_bits(&rendered(2, 1, |c| c.faults = vec![twice.clone(), twice]));
    let corrupt = Faults { corrupt: true, ..Faults::default() };
    let slow = Faults { delay: Duration::from_millis(2), ..Faults::default() };
    let result = rendered(2, 1, |c| c.faults = vec![corrupt, slow]);
    assert_same_bits(&result);
    assert!(result.stats.retried_leases > 0);
}

#[test]
fn a_path_traced_image_needs_no_photons_and_has_the_same_bits_too() {
    let settings = RenderSettings { method: Method::Path, ..settings() };
    let with = |workers| {
        let config = Config { workers, threads: 1, policy: small_leases(), ..Config::default() };
        render(&RING, &settings, &config, |_| {}).unwrap_or_else(|e| panic!("{e}"))
    };
    let (one, three) = (with(1), with(3));
    assert_eq!(film_sha256(&one.film), film_sha256(&three.film));
    assert!(one.stats.maps.is_empty());
}

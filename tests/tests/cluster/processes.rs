//! Whole jobs with the real programs as processes, which are killed, frozen and asked to leave while they work.

use gatherlight::types::{JobId, JobProgress, JobState};
use gatherlight_proto::version::Versions;
use gatherlight_render::settings::RenderSettings;
use gatherlight_tests::cluster::{finished_exr, request, watch_until};
use gatherlight_tests::processes::{Process, worker};
use gatherlight_tests::real_cluster::{RealCluster, right_pixels};
use gatherlight_tests::{pixel_sha256, scene};
use gatherlight_worker::{Connector, WorkerConfig, WorkerError};

/// Some seconds of work in each phase for two slow workers, so that there is time to kill one.
fn settings() -> RenderSettings {
    RenderSettings {
        width: 112,
        height: 96,
        samples: 12,
        photons: 600_000,
        caustic_photons: 300_000,
        k: 40,
        ..RenderSettings::default()
    }
}

async fn submit(c: &RealCluster) -> JobId {
    let request = request(&scene("caustic-ring.glb"), &settings());
    c.client.submit(&request, |_, _| {}).await.unwrap_or_else(|e| panic!("{e}"))
}

async fn assert_right_image(c: &RealCluster, id: JobId) -> JobProgress {
    let exr = finished_exr(&c.client, id).await;
    let right = tokio::task::spawn_blocking(|| right_pixels(&settings())).await.expect("did not panic");
    assert_eq!(pixel_sha256(&exr), right);
    c.client.get(id).await.unwrap_or_else(|e| panic!("{e}"))
}

fn in_emission(p: &JobProgress) -> bool {
    matches!(p.state, JobState::Emission(_)) && p.done > 0 && p.workers == 2
}

fn in_gather(p: &JobProgress) -> bool {
    p.state == JobState::Gather && p.done > 0 && p.workers == 2
}

/// Two workers; one of them suffers `fate` as soon as `when` is seen; the other does the rest.
async fn one_suffers(
    when: impl Fn(&JobProgress) -> bool,
    fate: impl FnOnce(Process) -> Option<Process>,
) -> JobProgress {
    let c = RealCluster::start(0).await;
    let (victim, _other) = (worker(&c.url, "victim"), worker(&c.url, "other"));
    let id = submit(&c).await;
    watch_until(&c.client, id, when).await;
    let _remains = fate(victim);
    assert_right_image(&c, id).await
}

fn kill(victim: Process) -> Option<Process> {
    victim.kill();
    None
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_killed_in_emission_costs_only_its_leases() {
    assert!(one_suffers(in_emission, kill).await.stats.retried_leases > 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_killed_in_gather_costs_only_its_leases() {
    assert!(one_suffers(in_gather, kill).await.stats.retried_leases > 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_out_of_memory_costs_only_its_leases() {
    let starve = |victim: Process| {
        victim.starve();
        assert_eq!(victim.exit_code(), None, "it is aborted by a signal");
        None
    };
    let last = one_suffers(in_emission, starve).await;
    assert!(last.stats.retried_leases > 0 && last.stats.workers_lost == 1, "{:?}", last.stats);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_frozen_worker_holds_nothing_up() {
    // The other one repeats its leases, or gets them once it is given up: whichever comes first.
    let freeze = |victim: Process| {
        victim.signal("STOP");
        Some(victim)
    };
    let last = one_suffers(in_gather, freeze).await;
    assert_eq!((last.stats.workers, last.stats.disputes), (2, 0));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_asked_to_terminate_leaves_with_exit_code_0() {
    let terminate = |victim: Process| {
        victim.signal("TERM");
        assert_eq!(victim.exit_code(), Some(0));
        None
    };
    one_suffers(in_emission, terminate).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_late_joiner_is_used_and_the_first_may_then_die() {
    let c = RealCluster::start(0).await;
    let first = worker(&c.url, "first");
    let id = submit(&c).await;
    watch_until(&c.client, id, |p| p.done > 0).await;
    let _late = worker(&c.url, "late");
    watch_until(&c.client, id, |p| p.workers == 2).await;
    first.kill();
    assert_right_image(&c, id).await;
    let workers = c.client.workers().await.unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(workers.iter().map(|w| w.name.as_str()).collect::<Vec<_>>(), ["late"]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_of_another_version_is_refused_by_the_real_coordinator() {
    let c = RealCluster::start(0).await;
    let versions = Versions { protocol: 77, program: "0.0.1".into() };
    let config = WorkerConfig { versions, ..WorkerConfig::new("old") };
    let connector = Connector::url(&c.url).unwrap_or_else(|e| panic!("{e}"));
    let ended = gatherlight_worker::run(config, connector, std::future::pending()).await;
    let Err(WorkerError::Refused { reason, .. }) = ended else { panic!("was not refused: {ended:?}") };
    assert!(reason.contains("protocol 77") && reason.contains(gatherlight_render::VERSION), "{reason}");
}

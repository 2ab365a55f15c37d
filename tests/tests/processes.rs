//! Whole jobs with the real programs as processes, which are killed, frozen and asked to leave while they work.

use gatherlight::client::{Client, connect};
use gatherlight::embedded;
use gatherlight::types::{JobId, JobProgress, JobState};
use gatherlight_proto::version::Versions;
use gatherlight_render::import::SceneBundle;
use gatherlight_render::settings::RenderSettings;
use gatherlight_tests::cluster::{finished_exr, request, watch_until};
use gatherlight_tests::processes::{Process, serve, worker};
use gatherlight_tests::{film_pixels_sha256, pixel_sha256, scene};
use gatherlight_worker::{Connector, WorkerConfig, WorkerError};
use std::sync::LazyLock;
use tempfile::TempDir;

static RING: LazyLock<SceneBundle> = LazyLock::new(|| scene("caustic-ring.glb"));

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

static REFERENCE: LazyLock<String> = LazyLock::new(|| {
    let render = || embedded::render(&RING, &settings(), &embedded::Config::default(), |_| {});
    let result = std::thread::spawn(render).join().expect("did not panic").unwrap_or_else(|e| panic!("{e}"));
    film_pixels_sha256(&result.film)
});

struct Cluster {
    _store: TempDir,
    _coordinator: Process,
    url: String,
    client: Client,
}

async fn cluster() -> Cluster {
    let store = tempfile::tempdir().expect("a directory");
    let (coordinator, url) = serve(store.path());
    let client = connect(&url, 5).await.unwrap_or_else(|e| panic!("{e}"));
    Cluster { _store: store, _coordinator: coordinator, url, client }
}

impl Cluster {
    async fn submit(&self) -> JobId {
        self.client.submit(&request(&RING, &settings()), |_, _| {}).await.unwrap_or_else(|e| panic!("{e}"))
    }
    async fn assert_right_image(&self, id: JobId) -> JobProgress {
        let exr = finished_exr(&self.client, id).await;
        let reference = tokio::task::spawn_blocking(|| REFERENCE.as_str()).await.expect("did not panic");
        assert_eq!(pixel_sha256(&exr), reference);
        self.client.get(id).await.unwrap_or_else(|e| panic!("{e}"))
    }
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
    let c = cluster().await;
    let (victim, _other) = (worker(&c.url, "victim"), worker(&c.url, "other"));
    let id = c.submit().await;
    watch_until(&c.client, id, when).await;
    let _remains = fate(victim);
    c.assert_right_image(id).await
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
    let c = cluster().await;
    let first = worker(&c.url, "first");
    let id = c.submit().await;
    watch_until(&c.client, id, |p| p.done > 0).await;
    let _late = worker(&c.url, "late");
    watch_until(&c.client, id, |p| p.workers == 2).await;
    first.kill();
    c.assert_right_image(id).await;
    let workers = c.client.workers().await.unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(workers.iter().map(|w| w.name.as_str()).collect::<Vec<_>>(), ["late"]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_of_another_version_is_refused_by_the_real_coordinator() {
    let c = cluster().await;
    let versions = Versions { protocol: 77, program: "0.0.1".into() };
    let config = WorkerConfig { versions, ..WorkerConfig::new("old") };
    let connector = Connector::url(&c.url).unwrap_or_else(|e| panic!("{e}"));
    let ended = gatherlight_worker::run(config, connector, std::future::pending()).await;
    let Err(WorkerError::Refused { reason, .. }) = ended else { panic!("was not refused: {ended:?}") };
    assert!(reason.contains("protocol 77") && reason.contains(gatherlight_render::VERSION), "{reason}");
}

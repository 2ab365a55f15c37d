//! Whole jobs on a coordinator and workers over TCP, in this process: what is right, and what goes wrong.

use gatherlight::client::{ClientError, SubmitRequest, connect, connect_as};
use gatherlight::embedded;
use gatherlight::schedule::Policy;
use gatherlight::server::ServeConfig;
use gatherlight::types::{JobId, JobState, Limits};
use gatherlight_proto::collective::{Collective, Transfer};
use gatherlight_proto::version::Versions;
use gatherlight_render::import::SceneBundle;
use gatherlight_render::job::{Phase, PreparedJob};
use gatherlight_render::settings::{Merge, Method, RenderSettings};
use gatherlight_tests::cluster::{
    Coordinator, final_state, finished_exr, request, small_leases, small_settings, watch_until,
};
use gatherlight_tests::{film_pixels_sha256, pixel_sha256, scene};
use gatherlight_worker::{Connector, Faults, WorkerConfig, WorkerError};
use std::sync::LazyLock;
use std::time::Duration;
use tempfile::TempDir;

static RING: LazyLock<SceneBundle> = LazyLock::new(|| scene("caustic-ring.glb"));

/// What `render` makes of the small job.
static REFERENCE: LazyLock<String> = LazyLock::new(|| {
    let config = embedded::Config { threads: 1, ..embedded::Config::default() };
    let result = std::thread::spawn(move || embedded::render(&RING, &small_settings(), &config, |_| {}));
    let result = result.join().expect("did not panic").unwrap_or_else(|e| panic!("{e}"));
    film_pixels_sha256(&result.film)
});

async fn reference() -> &'static str {
    tokio::task::spawn_blocking(|| REFERENCE.as_str()).await.expect("did not panic")
}

async fn start(policy: Policy) -> (TempDir, Coordinator) {
    let directory = tempfile::tempdir().expect("a directory");
    let coordinator = Coordinator::start(directory.path(), policy).await;
    (directory, coordinator)
}

fn slow(ms: u64) -> Faults {
    Faults { delay: Duration::from_millis(ms), ..Faults::default() }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_submitted_job_gives_the_image_that_render_gives() {
    let (_store, coordinator) = start(small_leases()).await;
    let _workers = [coordinator.worker("a", slow(0)), coordinator.worker("b", slow(0))];
    let client = coordinator.client().await;
    let mut uploads = Vec::new();
    let id = client.submit(&request(&RING, &small_settings()), |sent, total| uploads.push((sent, total))).await;
    let id = id.unwrap_or_else(|e| panic!("{e}"));
    let size = RING.root.len() as u64;
    assert_eq!(uploads.last(), Some(&(size, size)));
    assert_eq!(pixel_sha256(&finished_exr(&client, id).await), reference().await);
    let job = client.get(id).await.unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(job.stats.maps.iter().map(|m| m.emitted_count).collect::<Vec<_>>(), [20_000, 30_000]);
    assert!(job.stats.broadcast_bytes > 0 && job.stats.rays > 0 && job.stats.result_bytes > 0);

    // The same scene again: nothing is uploaded; another seed: another image.
    let mut other = small_settings();
    other.seed = 1;
    let mut sent = Vec::new();
    let again =
        client.submit(&request(&RING, &other), |s, t| sent.push((s, t))).await.unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(sent, [(0, 0)]);
    assert_ne!(pixel_sha256(&finished_exr(&client, again).await), reference().await);
    let listed: Vec<JobId> = client.list().await.unwrap_or_else(|e| panic!("{e}")).iter().map(|j| j.id).collect();
    assert_eq!(listed, [id, again]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_that_joins_late_is_used() {
    let (_store, coordinator) = start(small_leases()).await;
    let client = coordinator.client().await;
    let id = client.submit(&request(&RING, &small_settings()), |_, _| {}).await.unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(client.get(id).await.unwrap_or_else(|e| panic!("{e}")).state, JobState::Waiting);
    let _early = coordinator.worker("early", slow(20));
    watch_until(&client, id, |p| p.done > 0).await;
    let _late = coordinator.worker("late", slow(20));
    assert_eq!(pixel_sha256(&finished_exr(&client, id).await), reference().await);
    let workers = client.workers().await.unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(workers.iter().map(|w| w.name.as_str()).collect::<Vec<_>>(), ["early", "late"]);
    assert!(workers.iter().all(|w| w.completed > 0 && w.threads == 1), "{workers:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_asked_to_stop_finishes_returns_and_leaves() {
    let (_store, coordinator) = start(small_leases()).await;
    let client = coordinator.client().await;
    let leaving = coordinator.worker("leaving", slow(20));
    let id = client.submit(&request(&RING, &small_settings()), |_, _| {}).await.unwrap_or_else(|e| panic!("{e}"));
    watch_until(&client, id, |p| p.done > 0).await;
    leaving.leave().await.unwrap_or_else(|e| panic!("{e}"));
    // What it had finished counts; what waited was returned, not lost.
    let _staying = coordinator.worker("staying", slow(0));
    assert_eq!(pixel_sha256(&finished_exr(&client, id).await), reference().await);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_cancelled_job_frees_its_workers_and_has_no_image() {
    let (_store, coordinator) = start(small_leases()).await;
    let _worker = coordinator.worker("w", slow(20));
    let client = coordinator.client().await;
    let id = client.submit(&request(&RING, &small_settings()), |_, _| {}).await.unwrap_or_else(|e| panic!("{e}"));
    watch_until(&client, id, |p| p.done > 0).await;
    assert_eq!(client.cancel(id).await.unwrap_or_else(|e| panic!("{e}")).state, JobState::Cancelled);
    assert_eq!(final_state(&client, id).await.state, JobState::Cancelled);
    let refused = client.fetch(id, |_, _| {}).await.expect_err("has no image").to_string();
    assert!(refused.contains("cancelled") && refused.contains(&id.to_string()), "{refused}");
    let workers = client.workers().await.unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((workers[0].leases, workers[0].state.as_str()), (0, "idle"));
    // Cancelling again changes nothing, and the worker takes the next job.
    assert_eq!(client.cancel(id).await.unwrap_or_else(|e| panic!("{e}")).state, JobState::Cancelled);
    let next = client.submit(&request(&RING, &small_settings()), |_, _| {}).await.unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(pixel_sha256(&finished_exr(&client, next).await), reference().await);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_jobs_share_the_cluster() {
    let (_store, coordinator) = start(small_leases()).await;
    let client = coordinator.client().await;
    let submit = async || client.submit(&request(&RING, &small_settings()), |_, _| {}).await;
    let (first, second) =
        (submit().await.unwrap_or_else(|e| panic!("{e}")), submit().await.unwrap_or_else(|e| panic!("{e}")));
    let _workers = [coordinator.worker("a", slow(10)), coordinator.worker("b", slow(10))];
    // The second is worked on before the first is done.
    watch_until(&client, second, |p| p.done > 0).await;
    assert!(!client.get(first).await.unwrap_or_else(|e| panic!("{e}")).state.is_final());
    for id in [first, second] {
        assert_eq!(pixel_sha256(&finished_exr(&client, id).await), reference().await);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_task_that_fails_everywhere_fails_the_job_with_the_workers_errors() {
    let (_store, coordinator) = start(Policy { patience: Duration::from_millis(200), ..small_leases() }).await;
    let broken = |text: &str| Faults { fail: Some(text.into()), ..Faults::default() };
    let _workers =
        [coordinator.worker("a", broken("disk on fire")), coordinator.worker("b", broken("disk under water"))];
    let client = coordinator.client().await;
    let id = client.submit(&request(&RING, &small_settings()), |_, _| {}).await.unwrap_or_else(|e| panic!("{e}"));
    let JobState::Failed(reason) = final_state(&client, id).await.state else { panic!("did not fail") };
    assert!(reason.contains("disk on fire") || reason.contains("disk under water"), "{reason}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_waits_for_a_worker_with_enough_memory_and_says_so() {
    let (_store, coordinator) = start(small_leases()).await;
    let small = WorkerConfig { threads: 1, memory_bytes: 1 << 20, ..WorkerConfig::new("small") };
    let _small = coordinator.worker_with(small);
    let client = coordinator.client().await;
    let id = client.submit(&request(&RING, &small_settings()), |_, _| {}).await.unwrap_or_else(|e| panic!("{e}"));
    let waiting = watch_until(&client, id, |p| p.waits_for.contains("memory")).await;
    assert_eq!(waiting.state, JobState::Waiting);
    assert!(waiting.waits_for.contains("has 1 MiB") && waiting.waits_for.contains("--memory"), "{waiting:?}");
    // One that has the memory does it all.
    let _large = coordinator.worker("large", Faults::default());
    let done = watch_until(&client, id, |p| p.state.is_final()).await;
    assert_eq!((done.state, done.stats.workers, done.waits_for.as_str()), (JobState::Done, 1, ""));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn limits_are_refused_with_the_flag_that_raises_them() {
    let refused = async |change: fn(&mut ServeConfig), flag: &str| {
        let directory = tempfile::tempdir().expect("a directory");
        let address = "127.0.0.1:0".parse().expect("an address");
        let mut config = ServeConfig { threads: 1, ..ServeConfig::new(address, directory.path().to_owned()) };
        change(&mut config);
        let coordinator = Coordinator::start_with(config).await;
        let submitted = coordinator.client().await.submit(&request(&RING, &small_settings()), |_, _| {}).await;
        let Err(ClientError::Refused(text)) = submitted else { panic!("{submitted:?}") };
        assert!(text.contains(flag), "{text}");
    };
    refused(|c| c.max_store_bytes = 1_000, "--max-store").await;
    refused(|c| c.max_job_bytes = 1_000, "--max-job-memory").await;
    refused(|c| c.max_live_jobs = 0, "--max-jobs").await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_time_limit_that_could_never_end_the_job_is_refused() {
    let (_store, coordinator) = start(small_leases()).await;
    let limits = Limits { time: Some(Duration::from_secs(9)), error: None };
    let settings = RenderSettings { samples: 1, ..small_settings() };
    let request = SubmitRequest { limits, ..request(&RING, &settings) };
    let submitted = coordinator.client().await.submit(&request, |_, _| {}).await;
    let Err(ClientError::Refused(text)) = submitted else { panic!("{submitted:?}") };
    assert!(text.contains("time limit") && text.contains("photon"), "{text}");
    let limits = Limits { time: None, error: Some(0.1) };
    let submitted = coordinator.client().await.submit(&SubmitRequest { limits, ..request }, |_, _| {}).await;
    let Err(ClientError::Refused(text)) = submitted else { panic!("{submitted:?}") };
    assert!(text.contains("error limit") && text.contains("photon"), "{text}");
}

/// Over the wire, where maps and bootstraps are encoded and fetched: for every method.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_method_gives_the_image_that_one_process_gives() {
    let (_store, coordinator) = start(small_leases()).await;
    let _workers = [coordinator.worker("a", slow(0)), coordinator.worker("b", slow(0))];
    let client = coordinator.client().await;
    let merges = |m: Method| if m.has_rounds() { &Merge::ALL[..] } else { &Merge::ALL[..1] };
    let mut scene_files = 0;
    for (method, merge) in Method::ALL.iter().flat_map(|&m| merges(m).iter().map(move |&merge| (m, merge))) {
        let settings = RenderSettings { method, merge, rounds: 12, chains: 24, mutations: 2, ..small_settings() };
        let id = client.submit(&request(&RING, &settings), |_, _| {}).await.unwrap_or_else(|e| panic!("{e}"));
        let exr = finished_exr(&client, id).await;
        let stats = client.get(id).await.unwrap_or_else(|e| panic!("{e}")).stats;
        let single = move || {
            let job = PreparedJob::prepare(&RING, &settings).unwrap_or_else(|e| panic!("{e}"));
            (job.phases(), film_pixels_sha256(&gatherlight_tests::single::render(&job)))
        };
        let (phases, expected) = tokio::task::spawn_blocking(single).await.expect("did not panic");
        let name = format!("{} {}", method.name(), merge.name());
        assert_eq!(pixel_sha256(&exr), expected, "{name}");
        // What workers read goes to each of them once, at most; where there is anything, some of it has to.
        let maps: u64 = stats.maps.iter().map(|m| m.bytes).sum();
        let bootstrap: u64 =
            phases.iter().map(|p| if let Phase::Bootstrap { paths } = p { 24 + 4 * paths } else { 0 }).sum();
        let read = maps + bootstrap;
        assert!((read.min(1)..=2 * read).contains(&stats.broadcast_bytes), "{name}: {read} in {stats:?}");
        assert_eq!(maps > 0, phases.iter().any(|p| matches!(p, Phase::Emission { .. })), "{name}");
        for (read, kind) in [
            (maps, Collective::BroadcastMap),
            (bootstrap, Collective::BroadcastBootstrap),
            (0, Collective::BroadcastSampleMap),
        ] {
            assert!(
                (read.min(1)..=2 * read).contains(&stats.transfers.of(kind).bytes),
                "{name}: {kind:?} in {stats:?}"
            );
        }
        // Files that are held from earlier jobs do not come again.
        scene_files += stats.transfers.of(Collective::BroadcastScene).count;
        // What comes together is what was received, kind by kind of the phases that the job has.
        let sent = stats.transfers.iter().filter(|(kind, _)| !kind.is_broadcast());
        assert_eq!(sent.map(|(_, t)| t.bytes).sum::<u64>(), stats.result_bytes, "{name}");
        for (kind, has) in [
            (Collective::GatherPhotons, maps > 0),
            (Collective::GatherLuminances, bootstrap > 0),
            (Collective::GatherTiles, phases.iter().any(|p| matches!(p, Phase::Gather { .. }))),
            (Collective::ReduceLight, phases.iter().any(|p| matches!(p, Phase::Splat { .. }))),
        ] {
            let Transfer { count, bytes, time } = stats.transfers.of(kind);
            assert_eq!([count > 0, bytes > 0, time > Duration::ZERO], [has; 3], "{name}: {kind:?}");
        }
    }
    assert_eq!(scene_files, 2, "one for each worker");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn other_versions_are_refused_with_both_versions_in_the_message() {
    let (_store, coordinator) = start(small_leases()).await;
    let other = Versions { protocol: 99, program: "9.8.7".into() };
    let own = Versions::own();
    let config = WorkerConfig { versions: other.clone(), ..WorkerConfig::new("old") };
    let Err(WorkerError::Refused { reason, .. }) = coordinator.worker_with(config).ended().await else {
        panic!("was not refused")
    };
    let client = connect_as(&coordinator.url(), 1, other).await.expect_err("was not refused");
    assert!(matches!(client, ClientError::Version(_)), "{client:?}");
    for text in [reason, client.to_string()] {
        for part in ["9.8.7", "protocol 99", &own.program, &format!("protocol {}", own.protocol)] {
            assert!(text.contains(part), "{text:?} lacks {part:?}");
        }
    }
    // The same protocol but another renderer: fine for a client, not for a worker.
    let program = Versions { program: "9.8.7".into(), ..own };
    assert!(connect_as(&coordinator.url(), 1, program.clone()).await.is_ok());
    let config = WorkerConfig { versions: program, ..WorkerConfig::new("other") };
    assert!(matches!(coordinator.worker_with(config).ended().await, Err(WorkerError::Refused { .. })));
}

#[tokio::test]
async fn an_unreachable_coordinator_is_named_after_bounded_attempts() {
    // A port that was free a moment ago.
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let url = format!("http://{}", listener.local_addr().expect("an address"));
    drop(listener);
    let error = connect(&url, 2).await.expect_err("nobody is there").to_string();
    assert!(error.contains(&url) && error.contains("2 attempts"), "{error}");
    let config = WorkerConfig { max_attempts: 2, ..WorkerConfig::new("lonely") };
    let connector = Connector::url(&url).unwrap_or_else(|e| panic!("{e}"));
    let error = gatherlight_worker::run(config, connector, std::future::pending()).await.expect_err("nobody is there");
    assert!(error.to_string().contains(&url) && error.to_string().contains("2 attempts"), "{error}");
    for bad in ["localhost:7420", "gopher://x", ""] {
        let error = connect(bad, 1).await.expect_err("is no URL").to_string();
        assert!(error.contains("http://localhost:7420"), "{error}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_broken_scene_and_an_unknown_job_are_refused_with_the_reason() {
    let (_store, coordinator) = start(small_leases()).await;
    let client = coordinator.client().await;
    let bundle = SceneBundle { name: "bad.glb".into(), root: (*b"not a scene").into(), externals: Vec::new() };
    let error = client.submit(&request(&bundle, &small_settings()), |_, _| {}).await.expect_err("is no scene");
    assert!(matches!(&error, ClientError::Refused(text) if text.contains("bad.glb")), "{error:?}");
    let unknown = JobId(0x1234_5678_9abc_def0);
    let error = client.get(unknown).await.expect_err("is unknown");
    assert!(matches!(&error, ClientError::NotFound(text) if text.contains("123456789abcdef0")), "{error:?}");
    assert!(client.cancel(unknown).await.is_err() && client.watch(unknown).await.is_err());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_comes_back_to_a_restarted_coordinator() {
    let store = tempfile::tempdir().expect("a directory");
    let coordinator = Coordinator::start(store.path(), small_leases()).await;
    let address = coordinator.address;
    let _worker = coordinator.worker("faithful", slow(0));
    let client = coordinator.client().await;
    while client.workers().await.unwrap_or_else(|e| panic!("{e}")).is_empty() {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    coordinator.stop().await;
    let again = Coordinator::start_on(address, store.path(), small_leases()).await;
    let client = again.client().await;
    // The scene is not in the new coordinator's memory: the second submission uploads it once more.
    let id = client.submit(&request(&RING, &small_settings()), |_, _| {}).await.unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(pixel_sha256(&finished_exr(&client, id).await), reference().await);
}

//! Every message survives the wire; nothing nonsensical gets through.

use crate::collective::{Collective, Transfer, Transfers};
use crate::digest::Digest;
use crate::message::{
    BlobRef, DeliverHeader, FromWorker, Hello, Lease, LeaseId, MapRef, PassRequest, PassTicket, RelayAddress, Route,
    SceneManifest, SessionKey, Task, ToWorker,
};
use crate::types::{JobId, JobProgress, JobState, JobStats, Limit, Limits, MapStats, NonFinite};
use crate::wire;
use gatherlight_render::film::light_image::Mutations;
use gatherlight_render::film::{Bias, Noise};
use gatherlight_render::photon::{EmissionRange, MapKind};
use gatherlight_render::settings::{CameraChoice, Estimator, Kernel, Merge, Method, RenderSettings};
use prost::Message;
use std::time::Duration;

fn settings() -> RenderSettings {
    RenderSettings {
        method: Method::Path,
        width: 3,
        height: 4,
        camera: CameraChoice::Name("Küche".into()),
        samples: 5,
        adaptive: false,
        seed: u64::MAX,
        max_depth: Some(6),
        photons: 7,
        caustic_photons: 8,
        divide_photons: true,
        k: 9,
        max_radius: Some(0.25),
        final_gather: 10,
        estimator: Estimator::Hash,
        kernel: Kernel::Epanechnikov,
        direct_from_map: false,
        rounds: 11,
        radius_alpha: 0.5,
        merge: Merge::Independent,
        chains: 12,
        mutations: 13,
        bootstrap: 14,
        large_step: 0.75,
        keep_all: true,
        layers: Method::Path.layers().to_vec(),
    }
}

fn blob(n: u8) -> BlobRef {
    BlobRef { digest: Digest([n; 32]), bytes: u64::from(n) }
}

fn manifest() -> SceneManifest {
    let externals = vec![("a b.bin".into(), blob(2)), ("c.png".into(), blob(3)), ("d.png".into(), blob(2))];
    SceneManifest { name: "box.gltf".into(), root: blob(1), externals }
}

#[test]
fn settings_survive_the_wire() {
    let cameras = [CameraChoice::First, CameraChoice::Index(0), CameraChoice::Name(String::new())];
    for s in cameras.map(|camera| RenderSettings { camera, ..settings() }).iter().chain([
        &settings(),
        &RenderSettings::default(),
        &RenderSettings { max_depth: None, max_radius: None, layers: Vec::new(), ..settings() },
        &RenderSettings { adaptive: true, samples: 16, ..settings() },
        &RenderSettings { direct_from_map: true, final_gather: 0, ..RenderSettings::default() },
    ]) {
        let bytes = wire::RenderSettings::from(s).encode_to_vec();
        let back = wire::RenderSettings::decode(&bytes[..]).expect("decodes");
        assert_eq!(RenderSettings::try_from(back).as_ref(), Ok(s));
    }
}

#[test]
fn nonsense_settings_are_refused() {
    let good = wire::RenderSettings::from(&settings());
    let bad = [
        wire::RenderSettings { width: 0, ..good.clone() },
        wire::RenderSettings { method: 0, ..good.clone() },
        wire::RenderSettings { kernel: 77, ..good.clone() },
        wire::RenderSettings { layers: vec![1, 1], ..good.clone() },
        wire::RenderSettings { layers: vec![1; 1_000], ..good.clone() },
        wire::RenderSettings { max_radius: Some(f32::NAN), ..good },
    ];
    for b in bad {
        assert!(RenderSettings::try_from(b.clone()).is_err(), "{b:?}");
    }
}

#[test]
fn a_manifest_survives_and_names_each_blob_once() {
    assert_eq!(SceneManifest::try_from(wire::SceneManifest::from(&manifest())), Ok(manifest()));
    assert_eq!(manifest().blobs(), [blob(1), blob(2), blob(3)]);
}

#[test]
fn manifests_without_root_or_with_short_digests_are_refused() {
    let good = wire::SceneManifest::from(&manifest());
    assert!(SceneManifest::try_from(wire::SceneManifest { root: None, ..good.clone() }).is_err());
    let short = wire::Blob { digest: vec![1; 31].into(), bytes: 1 };
    assert!(SceneManifest::try_from(wire::SceneManifest { root: Some(short), ..good.clone() }).is_err());
    let huge = wire::Blob { digest: vec![1; 32].into(), bytes: u64::MAX };
    assert!(SceneManifest::try_from(wire::SceneManifest { root: Some(huge), ..good.clone() }).is_err());
    let long = wire::SceneManifest { name: "x".repeat(5_000), ..good };
    assert!(SceneManifest::try_from(long).is_err());
}

#[test]
fn messages_between_coordinator_and_worker_survive() {
    let lease = |task| Lease {
        id: LeaseId(7),
        attempt: 2,
        job: JobId(9),
        range: EmissionRange { first: 3, end: 1 << 40 },
        task,
    };
    let map = MapRef { kind: MapKind::Caustic, digest: Digest([5; 32]), bytes: 99 };
    let to = [
        ToWorker::Prepare { job: JobId(9), scene: manifest(), settings: Box::new(settings()) },
        ToWorker::Lease(lease(Task::Emission { round: 65_535, map: MapKind::Global })),
        ToWorker::Lease(lease(Task::Gather { round: 3, maps: vec![map], sample_map: Some(blob(6)) })),
        ToWorker::Lease(lease(Task::Bootstrap)),
        ToWorker::Lease(lease(Task::Splat { round: 3, bootstrap: None })),
        ToWorker::Lease(lease(Task::Splat { round: 0, bootstrap: Some(blob(4)) })),
        ToWorker::Revoke(LeaseId(7)),
        ToWorker::Forget(JobId(9)),
        ToWorker::Route(route()),
    ];
    for m in to {
        assert_eq!(ToWorker::try_from(wire::CoordinatorMessage::from(m.clone())), Ok(m));
    }
    let relay = RelayAddress { address: "[fe80::1]:80".parse().unwrap(), given: true };
    let from = [
        FromWorker::Hello(Hello { name: "w".into(), threads: 4, memory_bytes: 1 << 33, relay: None }),
        FromWorker::Hello(Hello { name: "r".into(), threads: 1, memory_bytes: 1, relay: Some(relay) }),
        FromWorker::Heartbeat,
        FromWorker::TaskFailed { lease: LeaseId(7), attempt: 2, error: "no".into() },
        FromWorker::TaskReturned { lease: LeaseId(7), attempt: 2 },
        FromWorker::Draining,
    ];
    for m in from {
        assert_eq!(FromWorker::try_from(wire::WorkerMessage::from(m.clone())), Ok(m));
    }
    let header = DeliverHeader {
        session: SessionKey([1; 16]),
        lease: LeaseId(2),
        attempt: 3,
        range: EmissionRange { first: 4, end: 5 },
        busy: Duration::from_micros(6),
        bytes: 7,
        digest: Digest([8; 32]),
        fetched: transfers(&[Collective::BroadcastScene, Collective::BroadcastMap]),
    };
    let wire = wire::DeliverHeader::from(header);
    assert_eq!(DeliverHeader::try_from(wire.clone()), Ok(header));
    let one = |kind: Collective| wire::Transfer { collective: kind as i32 + 1, count: 1, bytes: 2, micros: 3 };
    let map = one(Collective::BroadcastMap);
    for bad in [
        vec![one(Collective::GatherTiles)],
        vec![map; 2],
        vec![wire::Transfer { count: 0, ..map }],
        vec![wire::Transfer { collective: 0, ..map }],
        vec![wire::Transfer { collective: 9, ..map }],
        vec![map; 1_000],
    ] {
        let header = wire::DeliverHeader { fetched: bad, ..wire.clone() };
        assert!(DeliverHeader::try_from(header.clone()).is_err(), "{header:?}");
    }
}

fn transfers(kinds: &[Collective]) -> Transfers {
    let mut transfers = Transfers::default();
    for (i, &kind) in (1u64..).zip(kinds) {
        transfers.record(kind, Transfer { count: i, bytes: 10 * i, time: Duration::from_micros(100 * i) });
    }
    transfers
}

fn route() -> Route {
    let address = |text: &str| text.parse().unwrap();
    let sources = [vec![address("10.0.0.1:7421"), address("[::1]:9")], Vec::new()];
    Route { blob: blob(6), ticket: PassTicket([8; 16]), sources }
}

#[test]
fn routes_and_requests_to_relays_survive_and_nonsense_is_refused() {
    let request = PassRequest { digest: Digest([5; 32]), ticket: PassTicket([8; 16]), stripe: 1, first: 7 };
    let wire = wire::PassRequest::from(request);
    assert_eq!(PassRequest::try_from(wire.clone()), Ok(request));
    for bad in [
        wire::PassRequest { stripe: 2, ..wire.clone() },
        wire::PassRequest { first: 6, ..wire.clone() },
        wire::PassRequest { ticket: vec![8; 15].into(), ..wire.clone() },
        wire::PassRequest { digest: vec![5; 33].into(), ..wire },
    ] {
        assert!(PassRequest::try_from(bad).is_err());
    }
    let wire = wire::Route::from(route());
    assert_eq!(Route::try_from(wire.clone()), Ok(route()));
    let many = wire::Sources { addresses: vec!["10.0.0.1:1".into(); 5] };
    let name = wire::Sources { addresses: vec!["localhost:1".into()] };
    for stripes in [vec![], vec![many, Default::default()], vec![name, Default::default()]] {
        assert!(Route::try_from(wire::Route { stripes, ..wire.clone() }).is_err());
    }
    assert!(Route::try_from(wire::Route { bytes: u64::MAX, ..wire }).is_err());
    let (a, b) = (PassTicket([1; 16]), PassTicket(std::array::from_fn(|i| u8::from(i < 15))));
    assert!(a.is(&a) && !a.is(&b) && !format!("{a:?}").contains('1'));
}

#[test]
fn empty_and_senseless_messages_are_refused() {
    assert!(FromWorker::try_from(wire::WorkerMessage { kind: None }).is_err());
    assert!(ToWorker::try_from(wire::CoordinatorMessage { kind: None }).is_err());
    let backwards = wire::DeliverHeader { first: 2, end: 1, ..Default::default() };
    assert!(DeliverHeader::try_from(backwards).is_err());
    assert!(DeliverHeader::try_from(wire::DeliverHeader { bytes: u64::MAX, ..Default::default() }).is_err());
    let hello = wire::Hello { threads: 0, ..Default::default() };
    let hello = wire::WorkerMessage { kind: Some(wire::worker_message::Kind::Hello(hello)) };
    assert!(FromWorker::try_from(hello).is_err());
    assert!(Lease::try_from(wire::Lease::default()).is_err());
    let task = |task| Lease::try_from(wire::Lease { task: Some(task), ..Default::default() });
    let emission = |round| wire::lease::Task::Emission(wire::EmissionTask { map: 1, round });
    assert!(task(emission(65_535)).is_ok() && task(emission(65_536)).is_err());
    let gather = |round| wire::lease::Task::Gather(wire::GatherTask { maps: Vec::new(), round, sample_map: None });
    assert!(task(gather(65_535)).is_ok() && task(gather(65_536)).is_err());
    let splat = |digest, bytes| {
        let bootstrap = Some(wire::Blob { digest: vec![0; digest].into(), bytes });
        task(wire::lease::Task::Splat(wire::SplatTask { bootstrap, round: 0 }))
    };
    assert!(splat(32, 8).is_ok() && splat(31, 8).is_err() && splat(32, u64::MAX).is_err());
}

#[test]
fn long_errors_are_cut() {
    let m = FromWorker::TaskFailed { lease: LeaseId(1), attempt: 1, error: "ä".repeat(10_000) };
    let Ok(FromWorker::TaskFailed { error, .. }) = FromWorker::try_from(wire::WorkerMessage::from(m)) else {
        panic!("is a failure");
    };
    assert_eq!(error.len(), 4_096);
}

#[test]
fn job_snapshots_survive() {
    let map = MapStats { kind: MapKind::Global, emitted_count: 1, emitted_total: 2, stored_count: 3, bytes: 4 };
    let stats = JobStats {
        maps: vec![map],
        rays: 5,
        non_finite: NonFinite { samples: 1, splats: 2, photons: 3 },
        workers: 4,
        workers_lost: 1,
        gather_radius: Some(0.5),
        k: 6,
        rounds_done: 7,
        units_done: 8,
        ended_by: Some(Limit::Time),
        mutations: Mutations {
            large: 9,
            large_accepted: 8,
            small: 7,
            small_accepted: 6,
            large_luminance: 0,
            large_luminance_squared: 0,
        },
        noise: Some(Noise { standard_error: 0.25, relative: f64::INFINITY }),
        bias: Some(Bias { absolute: 0.5, relative: 0.75 }),
        ..JobStats::default()
    };
    let states = [
        JobState::Waiting,
        JobState::Emission(MapKind::Caustic),
        JobState::Merge(MapKind::Global),
        JobState::Broadcast,
        JobState::Bootstrap,
        JobState::Splat,
        JobState::Gather,
        JobState::Assemble,
        JobState::Done,
        JobState::Failed("why".into()),
        JobState::Cancelled,
    ];
    for state in states {
        let p = JobProgress {
            id: JobId(1),
            name: "n".into(),
            state,
            done: 1,
            total: 2,
            rate: 3.5,
            state_elapsed: Duration::from_millis(4),
            elapsed: Duration::from_millis(5),
            workers: 6,
            stats: stats.clone(),
            result_digest: Some(Digest([8; 32])),
            round: 9,
            rounds: 10,
            priority: -7,
            waits_for: "memory".into(),
            owner: "o".into(),
        };
        assert_eq!(JobProgress::try_from(wire::Job::from(&p)), Ok(p));
    }
}

#[test]
fn limits_survive_and_senseless_ones_are_refused() {
    for time in [None, Some(Duration::from_millis(1)), Some(Duration::from_secs(86_400))] {
        for error in [None, Some(0.01)] {
            let limits = Limits { time, error };
            assert_eq!(Limits::try_from(wire::Limits::from(limits)), Ok(limits));
        }
    }
    for bad in [0, u64::MAX] {
        assert!(Limits::try_from(wire::Limits { time_ms: Some(bad), error: None }).is_err());
    }
    for bad in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        assert!(Limits::try_from(wire::Limits { time_ms: None, error: Some(bad) }).is_err());
    }
}

/// Bytes that nobody meant, and good messages with a few bytes changed: refused or understood, never a panic.
#[test]
fn noise_never_panics() {
    fn convert<W: Message + Default, D: TryFrom<W>>(bytes: &[u8]) -> bool {
        W::decode(bytes).is_ok_and(|wire| D::try_from(wire).is_ok())
    }
    let lease = Lease {
        id: LeaseId(7),
        attempt: 2,
        job: JobId(9),
        range: EmissionRange { first: 3, end: 9 },
        task: Task::Gather {
            round: 1,
            maps: vec![MapRef { kind: MapKind::Caustic, digest: Digest([5; 32]), bytes: 99 }],
            sample_map: Some(blob(4)),
        },
    };
    let prepare = ToWorker::Prepare { job: JobId(9), scene: manifest(), settings: Box::new(settings()) };
    let good: Vec<Vec<u8>> = vec![
        wire::CoordinatorMessage::from(ToWorker::Lease(lease)).encode_to_vec(),
        wire::CoordinatorMessage::from(prepare).encode_to_vec(),
        wire::CoordinatorMessage::from(ToWorker::Route(route())).encode_to_vec(),
        wire::RenderSettings::from(&settings()).encode_to_vec(),
        wire::SceneManifest::from(&manifest()).encode_to_vec(),
        Vec::new(),
    ];
    let mut state = 1u64;
    let mut random = |n: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % n
    };
    let mut understood = 0;
    for round in 0..20_000 {
        let mut bytes = good[round % good.len()].clone();
        bytes.resize(bytes.len() + random(8), random(256) as u8);
        for _ in 0..random(4) {
            let at = random(bytes.len().max(1));
            bytes.iter_mut().skip(at).take(1).for_each(|b| *b = random(256) as u8);
        }
        let all = [
            convert::<wire::CoordinatorMessage, ToWorker>(&bytes),
            convert::<wire::WorkerMessage, FromWorker>(&bytes),
            convert::<wire::RenderSettings, RenderSettings>(&bytes),
            convert::<wire::SceneManifest, SceneManifest>(&bytes),
            convert::<wire::DeliverHeader, DeliverHeader>(&bytes),
            convert::<wire::Job, JobProgress>(&bytes),
            convert::<wire::PassRequest, PassRequest>(&bytes),
        ];
        understood += usize::from(all.contains(&true));
    }
    // Some are still understood: the noise is not so strong that only the first check is tested.
    assert!(understood > 1_000 && understood < 20_000, "{understood}");
}

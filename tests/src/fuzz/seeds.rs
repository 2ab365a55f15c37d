//! The first entries of the corpora: valid inputs of every kind, for the fuzzers to begin from.

use super::wire::{GRID, RANGE};
use crate::scene;
use bytes::Bytes;
use gatherlight::types::{JobId, JobProgress, JobState, JobStats, Limits};
use gatherlight_proto::Digest;
use gatherlight_proto::chunk::{chunk, chunks};
use gatherlight_proto::collective::{Collective, Transfer, Transfers};
use gatherlight_proto::message::{
    BlobRef, DeliverHeader, FromWorker, Hello, Lease, LeaseId, MapRef, PassRequest, PassTicket, RelayAddress, Route,
    SceneManifest, SessionKey, Task, ToWorker, WorkerId,
};
use gatherlight_proto::payload::{bootstrap, gather, light, map, photons};
use gatherlight_proto::wire;
use gatherlight_render::film::{ChannelSet, LightImage, Tile};
use gatherlight_render::job::PreparedJob;
use gatherlight_render::math::Rgb;
use gatherlight_render::photon::MapKind;
use gatherlight_render::settings::{Method, RenderSettings};
use prost::Message;
use std::time::Duration;

/// A corpus entry: target, name, bytes.
pub type Entry = (&'static str, String, Vec<u8>);

/// A triangle, a lamp and a camera, with their buffer inside.
const GLTF: &str = r#"{"asset":{"version":"2.0"},"extensionsUsed":["KHR_lights_punctual"],"extensions":{"KHR_lights_punctual":{"lights":[{"type":"point","intensity":10}]}},"scene":0,"scenes":[{"nodes":[0,1,2]}],"nodes":[{"mesh":0},{"extensions":{"KHR_lights_punctual":{"light":0}},"translation":[0,0,2]},{"camera":0,"translation":[0,0,3]}],"cameras":[{"type":"perspective","perspective":{"yfov":0.8,"znear":0.1}}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"buffers":[{"uri":"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA","byteLength":36}],"bufferViews":[{"buffer":0,"byteLength":36}],"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}]}"#;

/// All of them.
///
/// # Panics
/// When the scene of the photons cannot be read.
pub fn all() -> Vec<Entry> {
    let mut entries = Vec::new();
    let mut add = |target, list: Vec<Vec<u8>>| {
        entries.extend(list.into_iter().enumerate().map(|(i, bytes)| (target, format!("seed-{i:02}"), bytes)));
    };
    add("chunks", streams());
    add("messages", messages());
    add("payloads", payloads());
    add("gltf", vec![GLTF.into(), glb(GLTF), scene("orthographic.glb").root.to_vec()]);
    add("session", machine_inputs());
    add("schedule", machine_inputs());
    entries
}

/// A binary container around `json`.
fn glb(json: &str) -> Vec<u8> {
    let mut json = json.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let length = json.len() as u32;
    let mut out = [&b"glTF"[..], &2_u32.to_le_bytes(), &(length + 20).to_le_bytes()].concat();
    out.extend(length.to_le_bytes());
    out.extend(b"JSON");
    out.extend(json);
    out
}

fn streams() -> Vec<Vec<u8>> {
    let whole = Bytes::from_static(b"a payload of some bytes");
    let digest = Digest::of(&whole);
    let stream = |chunks: Vec<wire::Chunk>| chunks.iter().flat_map(|c| c.encode_length_delimited_to_vec()).collect();
    let pieces = [(0, 0..7), (1, 7..20), (2, 20..23)];
    let pieces = pieces.map(|(i, range)| chunk(i, digest, whole.len() as u64, whole.slice(range)));
    let empty = chunks(Bytes::new(), Digest::of(b"")).collect();
    vec![stream(chunks(whole.clone(), digest).collect()), stream(pieces.to_vec()), stream(empty)]
}

fn messages() -> Vec<Vec<u8>> {
    let of = |kind: u8, message: Vec<u8>| [vec![kind], message].concat();
    let blob = BlobRef { digest: Digest([7; 32]), bytes: 9 };
    let scene = SceneManifest { name: "x.gltf".into(), root: blob, externals: vec![("x.bin".into(), blob)] };
    let maps = vec![MapRef { kind: MapKind::Global, digest: Digest([8; 32]), bytes: 10 }];
    let lease = |task| Lease { id: LeaseId(3), attempt: 2, job: JobId(4), range: RANGE, task };
    let session = SessionKey([9; 16]);
    let (heartbeat, busy) = (Duration::from_secs(1), Duration::from_millis(3));
    let relay = Some(RelayAddress { address: "192.0.2.1:7421".parse().expect("an address"), given: true });
    let from = [
        FromWorker::Hello(Hello { name: "w".into(), threads: 4, memory_bytes: 1 << 33, relay }),
        FromWorker::Heartbeat,
        FromWorker::TaskFailed { lease: LeaseId(3), attempt: 2, error: "why".into() },
        FromWorker::TaskReturned { lease: LeaseId(3), attempt: 2 },
        FromWorker::Draining,
    ];
    let ticket = PassTicket([6; 16]);
    let sources =
        [vec!["192.0.2.1:7421".parse().expect("an address")], vec!["[2001:db8::1]:7421".parse().expect("an address")]];
    let route = Route { blob, ticket, sources };
    let to = [
        ToWorker::Welcome { worker: WorkerId(1), session, heartbeat },
        ToWorker::Prepare { job: JobId(4), scene: scene.clone(), settings: Box::default() },
        ToWorker::Lease(lease(Task::Emission { round: 1, map: MapKind::Caustic })),
        ToWorker::Lease(lease(Task::Bootstrap)),
        ToWorker::Lease(lease(Task::Splat { round: 0, bootstrap: Some(blob) })),
        ToWorker::Lease(lease(Task::Gather { round: 0, maps, sample_map: Some(blob) })),
        ToWorker::Revoke(LeaseId(3)),
        ToWorker::Forget(JobId(4)),
        ToWorker::Route(route.clone()),
    ];
    let from = from.map(|m| of(0, wire::WorkerMessage::from(m).encode_to_vec()));
    let to = to.map(|m| of(1, wire::CoordinatorMessage::from(m).encode_to_vec()));
    let (digest, bytes) = (blob.digest, blob.bytes);
    let mut fetched = Transfers::default();
    fetched.record(Collective::BroadcastMap, Transfer { count: 1, bytes, time: busy });
    let header = DeliverHeader { session, lease: LeaseId(3), attempt: 2, range: RANGE, busy, bytes, digest, fetched };
    let progress = JobProgress {
        id: JobId(4),
        name: "n".into(),
        owner: "o".into(),
        state: JobState::Emission(MapKind::Global),
        round: 1,
        rounds: 2,
        priority: -3,
        waits_for: "memory".into(),
        done: 3,
        total: 4,
        rate: 5.5,
        state_elapsed: heartbeat,
        elapsed: heartbeat,
        workers: 1,
        stats: JobStats::default(),
        result_digest: Some(Digest([5; 32])),
    };
    let settings = Method::ALL.map(|method| RenderSettings { method, max_depth: Some(3), ..RenderSettings::default() });
    let settings = settings.iter().map(|s| of(4, wire::RenderSettings::from(s).encode_to_vec()));
    let rest = [
        of(2, wire::DeliverHeader::from(header).encode_to_vec()),
        of(3, wire::Job::from(&progress).encode_to_vec()),
        of(5, wire::SceneManifest::from(&scene).encode_to_vec()),
        of(7, wire::Route::from(route).encode_to_vec()),
        of(
            8,
            wire::PassRequest::from(PassRequest { digest: blob.digest, ticket, stripe: 1, first: 1 }).encode_to_vec(),
        ),
        of(6, wire::Limits::from(Limits { time: Some(busy), error: Some(0.5) }).encode_to_vec()),
    ];
    from.into_iter().chain(to).chain(settings).chain(rest).collect()
}

fn payloads() -> Vec<Vec<u8>> {
    let of = |kind: u8, payload: &[u8]| [&[kind], payload].concat();
    let batch = |method| {
        let settings = RenderSettings { method, width: 8, height: 8, ..RenderSettings::default() };
        let job = PreparedJob::prepare(&scene("cornell-diffuse.glb"), &settings).unwrap_or_else(|e| panic!("{e}"));
        let batch = job.emit(0, MapKind::Global, RANGE);
        (photons::encode_batch(&batch), map::encode_map(&job.build_map(MapKind::Global, batch)))
    };
    let ((plain, of_photons), (_, of_vertices)) = (batch(Method::Photon), batch(Method::Vcm));
    let mut image = LightImage::new(GRID, 1, 1.0);
    (0..20).for_each(|i| image.splat(0, i, i % 21, Rgb::new(0.5, 1.0, 2.0)));
    let channels = ChannelSet::new(&[]).len();
    let tile = |index: u32| {
        let pixels = GRID.rect(index).map_or(0, |r| r.width as usize * r.height as usize);
        Tile { index, pixels: vec![0.25; pixels * channels], non_finite: 0, rays: 9 }
    };
    let tiles: Vec<Tile> = (RANGE.first as u32..RANGE.end as u32).map(tile).collect();
    vec![
        of(0, &plain),
        of(1, &plain),
        of(2, &of_photons),
        of(2, &of_vertices),
        of(4, &bootstrap::encode(RANGE, &[0.5, 1.0, 2.0])),
        of(5, &light::encode(&image)),
        of(6, &gather::encode(&tiles, channels, None)),
        of(7, &gather::encode(&tiles, channels, Some(&image))),
    ]
}

/// Choices that lead a machine some way: each byte once in an order that repeats, and a few in which events go together.
fn machine_inputs() -> Vec<Vec<u8>> {
    let walk = |step: u8| (0..=255_u8).map(|i| i.wrapping_mul(step)).collect::<Vec<u8>>();
    let work: Vec<u8> = (0..40_u8).flat_map(|i| [3, 2, i, 3, 0, 1, 2, 3, 7, 1, 1, 2, 3, 11, 5, 3, 13, 1]).collect();
    vec![walk(1), walk(7), walk(37), work]
}

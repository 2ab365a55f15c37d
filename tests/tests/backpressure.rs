//! Workers that deliver photons faster than the coordinator can decode and merge them wait for room: its memory does not grow with
//! their number.
#![cfg(target_os = "linux")]

use gatherlight::client::connect;
use gatherlight_proto::Digest;
use gatherlight_proto::chunk::chunks;
use gatherlight_proto::connect::Stamp;
use gatherlight_proto::credentials::Credentials;
use gatherlight_proto::message::{DeliverHeader, FromWorker, Hello, Lease, SessionKey, Task, ToWorker};
use gatherlight_proto::payload::photons::encode_batch;
use gatherlight_proto::version::Versions;
use gatherlight_proto::wire::cluster_client::ClusterClient;
use gatherlight_proto::wire::deliver_request::Kind;
use gatherlight_proto::wire::{DeliverRequest, deliver_reply};
use gatherlight_render::job::PreparedJob;
use gatherlight_render::photon::{EmissionRange, MapKind, PhotonBatch};
use gatherlight_render::settings::{Method, RenderSettings};
use gatherlight_tests::cluster::{PATIENCE, request};
use gatherlight_tests::processes::{high_water, serve_with};
use gatherlight_tests::scene;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Channel, Endpoint};

type Client = ClusterClient<InterceptedService<Channel, Stamp>>;

/// Sessions that deliver at once, two leases each.
const SESSIONS: usize = 40;
/// Results that are delivered.
const RESULTS: usize = 120;
/// Photons of each.
const PHOTONS: usize = 150_000;
/// Memory for results that are not merged yet, and half of it more for what is no result: buffers of 40 connections.
const ROOM: u64 = 24 << 20;
const SLACK: u64 = 12 << 20;

fn settings() -> RenderSettings {
    RenderSettings {
        method: Method::Photon,
        photons: 1 << 30,
        caustic_photons: 0,
        ..RenderSettings::for_method(Method::Photon)
    }
}

/// Many photons, which any lease is said to have stored: delivering them costs no tracing.
fn batch() -> PhotonBatch {
    let job = PreparedJob::prepare(&scene("cornell-diffuse.glb"), &settings()).expect("a scene");
    let mut batch = job.emit(0, MapKind::Global, EmissionRange { first: 0, end: PHOTONS as u64 });
    assert!(batch.len() >= PHOTONS && batch.vertices.is_none());
    batch.positions.truncate(PHOTONS);
    batch.powers.truncate(PHOTONS);
    batch.normals.truncate(PHOTONS);
    batch
}

async fn deliver(client: &mut Client, session: SessionKey, lease: Lease, batch: &PhotonBatch) -> bool {
    let payload = encode_batch(&PhotonBatch { range: lease.range, ..batch.clone() });
    let header = DeliverHeader {
        session,
        lease: lease.id,
        attempt: lease.attempt,
        range: lease.range,
        busy: Duration::from_millis(1),
        bytes: payload.len() as u64,
        digest: Digest::of(&payload),
        fetched: Default::default(),
    };
    let (requests, outbound) = mpsc::channel(1);
    requests.send(DeliverRequest { kind: Some(Kind::Header(header.into())) }).await.expect("is open");
    let mut replies = client.deliver(ReceiverStream::new(outbound)).await.expect("is taken").into_inner();
    let first = replies.message().await.expect("is answered").and_then(|r| r.kind);
    assert!(matches!(first, Some(deliver_reply::Kind::Proceed(_))), "{first:?}");
    for chunk in chunks(payload, header.digest) {
        requests.send(DeliverRequest { kind: Some(Kind::Chunk(chunk)) }).await.expect("is open");
    }
    drop(requests);
    let last = replies.message().await.expect("is answered").and_then(|r| r.kind);
    matches!(last, Some(deliver_reply::Kind::Receipt(r)) if r.accepted)
}

/// A worker that has its results the moment it is given a lease, until `left` are delivered in all.
async fn session(url: String, batch: Arc<PhotonBatch>, left: Arc<AtomicUsize>, merged: Arc<AtomicUsize>) {
    let channel = Endpoint::from_shared(url).expect("a URL").connect().await.expect("connects");
    let mut client = ClusterClient::with_interceptor(channel, Stamp::new(Versions::own(), &Credentials::default()));
    let (outbound, messages) = mpsc::channel(4);
    let hello = Hello { name: "fast".into(), threads: 1, memory_bytes: u64::MAX, relay: None };
    outbound.send(FromWorker::Hello(hello)).await.expect("is open");
    let joined = client.join(ReceiverStream::new(messages).map(Into::into)).await.expect("joins");
    let mut inbound = joined.into_inner();
    let mut name = SessionKey([0; 16]);
    while let Ok(Some(message)) = inbound.message().await {
        match ToWorker::try_from(message).expect("makes sense") {
            ToWorker::Welcome { session, .. } => {
                name = session;
                let beats = outbound.clone();
                tokio::spawn(async move {
                    while beats.send(FromWorker::Heartbeat).await.is_ok() {
                        tokio::time::sleep(Duration::from_secs(1)).await;
                    }
                });
            }
            ToWorker::Lease(lease) => {
                assert!(matches!(lease.task, Task::Emission { .. }));
                let take = |n: usize| n.checked_sub(1);
                if left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, take).is_err() {
                    continue;
                }
                let (mut client, batch, merged) = (client.clone(), batch.clone(), merged.clone());
                tokio::spawn(async move {
                    let accepted = deliver(&mut client, name, lease, &batch).await;
                    merged.fetch_add(usize::from(accepted), Ordering::Relaxed);
                });
            }
            _ => {}
        }
    }
}

/// Peak resident memory of the coordinator after `RESULTS` results from so many sessions, and the seconds they took.
async fn peak(sessions: usize, room: &str, batch: &Arc<PhotonBatch>) -> (u64, f64) {
    let store = tempfile::tempdir().expect("a directory");
    let (coordinator, url) = serve_with(store.path(), &["--max-result-memory", room, "--max-job-memory", "1000G"]);
    let client = connect(&url, 5).await.expect("answers");
    client.submit(&request(&scene("cornell-diffuse.glb"), &settings()), |_, _| {}).await.expect("is taken");
    let (left, merged) = (Arc::new(AtomicUsize::new(RESULTS)), Arc::new(AtomicUsize::new(0)));
    let begun = Instant::now();
    let open: Vec<_> = (0..sessions)
        .map(|_| tokio::spawn(session(url.clone(), batch.clone(), left.clone(), merged.clone())))
        .collect();
    while merged.load(Ordering::Relaxed) < RESULTS {
        assert!(begun.elapsed() < PATIENCE, "{} of {RESULTS} are merged", merged.load(Ordering::Relaxed));
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    let seconds = begun.elapsed().as_secs_f64();
    open.iter().for_each(tokio::task::JoinHandle::abort);
    (high_water(coordinator.id()).expect("runs"), seconds)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn memory_for_results_is_bounded_however_many_deliver_at_once() {
    let batch = Arc::new(tokio::task::spawn_blocking(batch).await.expect("did not panic"));
    let room = ROOM.to_string();
    let ((one, _), (many, seconds), (free, _)) =
        (peak(1, &room, &batch).await, peak(SESSIONS, &room, &batch).await, peak(SESSIONS, "8G", &batch).await);
    let mib = |bytes: u64| bytes >> 20;
    println!(
        "{RESULTS} results of {PHOTONS} photons: {} MiB with 1 session, {} MiB with {SESSIONS} in {seconds:.1} s, {} MiB with \
         room for all",
        mib(one),
        mib(many),
        mib(free)
    );
    assert!(many <= one + ROOM + SLACK, "{} MiB with one session, {} MiB with {SESSIONS}", mib(one), mib(many));
    // Without the bound they do pile up: the deliveries are faster than the merge.
    assert!(free > one + 2 * (ROOM + SLACK), "{} MiB with one session, {} MiB with room for all", mib(one), mib(free));
}

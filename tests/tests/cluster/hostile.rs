//! Peers that do not keep to the protocol are refused with a status; the coordinator goes on.

use gatherlight_proto::Digest;
use gatherlight_proto::chunk::chunks;
use gatherlight_proto::connect::Stamp;
use gatherlight_proto::credentials::Credentials;
use gatherlight_proto::limits::CHUNK_BYTES;
use gatherlight_proto::version::Versions;
use gatherlight_proto::wire::cluster_client::ClusterClient;
use gatherlight_proto::wire::deliver_request::Kind;
use gatherlight_proto::wire::jobs_client::JobsClient;
use gatherlight_proto::wire::relay_client::RelayClient;
use gatherlight_proto::wire::{self, Chunk, DeliverRequest, WorkerMessage};
use gatherlight_tests::cluster::{Coordinator, PATIENCE, small_leases};
use gatherlight_tests::hostile::{HTTP2_HANDSHAKE, crowd, drip, still_open};
use std::time::{Duration, Instant};
use tokio_stream::wrappers::ReceiverStream;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Status};

type Stamped = InterceptedService<Channel, Stamp>;

struct Peer {
    _store: tempfile::TempDir,
    coordinator: Coordinator,
    cluster: ClusterClient<Stamped>,
    relay: RelayClient<Stamped>,
    jobs: JobsClient<Stamped>,
}

async fn peer() -> Peer {
    let store = tempfile::tempdir().expect("a directory");
    let coordinator = Coordinator::start(store.path(), small_leases()).await;
    let channel = Endpoint::from_shared(coordinator.url()).expect("a URL").connect().await.expect("connects");
    let stamp = Stamp::new(Versions::own(), &Credentials::default());
    Peer {
        _store: store,
        coordinator,
        cluster: ClusterClient::with_interceptor(channel.clone(), stamp.clone()),
        relay: RelayClient::with_interceptor(channel.clone(), stamp.clone()),
        jobs: JobsClient::with_interceptor(channel, stamp),
    }
}

fn code<T>(result: Result<T, Status>) -> Code {
    result.map(drop).expect_err("is refused").code()
}

fn chunk(index: u64, total_bytes: u64, data: Vec<u8>) -> Chunk {
    Chunk { index, digest: Digest([9; 32]).to_bytes(), total_bytes, data: data.into() }
}

#[tokio::test]
async fn calls_without_versions_are_refused() {
    let p = peer().await;
    let channel = Endpoint::from_shared(p.coordinator.url()).expect("a URL").connect().await.expect("connects");
    let status = JobsClient::new(channel.clone()).list(wire::ListRequest {}).await.expect_err("is refused");
    assert_eq!(status.code(), Code::FailedPrecondition);
    assert!(status.message().contains("version mismatch"), "{status}");
    let empty = tokio_stream::iter(Vec::<WorkerMessage>::new());
    assert_eq!(code(ClusterClient::new(channel).join(empty).await), Code::FailedPrecondition);
}

#[tokio::test]
async fn uploads_out_of_order_too_large_or_damaged_are_refused() {
    let p = peer().await;
    let upload = async |list: Vec<Chunk>| code(p.jobs.clone().upload(tokio_stream::iter(list)).await);
    assert_eq!(upload(vec![]).await, Code::InvalidArgument);
    assert_eq!(upload(vec![chunk(1, 3, vec![1; 3])]).await, Code::InvalidArgument);
    assert_eq!(upload(vec![chunk(0, 4, vec![1; 2]), chunk(0, 4, vec![1; 2])]).await, Code::InvalidArgument);
    assert_eq!(upload(vec![chunk(0, u64::MAX, vec![1; 2])]).await, Code::ResourceExhausted);
    assert_eq!(upload(vec![chunk(0, 3, vec![1; 4])]).await, Code::DataLoss);
    assert_eq!(upload(vec![chunk(0, 4, vec![1; 3])]).await, Code::DataLoss);
    assert_eq!(upload(vec![chunk(0, 3, vec![1; 3])]).await, Code::DataLoss);
    let large = chunk(0, CHUNK_BYTES as u64 + 1, vec![1; CHUNK_BYTES + 1]);
    assert_eq!(upload(vec![large]).await, Code::ResourceExhausted);
    // Beyond the message limit the decoder refuses, before the message is read.
    assert_eq!(upload(vec![chunk(0, 9 << 20, vec![1; 8 << 20])]).await, Code::OutOfRange);
}

#[tokio::test]
async fn submissions_without_scene_blobs_or_sense_are_refused() {
    let p = peer().await;
    let settings = wire::RenderSettings::from(&gatherlight_render::settings::RenderSettings::default());
    let blob = wire::Blob { digest: Digest([7; 32]).to_bytes(), bytes: 3 };
    let scene = wire::SceneManifest { name: "../../etc/passwd".into(), root: Some(blob), externals: Vec::new() };
    let good = wire::SubmitRequest {
        name: "n".into(),
        scene: Some(scene),
        settings: Some(settings.clone()),
        request_key: vec![1; 16].into(),
        limits: None,
        priority: 0,
    };
    let submit = async |request: wire::SubmitRequest| code(p.jobs.clone().submit(request).await);
    // All well but for the blob, which nobody uploaded.
    assert_eq!(submit(good.clone()).await, Code::FailedPrecondition);
    assert_eq!(submit(wire::SubmitRequest { scene: None, ..good.clone() }).await, Code::InvalidArgument);
    assert_eq!(submit(wire::SubmitRequest { settings: None, ..good.clone() }).await, Code::InvalidArgument);
    assert_eq!(
        submit(wire::SubmitRequest { request_key: vec![1; 3].into(), ..good.clone() }).await,
        Code::InvalidArgument
    );
    let limits = Some(wire::Limits { time_ms: Some(0), error: None });
    assert_eq!(submit(wire::SubmitRequest { limits, ..good.clone() }).await, Code::InvalidArgument);
    let nonsense = wire::RenderSettings { width: 0, ..settings };
    assert_eq!(submit(wire::SubmitRequest { settings: Some(nonsense), ..good }).await, Code::InvalidArgument);
}

#[tokio::test]
async fn sessions_that_begin_wrongly_are_refused() {
    let p = peer().await;
    let join = async |list: Vec<WorkerMessage>| code(p.cluster.clone().join(tokio_stream::iter(list)).await);
    let message = |kind| WorkerMessage { kind: Some(kind) };
    assert_eq!(join(vec![]).await, Code::InvalidArgument);
    assert_eq!(join(vec![WorkerMessage { kind: None }]).await, Code::InvalidArgument);
    let heartbeat = message(wire::worker_message::Kind::Heartbeat(wire::Heartbeat {}));
    assert_eq!(join(vec![heartbeat]).await, Code::InvalidArgument);
    let hello = wire::Hello { name: "n".into(), threads: 0, memory_bytes: 1, relay: None };
    assert_eq!(join(vec![message(wire::worker_message::Kind::Hello(hello))]).await, Code::InvalidArgument);
    let hello = wire::Hello { name: "n".repeat(10_000), threads: 1, memory_bytes: 1, relay: None };
    assert_eq!(join(vec![message(wire::worker_message::Kind::Hello(hello))]).await, Code::ResourceExhausted);
}

#[tokio::test]
async fn fetches_and_deliveries_without_a_session_get_nothing() {
    let p = peer().await;
    let request = wire::LocateRequest { session: vec![7; 16].into(), digest: Digest([7; 32]).to_bytes() };
    assert_eq!(code(p.cluster.clone().locate(request).await), Code::NotFound);
    let request = wire::LocateRequest { session: vec![7; 16].into(), digest: vec![7; 5].into() };
    assert_eq!(code(p.cluster.clone().locate(request).await), Code::InvalidArgument);
    let pass = async |ticket: usize, stripe, first| {
        let (digest, ticket) = (Digest([7; 32]).to_bytes(), vec![1; ticket].into());
        code(p.relay.clone().pass(wire::PassRequest { digest, ticket, stripe, first }).await)
    };
    assert_eq!(pass(16, 0, 0).await, Code::NotFound);
    assert_eq!([pass(15, 0, 0).await, pass(16, 2, 2).await, pass(16, 0, 1).await], [Code::InvalidArgument; 3]);

    let data = bytes::Bytes::from_static(b"junk");
    let digest = Digest::of(&data).to_bytes();
    let header = wire::DeliverHeader {
        session: vec![7; 16].into(),
        lease: 2,
        attempt: 3,
        first: 4,
        end: 5,
        busy_micros: 6,
        bytes: 4,
        digest,
        fetched: Vec::new(),
    };
    let request = |header| DeliverRequest { kind: Some(Kind::Header(header)) };
    let pieces: Vec<_> =
        chunks(data.clone(), Digest::of(&data)).map(|c| DeliverRequest { kind: Some(Kind::Chunk(c)) }).collect();
    let all = [vec![request(header.clone())], pieces.clone()].concat();
    let mut replies = p.cluster.clone().deliver(tokio_stream::iter(all)).await.expect("is answered").into_inner();
    // Nothing is asked to be sent.
    let first = replies.message().await.expect("is answered").expect("is answered").kind;
    assert_eq!(first, Some(wire::deliver_reply::Kind::Receipt(wire::Receipt { accepted: false })));
    assert_eq!(replies.message().await.expect("ends well"), None);
    assert_eq!(code(p.cluster.clone().deliver(tokio_stream::iter(pieces)).await), Code::InvalidArgument);
    let huge = request(wire::DeliverHeader { bytes: u64::MAX, ..header.clone() });
    assert_eq!(code(p.cluster.clone().deliver(tokio_stream::iter([huge])).await), Code::ResourceExhausted);
}

#[tokio::test]
async fn noise_on_the_port_does_not_stop_the_coordinator() {
    use tokio::io::AsyncWriteExt;
    let p = peer().await;
    for noise in [&b"GET / HTTP/1.1\r\n\r\n"[..], &[0xff; 4_096], b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\nxxxxxxxxxxxx"] {
        let mut stream = tokio::net::TcpStream::connect(p.coordinator.address).await.expect("connects");
        drop(stream.write_all(noise).await);
    }
    let listed = tokio::time::timeout(PATIENCE, p.jobs.clone().list(wire::ListRequest {})).await.expect("in time");
    assert!(listed.expect("is answered").into_inner().jobs.is_empty());
}

#[tokio::test]
async fn the_standard_health_service_answers_without_versions() {
    use tonic_health::pb::health_check_response::ServingStatus;
    let p = peer().await;
    let channel = Endpoint::from_shared(p.coordinator.url()).expect("a URL").connect().await.expect("connects");
    let mut health = tonic_health::pb::health_client::HealthClient::new(channel);
    for service in ["", "gatherlight.v1.Cluster", "gatherlight.v1.Jobs"] {
        let request = tonic_health::pb::HealthCheckRequest { service: service.into() };
        let reply = health.check(request).await.expect("is answered").into_inner();
        assert_eq!(reply.status(), ServingStatus::Serving, "{service:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_drips_bytes_or_stays_silent_is_closed_while_others_are_served() {
    let p = peer().await;
    // The whole preface and settings of HTTP/2, and then no call; the half of it; and nothing.
    let address = p.coordinator.address;
    let loris =
        tokio::spawn(
            async move { tokio::join!(drip(address, HTTP2_HANDSHAKE), drip(address, b"P"), drip(address, b"")) },
        );
    while !loris.is_finished() {
        assert!(p.jobs.clone().list(wire::ListRequest {}).await.is_ok());
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let (whole, half, nothing) = loris.await.expect("did not panic");
    for time in [whole, half, nothing] {
        assert!(time < Duration::from_secs(20), "{time:?}");
    }
    // A connection that made one good call may stay for ever.
    assert!(p.jobs.clone().list(wire::ListRequest {}).await.is_ok());
}

#[tokio::test]
async fn a_port_scanner_cannot_take_all_connections() {
    let p = peer().await;
    let held = crowd(p.coordinator.address, 400).await;
    // Those who are known go on, and newcomers crowd out the oldest of those who say nothing.
    assert!(p.jobs.clone().list(wire::ListRequest {}).await.is_ok());
    assert!(gatherlight::client::connect(&p.coordinator.url(), 1).await.is_ok());
    let closing = async {
        while still_open(&held) > 256 {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    tokio::time::timeout(PATIENCE, closing).await.expect("are closed in time");
}

#[tokio::test]
async fn a_worker_that_floods_is_dismissed() {
    let p = peer().await;
    let hello = wire::Hello { name: "w".into(), threads: 1, memory_bytes: 1, relay: None };
    let hello = WorkerMessage { kind: Some(wire::worker_message::Kind::Hello(hello)) };
    let heartbeat = WorkerMessage { kind: Some(wire::worker_message::Kind::Heartbeat(wire::Heartbeat {})) };
    let flood = tokio_stream::iter(std::iter::once(hello).chain(std::iter::repeat_n(heartbeat, 100_000)));
    let mut session = p.cluster.clone().join(flood).await.expect("joins").into_inner();
    let ended = async { while let Ok(Some(_)) = session.message().await {} };
    tokio::time::timeout(PATIENCE, ended).await.expect("is dismissed");
    assert!(
        p.jobs.clone().workers(wire::WorkersRequest {}).await.expect("is answered").into_inner().workers.is_empty()
    );
}

#[tokio::test]
async fn unfinished_uploads_and_watches_are_few() {
    let p = peer().await;
    // Uploads that announce a file and then send nothing more.
    let mut open = Vec::new();
    let mut codes = Vec::new();
    for _ in 0..40 {
        let (sender, receiver) = tokio::sync::mpsc::channel(1);
        sender.send(chunk(0, 9, vec![1; 3])).await.expect("is sent");
        let mut jobs = p.jobs.clone();
        let upload = tokio::spawn(async move { jobs.upload(ReceiverStream::new(receiver)).await.map(drop) });
        open.push((sender, upload));
    }
    let refused = async {
        while codes.len() < 8 {
            for (_, upload) in open.extract_if(.., |(_, upload)| upload.is_finished()) {
                codes.push(code(upload.await.expect("did not panic")));
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(PATIENCE, refused).await.expect("are refused in time");
    assert_eq!((open.len(), codes), (32, vec![Code::ResourceExhausted; 8]));
    // Once they are gone there is room again.
    drop(open);
    let data = bytes::Bytes::from_static(b"whole");
    let whole: Vec<Chunk> = chunks(data.clone(), Digest::of(&data)).collect();
    let again = async {
        while p.jobs.clone().upload(tokio_stream::iter(whole.clone())).await.is_err() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(PATIENCE, again).await.expect("is taken in time");
}

#[tokio::test]
async fn calls_are_limited_by_connection_and_headers_by_length() {
    let p = peer().await;
    let calls = (0..1_500).map(|_| {
        let mut jobs = p.jobs.clone();
        tokio::spawn(async move { jobs.missing(wire::MissingRequest { blobs: Vec::new() }).await })
    });
    let (calls, begin): (Vec<_>, _) = (calls.collect(), Instant::now());
    let mut refused = 0;
    for call in calls {
        if let Err(status) = call.await.expect("did not panic") {
            assert_eq!(status.code(), Code::ResourceExhausted, "{status}");
            refused += 1;
        }
    }
    // One second's worth at once, and as many each second after that.
    let allowed = 1_000.0 * (1.0 + begin.elapsed().as_secs_f64());
    assert!(f64::from(1_500 - refused) <= allowed + 1.0, "{refused} of 1,500 were refused");
    assert!(refused > 0 || allowed > 1_500.0);
    let mut request = tonic::Request::new(wire::ListRequest {});
    let value = "x".repeat(40_000).parse().expect("is a value");
    request.metadata_mut().insert("padding", value);
    assert!(p.jobs.clone().list(request).await.is_err());
}

#[tokio::test]
async fn names_that_would_write_on_terminals_are_refused() {
    let p = peer().await;
    let hello = wire::Hello { name: "\x1b[2Jw".into(), threads: 1, memory_bytes: 1, relay: None };
    let hello = WorkerMessage { kind: Some(wire::worker_message::Kind::Hello(hello)) };
    assert_eq!(code(p.cluster.clone().join(tokio_stream::iter([hello])).await), Code::InvalidArgument);
}

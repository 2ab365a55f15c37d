//! The broadcast over real connections: one copy from the coordinator, and relays that lie, stall or are not there are routed
//! around.

use gatherlight::embedded;
use gatherlight::types::JobProgress;
use gatherlight_proto::Digest;
use gatherlight_proto::connect::Stamp;
use gatherlight_proto::credentials::Credentials;
use gatherlight_proto::message::{FromWorker, Hello, PassRequest, PassTicket, RelayAddress, Route, ToWorker};
use gatherlight_proto::pieces::Pieces;
use gatherlight_proto::version::Versions;
use gatherlight_proto::wire::cluster_client::ClusterClient;
use gatherlight_proto::wire::passed::Kind;
use gatherlight_proto::wire::relay_client::RelayClient;
use gatherlight_proto::wire::relay_server::{Relay, RelayServer};
use gatherlight_proto::wire::{self, Passed};
use gatherlight_render::import::SceneBundle;
use gatherlight_render::settings::RenderSettings;
use gatherlight_tests::cluster::{Coordinator, Worker, finished_exr, request, small_leases, small_settings};
use gatherlight_tests::hostile::{HTTP2_HANDSHAKE, crowd, drip, still_open};
use gatherlight_tests::{film_pixels_sha256, pixel_sha256, scene};
use gatherlight_worker::WorkerConfig;
use gatherlight_worker::relay::Listen;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock};
use std::time::Duration;
use tempfile::TempDir;
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::timeout;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::{ReceiverStream, TcpListenerStream};
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Channel, Endpoint, Server};
use tonic::{Code, Request, Response, Status};

static BOX: LazyLock<SceneBundle> = LazyLock::new(|| scene("cornell-diffuse.glb"));

/// Maps of several pieces.
fn settings() -> RenderSettings {
    RenderSettings { photons: 250_000, final_gather: 0, width: 48, height: 32, ..small_settings() }
}

static REFERENCE: LazyLock<String> = LazyLock::new(|| {
    let render = || embedded::render(&BOX, &settings(), &embedded::Config::default(), |_| {});
    let result = std::thread::spawn(render).join().expect("did not panic").unwrap_or_else(|e| panic!("{e}"));
    film_pixels_sha256(&result.film)
});

async fn start() -> (TempDir, Coordinator) {
    let directory = tempfile::tempdir().expect("a directory");
    let coordinator = Coordinator::start(directory.path(), small_leases()).await;
    (directory, coordinator)
}

/// Adds workers, and waits until they are there.
async fn workers(coordinator: &Coordinator, count: usize, relay: Listen) -> Vec<Worker> {
    let client = coordinator.client().await;
    let before = client.workers().await.unwrap_or_else(|e| panic!("{e}")).len();
    let config = |i| WorkerConfig { threads: 1, relay, ..WorkerConfig::new(format!("w{i}")) };
    let workers = (0..count).map(|i| coordinator.worker_with(config(i))).collect();
    while client.workers().await.unwrap_or_else(|e| panic!("{e}")).len() < before + count {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    workers
}

/// Runs the job, checks its image and returns what it cost.
async fn run(coordinator: &Coordinator) -> JobProgress {
    let client = coordinator.client().await;
    let id = client.submit(&request(&BOX, &settings()), |_, _| {}).await.unwrap_or_else(|e| panic!("{e}"));
    let exr = finished_exr(&client, id).await;
    let reference = tokio::task::spawn_blocking(|| REFERENCE.as_str()).await.expect("did not panic");
    assert_eq!(pixel_sha256(&exr), reference);
    client.get(id).await.unwrap_or_else(|e| panic!("{e}"))
}

fn copies(job: &JobProgress) -> f64 {
    let maps: u64 = job.stats.maps.iter().map(|m| m.bytes).sum();
    assert!(maps > 1 << 20, "maps of {maps} bytes have few pieces");
    job.stats.broadcast_bytes as f64 / maps as f64
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_coordinator_sends_each_map_once_whatever_the_number_of_workers() {
    for count in [1, 2, 7] {
        let (_store, coordinator) = start().await;
        let _workers = workers(&coordinator, count, Listen::Auto).await;
        assert_eq!(copies(&run(&coordinator).await), 1.0, "{count} workers");
    }
    // Without relays it sends one to each.
    let (_store, coordinator) = start().await;
    let _workers = workers(&coordinator, 4, Listen::Off).await;
    let copies = copies(&run(&coordinator).await);
    assert!(copies > 1.0 && copies <= 4.0, "{copies}");
}

/// What a relay that is none does to those who ask it.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fate {
    /// Nobody listens at its address.
    Absent,
    /// It says nothing at all.
    Silent,
    /// It sends another payload's list.
    WrongList,
    /// It sends the right list, and pieces with a flipped bit.
    WrongPieces,
    /// It is always about to send something.
    EndsEarly,
}

/// Serves as `fate` says; knows nothing but what the coordinator gives it.
struct Liar {
    fate: Fate,
    coordinator: RelayClient<InterceptedService<Channel, Stamp>>,
    asked: Arc<AtomicUsize>,
}

#[tonic::async_trait]
impl Relay for Liar {
    type PassStream = ReceiverStream<Result<Passed, Status>>;
    async fn pass(&self, request: Request<wire::PassRequest>) -> Result<Response<Self::PassStream>, Status> {
        self.asked.fetch_add(1, Ordering::Relaxed);
        let (sender, receiver) = mpsc::channel(8);
        let request = request.into_inner();
        let (fate, mut coordinator) = (self.fate, self.coordinator.clone());
        tokio::spawn(async move {
            let send = async |kind| drop(sender.send(Ok(Passed { kind: Some(kind) })).await);
            if fate == Fate::Silent {
                // Longer than anybody waits.
                tokio::time::sleep(Duration::from_secs(60)).await;
            }
            if fate == Fate::WrongList {
                return send(Kind::List(Pieces::of(vec![1; 9 << 20].into()).list().to_bytes())).await;
            }
            let mut passed = coordinator.pass(request).await.expect("has a ticket").into_inner();
            while let Ok(Some(Passed { kind: Some(kind) })) = passed.message().await {
                match kind {
                    Kind::Piece(_) if fate == Fate::EndsEarly => return,
                    Kind::Piece(mut piece) => {
                        let mut data = piece.data.to_vec();
                        data.last_mut().into_iter().for_each(|b| *b ^= 1);
                        piece.data = data.into();
                        send(Kind::Piece(piece)).await;
                    }
                    other => send(other).await,
                }
            }
        });
        Ok(Response::new(ReceiverStream::new(receiver)))
    }
}

/// Joins as a worker that relays and takes no leases. Returns how often it was asked, and the routes it is told.
async fn liar(coordinator: &Coordinator, fate: Fate) -> (Arc<AtomicUsize>, mpsc::Receiver<Route>) {
    let channel = Endpoint::from_shared(coordinator.url()).expect("a URL").connect().await.expect("connects");
    let stamp = Stamp::new(Versions::own(), &Credentials::default());
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let address = listener.local_addr().expect("is bound");
    let asked = Arc::new(AtomicUsize::new(0));
    if fate == Fate::Absent {
        drop(listener);
    } else {
        let source = RelayClient::with_interceptor(channel.clone(), stamp.clone());
        let liar = Liar { fate, coordinator: source, asked: asked.clone() };
        let serving = Server::builder().add_service(RelayServer::new(liar));
        tokio::spawn(serving.serve_with_incoming(TcpListenerStream::new(listener)));
    }
    let (outbound, messages) = mpsc::channel(4);
    let relay = Some(RelayAddress { address, given: false });
    let hello = Hello { name: "liar".into(), threads: 1, memory_bytes: 1 << 30, relay };
    outbound.send(FromWorker::Hello(hello)).await.expect("is open");
    outbound.send(FromWorker::Draining).await.expect("is open");
    let mut client = ClusterClient::with_interceptor(channel, stamp);
    let joined = client.join(ReceiverStream::new(messages).map(Into::into)).await.expect("joins");
    let mut inbound = joined.into_inner();
    let (routes, told) = mpsc::channel(64);
    tokio::spawn(async move {
        let mut beats = tokio::time::interval(Duration::from_secs(1));
        loop {
            tokio::select! {
                _ = beats.tick() => drop(outbound.send(FromWorker::Heartbeat).await),
                message = inbound.message() => match message {
                    Ok(Some(message)) => if let Ok(ToWorker::Route(route)) = ToWorker::try_from(message) {
                        drop(routes.send(route).await);
                    },
                    _ => return,
                },
            }
        }
    });
    (asked, told)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn relays_that_lie_stall_or_are_not_there_are_routed_around() {
    for fate in [Fate::Absent, Fate::Silent, Fate::WrongList, Fate::WrongPieces, Fate::EndsEarly] {
        let (_store, coordinator) = start().await;
        // First in one of the trees, and so the source of two others.
        let (asked, _told) = liar(&coordinator, fate).await;
        let _workers = workers(&coordinator, 4, Listen::Auto).await;
        let copies = copies(&run(&coordinator).await);
        println!("{fate:?}: {copies:.2} copies");
        assert!(fate == Fate::Absent || asked.load(Ordering::Relaxed) > 0, "{fate:?} was not asked");
        // Its own half, taken to cheat with, and the two halves of those who gave it up.
        assert!(copies <= 3.0, "{fate:?}: {copies}");
    }
}

/// Asks a worker for a payload.
async fn ask(address: SocketAddr, request: PassRequest) -> Result<Vec<Passed>, Status> {
    let channel = Endpoint::from_shared(format!("http://{address}")).expect("a URL").connect().await.expect("connects");
    let mut client = RelayClient::with_interceptor(channel, Stamp::new(Versions::own(), &Credentials::default()));
    let mut passed = client.pass(wire::PassRequest::from(request)).await?.into_inner();
    let mut all = Vec::new();
    while let Some(message) = passed.message().await? {
        all.push(message);
    }
    Ok(all)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_gives_a_payload_to_whoever_has_its_ticket_and_to_nobody_else() {
    let (_store, coordinator) = start().await;
    let _workers = workers(&coordinator, 1, Listen::Auto).await;
    let (_asked, mut told) = liar(&coordinator, Fate::Absent).await;
    run(&coordinator).await;
    // Of two members each is the source of the other, for one stripe.
    let mut asked = 0;
    while let Ok(Route { blob, ticket, sources }) = told.try_recv() {
        let (stripe, address) = sources.iter().enumerate().find_map(|(s, a)| Some((s, *a.first()?))).expect("a source");
        let request = PassRequest { digest: blob.digest, ticket, stripe, first: stripe as u64 };
        // The scene's blobs and maps may be forgotten by the time the job is done, but never given away.
        let wrong = PassRequest { ticket: PassTicket([7; 16]), ..request };
        assert_eq!(ask(address, wrong).await.expect_err("is refused").code(), Code::NotFound);
        let passed = ask(address, request).await.expect("has the ticket");
        assert!(matches!(&passed[0].kind, Some(Kind::List(list)) if list.len() as u64 >= 32));
        asked += 1;
    }
    assert_eq!(asked, 2, "the scene and the map");
}

/// A job has run; where and with what each payload of it may be asked for.
async fn tickets(coordinator: &Coordinator) -> Vec<(SocketAddr, PassRequest)> {
    let (_asked, mut told) = liar(coordinator, Fate::Absent).await;
    run(coordinator).await;
    let mut passes = Vec::new();
    while let Ok(Route { blob, ticket, sources }) = told.try_recv() {
        let own = sources.iter().enumerate().filter_map(|(stripe, addresses)| Some((stripe, *addresses.first()?)));
        passes.extend(own.map(|(stripe, address)| {
            (address, PassRequest { digest: blob.digest, ticket, stripe, first: stripe as u64 })
        }));
    }
    assert!(!passes.is_empty());
    passes
}

async fn ask_all(passes: &[(SocketAddr, PassRequest)]) {
    for &(address, request) in passes {
        let passed = timeout(Duration::from_secs(5), ask(address, request)).await.expect("in time");
        assert!(passed.expect("has the ticket").len() > 1);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_crowd_without_tickets_takes_little_of_a_worker_and_nothing_of_those_who_have_them() {
    let (_store, coordinator) = start().await;
    let _workers = workers(&coordinator, 2, Listen::Auto).await;
    let passes = tickets(&coordinator).await;
    let address = passes[0].0;
    let dripping =
        tokio::spawn(
            async move { tokio::join!(drip(address, HTTP2_HANDSHAKE), drip(address, b"P"), drip(address, b"")) },
        );
    let held = crowd(address, 600).await;
    ask_all(&passes).await;
    // More calls for payloads that nobody knows than may wait, each on a connection of its own.
    let unknown = PassRequest { digest: Digest([7; 32]), ..passes[0].1 };
    let guesses: Vec<_> = (0..200).map(|_| tokio::spawn(ask(address, unknown))).collect();
    ask_all(&passes).await;
    run(&coordinator).await;
    for guess in guesses {
        assert!(guess.await.expect("did not panic").is_err());
    }
    assert!(still_open(&held) <= 256, "{} are open", still_open(&held));
    while !dripping.is_finished() {
        ask_all(&passes).await;
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    let (whole, half, nothing) = dripping.await.expect("did not panic");
    for time in [whole, half, nothing] {
        assert!(time < Duration::from_secs(20), "{time:?}");
    }
    // Those that came last have had less of their time.
    let closing = async {
        while still_open(&held) > 0 {
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    timeout(Duration::from_secs(20), closing).await.expect("are closed in time");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn requests_that_are_large_or_never_whole_are_refused() {
    let (_store, coordinator) = start().await;
    let _workers = workers(&coordinator, 2, Listen::Auto).await;
    let passes = tickets(&coordinator).await;
    let (address, request) = passes[0];
    let channel = Endpoint::from_shared(format!("http://{address}")).expect("a URL").connect().await.expect("connects");
    let stamp = Stamp::new(Versions::own(), &Credentials::default());
    let mut client = RelayClient::with_interceptor(channel.clone(), stamp.clone());
    let large = wire::PassRequest { digest: vec![7; 64 << 10].into(), ..request.into() };
    assert_eq!(client.pass(large).await.expect_err("is refused").code(), Code::OutOfRange);
    let mut padded = Request::new(wire::PassRequest::from(request));
    padded.metadata_mut().insert("padding", "x".repeat(40_000).parse().expect("is a value"));
    // What is no answer of the service shows where its stream is read.
    let answer = async { client.pass(padded).await?.into_inner().message().await };
    assert!(answer.await.is_err());
    // The connection is good; its request has headers, and no body ever.
    assert!(client.pass(wire::PassRequest::from(request)).await.is_ok());
    let mut raw = tonic::client::Grpc::new(InterceptedService::new(channel, stamp));
    let asking = async {
        raw.ready().await.expect("is open");
        let never = Request::new(tokio_stream::pending::<wire::PassRequest>());
        let path = "/gatherlight.v1.Relay/Pass".parse().expect("is a path");
        raw.client_streaming(never, path, tonic_prost::ProstCodec::<_, Passed>::default()).await.map(drop)
    };
    let answer = timeout(Duration::from_secs(20), asking).await.expect("in time");
    assert!(answer.is_err(), "{answer:?}");
    ask_all(&passes).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_has_a_ticket_has_no_more_streams_than_its_share() {
    let (_store, coordinator) = start().await;
    let _workers = workers(&coordinator, 2, Listen::Auto).await;
    let passes = tickets(&coordinator).await;
    // The map: more than a window, so that a stream nobody reads stays open.
    let (address, request) = passes[passes.len() - 1];
    let channel = Endpoint::from_shared(format!("http://{address}")).expect("a URL").connect().await.expect("connects");
    let client = RelayClient::with_interceptor(channel, Stamp::new(Versions::own(), &Credentials::default()));
    let mut open = JoinSet::new();
    for _ in 0..300 {
        let mut client = client.clone();
        open.spawn(async move { client.pass(wire::PassRequest::from(request)).await });
    }
    let mut unread = Vec::new();
    while let Ok(Some(answer)) = timeout(Duration::from_secs(1), open.join_next()).await {
        unread.extend(answer.expect("did not panic"));
    }
    // 64 at once; one that ends makes place for another. Without the bound of a connection it would be 256.
    assert!((1..100).contains(&unread.len()), "{} were answered", unread.len());
    ask_all(&passes).await;
}

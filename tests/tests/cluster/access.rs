//! Who may do what on a coordinator: tokens, their roles, whose jobs are whose, certificates; and secrets that stay secret.

use gatherlight::access::AccessConfig;
use gatherlight::client::{Client, ClientError, connect, connect_with};
use gatherlight::embedded;
use gatherlight::server::{ServeConfig, Server};
use gatherlight::types::{JobId, JobState};
use gatherlight_proto::connect::{Stamp, endpoint};
use gatherlight_proto::credentials::{CredentialFiles, Credentials, Token};
use gatherlight_proto::version::Versions;
use gatherlight_proto::wire;
use gatherlight_proto::wire::cluster_client::ClusterClient;
use gatherlight_render::settings::RenderSettings;
use gatherlight_tests::cluster::{Coordinator, Worker, finished_exr, request, small_leases, small_settings};
use gatherlight_tests::{film_pixels_sha256, pixel_sha256, scene};
use gatherlight_worker::{Connector, WorkerConfig, WorkerError};
use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, IsCa, KeyPair};
use std::path::{Path, PathBuf};
use tempfile::TempDir;
use tonic::Code;

const FARM: &str = "farm-SECRET-0123456789";
const ALICE: &str = "alice-SECRET-0123456789";
const BOB: &str = "bob-SECRET-0123456789";
const OPS: &str = "ops-SECRET-0123456789";

fn tokens() -> String {
    format!("farm worker {FARM}\nalice client {ALICE}\nbob client {BOB}\nops admin {OPS}\n")
}

fn token(text: &str) -> Credentials {
    Credentials::of_token(Token::new(text).expect("is a token"))
}

fn write(directory: &Path, name: &str, text: &str) -> PathBuf {
    let path = directory.join(name);
    std::fs::write(&path, text).expect("is written");
    path
}

fn config(store: &Path, access: AccessConfig) -> ServeConfig {
    let address = "127.0.0.1:0".parse().expect("an address");
    ServeConfig { threads: 1, policy: small_leases(), access, ..ServeConfig::new(address, store.to_owned()) }
}

struct Farm {
    _directory: TempDir,
    coordinator: Coordinator,
}

async fn farm() -> Farm {
    let directory = tempfile::tempdir().expect("a directory");
    let token_file = Some(write(directory.path(), "tokens", &tokens()));
    let access = AccessConfig { token_file, ..AccessConfig::default() };
    let coordinator = Coordinator::start_with(config(&directory.path().join("store"), access)).await;
    Farm { _directory: directory, coordinator }
}

impl Farm {
    async fn client(&self, secret: &str) -> Result<Client, ClientError> {
        connect_with(&self.coordinator.url(), 1, &token(secret)).await
    }
    fn worker(&self, secret: &str) -> Worker {
        let connector = Connector::with(&self.coordinator.url(), token(secret)).expect("a URL");
        Worker::start(WorkerConfig { threads: 1, ..WorkerConfig::new("w") }, connector)
    }
}

async fn submitted(client: &Client, settings: &RenderSettings) -> JobId {
    client.submit(&request(&scene("cornell-diffuse.glb"), settings), |_, _| {}).await.unwrap_or_else(|e| panic!("{e}"))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn jobs_belong_to_the_token_that_submitted_them() {
    let farm = farm().await;
    let (alice, bob) = (farm.client(ALICE).await.expect("is known"), farm.client(BOB).await.expect("is known"));
    let ops = farm.client(OPS).await.expect("is known");
    let id = submitted(&alice, &small_settings()).await;
    // To bob, alice's job is exactly as unknown as one that never was.
    let absent = JobId(id.0 ^ 1);
    let unknown = |e: ClientError, id: JobId| match e {
        ClientError::NotFound(text) => text.replace(&id.to_string(), "ID"),
        other => panic!("{other:?}"),
    };
    assert_eq!(unknown(bob.get(id).await.unwrap_err(), id), unknown(bob.get(absent).await.unwrap_err(), absent));
    assert_eq!(unknown(bob.cancel(id).await.unwrap_err(), id), unknown(bob.cancel(absent).await.unwrap_err(), absent));
    let fetch = async |id| unknown(bob.fetch(id, |_, _| {}).await.unwrap_err(), id);
    assert_eq!(fetch(id).await, fetch(absent).await);
    let watch = async |id| unknown(bob.watch(id).await.map(drop).unwrap_err(), id);
    assert_eq!(watch(id).await, watch(absent).await);
    assert!(bob.list().await.expect("is answered").is_empty());
    // Alice and the administrator see it, and it is not cancelled.
    for client in [&alice, &ops] {
        let listed = client.list().await.expect("is answered");
        assert_eq!(listed.iter().map(|j| (j.id, &*j.owner)).collect::<Vec<_>>(), [(id, "alice")]);
        assert_eq!(client.get(id).await.expect("is there").state, JobState::Waiting);
    }
    let _worker = farm.worker(FARM);
    let exr = finished_exr(&alice, id).await;
    let render =
        || embedded::render(&scene("cornell-diffuse.glb"), &small_settings(), &embedded::Config::default(), |_| {});
    let expected = tokio::task::spawn_blocking(render).await.expect("did not panic").unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(pixel_sha256(&exr), film_pixels_sha256(&expected.film));
    assert_eq!(ops.fetch(id, |_, _| {}).await.expect("may").exr, exr);
    // The administrator may cancel; the owner's view is the same.
    let second = submitted(&alice, &RenderSettings { seed: 9, samples: 4096, ..small_settings() }).await;
    assert_eq!(ops.cancel(second).await.expect("may").state, JobState::Cancelled);
    assert_eq!(alice.get(second).await.expect("is there").state, JobState::Cancelled);
}

#[tokio::test]
async fn a_token_allows_what_its_roles_say_and_no_more() {
    let farm = farm().await;
    // A worker's token submits nothing and sees nothing.
    let ClientError::Denied { reason, .. } = farm.client(FARM).await.unwrap_err() else { panic!("is denied") };
    assert!(reason.contains("client") && !reason.contains("SECRET"), "{reason}");
    // A client's token does not join, nor fetch or deliver.
    for secret in [ALICE, OPS] {
        let Err(WorkerError::Refused { reason, .. }) = farm.worker(secret).ended().await else { panic!("is refused") };
        assert!(reason.contains("worker") && !reason.contains("SECRET"), "{reason}");
        let channel =
            endpoint(&farm.coordinator.url(), &token(secret)).expect("a URL").connect().await.expect("connects");
        let stamp = Stamp::new(Versions::own(), &token(secret));
        let mut cluster = ClusterClient::with_interceptor(channel, stamp);
        let request = wire::LocateRequest { session: vec![0; 16].into(), digest: vec![0; 32].into() };
        assert_eq!(cluster.locate(request).await.map(drop).unwrap_err().code(), Code::PermissionDenied);
        let nothing = tokio_stream::iter(Vec::new());
        assert_eq!(cluster.deliver(nothing).await.map(drop).unwrap_err().code(), Code::PermissionDenied);
    }
}

#[tokio::test]
async fn without_a_known_token_there_is_nothing_to_see() {
    let farm = farm().await;
    let bare = connect(&farm.coordinator.url(), 1).await.unwrap_err().to_string();
    assert!(bare.contains("--token-file"), "{bare}");
    let almost = format!("{}x", &ALICE[..ALICE.len() - 1]);
    for wrong in [&*almost, "unknown-SECRET-0123456789"] {
        let text = farm.client(wrong).await.unwrap_err().to_string();
        assert!(text.contains("token") && !text.contains("SECRET"), "{text}");
        assert!(matches!(farm.worker(wrong).ended().await, Err(WorkerError::Refused { .. })));
    }
}

#[tokio::test]
async fn a_network_address_is_not_opened_without_proof() {
    let directory = tempfile::tempdir().expect("a directory");
    let bound = async |store: &str, access| {
        let listen = "0.0.0.0:0".parse().expect("an address");
        Server::bind(ServeConfig { listen, ..config(&directory.path().join(store), access) }).await.map(drop)
    };
    let refused = bound("first", AccessConfig::default()).await.expect_err("is refused").to_string();
    assert!(refused.contains("--token-file") && refused.contains("--insecure"), "{refused}");
    assert!(!directory.path().join("first").exists(), "refused before anything is made");
    bound("second", AccessConfig { insecure: true, ..AccessConfig::default() }).await.expect("is opened");
    let token_file = Some(write(directory.path(), "tokens", &tokens()));
    bound("third", AccessConfig { token_file, ..AccessConfig::default() }).await.expect("is opened");
}

/// An authority, what it has signed for `localhost` and for a peer, and another authority, as files.
struct Certificates {
    directory: TempDir,
}

impl Certificates {
    fn new() -> Self {
        let directory = tempfile::tempdir().expect("a directory");
        let issuer = || {
            let mut params = CertificateParams::new(Vec::new()).expect("are valid");
            params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
            CertifiedIssuer::self_signed(params, KeyPair::generate().expect("a key")).expect("is signed")
        };
        let (ours, theirs) = (issuer(), issuer());
        for (name, authority) in [("ours", &ours), ("theirs", &theirs)] {
            write(directory.path(), &format!("{name}.pem"), &authority.pem());
        }
        for (name, authority) in [("server", &ours), ("peer", &ours), ("other", &ours), ("stranger", &theirs)] {
            let key = KeyPair::generate().expect("a key");
            let params = CertificateParams::new(vec!["localhost".to_owned()]).expect("are valid");
            let certificate = params.signed_by(&key, authority).expect("is signed");
            write(directory.path(), &format!("{name}.pem"), &certificate.pem());
            write(directory.path(), &format!("{name}.key"), &key.serialize_pem());
        }
        Certificates { directory }
    }
    fn path(&self, name: &str) -> Option<PathBuf> {
        Some(self.directory.path().join(name))
    }
    fn access(&self) -> AccessConfig {
        let (tls_certificate, tls_key) = (self.path("server.pem"), self.path("server.key"));
        AccessConfig { tls_certificate, tls_key, ..AccessConfig::default() }
    }
    fn credentials(&self, authority: &str, own: Option<&str>, token: Option<PathBuf>) -> Credentials {
        let pem = |ending: &str| own.and_then(|name| self.path(&format!("{name}.{ending}")));
        let (certificate, key) = (pem("pem"), pem("key"));
        let files = CredentialFiles { token, authority: self.path(authority), certificate, key };
        Credentials::read(&files).unwrap_or_else(|e| panic!("{e}"))
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_encrypted_coordinator_serves_whoever_trusts_it() {
    let certificates = Certificates::new();
    let directory = certificates.directory.path();
    let token_file = Some(write(directory, "tokens", &tokens()));
    let access = AccessConfig { token_file, ..certificates.access() };
    let coordinator = Coordinator::start_with(config(&directory.join("store"), access)).await;
    let url = coordinator.encrypted_url();
    let alice = certificates.credentials("ours.pem", None, Some(write(directory, "alice", ALICE)));
    let farm = certificates.credentials("ours.pem", None, Some(write(directory, "farm", FARM)));
    let client = connect_with(&url, 3, &alice).await.unwrap_or_else(|e| panic!("{e}"));
    let _worker = Worker::start(
        WorkerConfig { threads: 1, ..WorkerConfig::new("w") },
        Connector::with(&url, farm).unwrap_or_else(|e| panic!("{e}")),
    );
    let id = submitted(&client, &small_settings()).await;
    finished_exr(&client, id).await;
    // Whoever trusts another authority does not send its token, and whoever speaks in the clear is not answered.
    let deceived = certificates.credentials("theirs.pem", None, Some(write(directory, "alice", ALICE)));
    let text = connect_with(&url, 1, &deceived).await.unwrap_err().to_string();
    assert!(text.contains("certificate") && !text.contains("SECRET"), "{text}");
    assert!(matches!(
        connect_with(&coordinator.url(), 1, &token(ALICE)).await,
        Err(ClientError::Unreachable { .. } | ClientError::Transport { .. })
    ));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_certificate_proves_its_owner_where_the_coordinator_asks_for_one() {
    let certificates = Certificates::new();
    let access = AccessConfig { tls_client_ca: certificates.path("ours.pem"), ..certificates.access() };
    let coordinator = Coordinator::start_with(config(&certificates.directory.path().join("store"), access)).await;
    let url = coordinator.encrypted_url();
    let connected = async |own| connect_with(&url, 1, &certificates.credentials("ours.pem", own, None)).await;
    let peer = connected(Some("peer")).await.unwrap_or_else(|e| panic!("{e}"));
    let other = connected(Some("other")).await.unwrap_or_else(|e| panic!("{e}"));
    assert!(connected(None).await.is_err() && connected(Some("stranger")).await.is_err());
    let id = submitted(&peer, &small_settings()).await;
    assert!(peer.get(id).await.expect("is its own").owner.starts_with("certificate "));
    assert!(matches!(other.get(id).await, Err(ClientError::NotFound(_))));
    let _worker = Worker::start(
        WorkerConfig { threads: 1, ..WorkerConfig::new("w") },
        Connector::with(&url, certificates.credentials("ours.pem", Some("peer"), None)).expect("a URL"),
    );
    finished_exr(&peer, id).await;
}

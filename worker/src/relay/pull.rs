//! Filling a transfer: each stripe from its first source that works, going on with the next one where it broke.

use super::transfer::Transfer;
use gatherlight_proto::connect::{Stamp, endpoint, reason};
use gatherlight_proto::credentials::Credentials;
use gatherlight_proto::limits::MAX_MESSAGE_BYTES;
use gatherlight_proto::message::{PassRequest, Route};
use gatherlight_proto::pieces::STRIPES;
use gatherlight_proto::version::Versions;
use gatherlight_proto::wire;
use gatherlight_proto::wire::passed::Kind;
use gatherlight_proto::wire::relay_client::RelayClient;
use std::collections::BTreeMap;
use std::future::Future;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::timeout;
use tonic::Status;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;

/// Silence after which a relay is taken for dead: several of its signs of life.
pub(super) const SILENCE: Duration = Duration::from_secs(3);
/// Time a relay may take to accept a connection.
const CONNECT_TIME: Duration = Duration::from_secs(2);

/// One who passes payloads on.
pub(crate) type Client = RelayClient<InterceptedService<Channel, Stamp>>;

/// A client for what listens on `channel`.
pub(crate) fn client(channel: Channel, stamp: Stamp) -> Client {
    RelayClient::with_interceptor(channel, stamp).max_decoding_message_size(MAX_MESSAGE_BYTES)
}

/// Connections to other workers, kept for the next payload; clones share them.
#[derive(Clone)]
pub(super) struct Peers {
    versions: Versions,
    open: Arc<Mutex<BTreeMap<SocketAddr, Client>>>,
}

impl Peers {
    pub(super) fn new(versions: Versions) -> Self {
        Peers { versions, open: Arc::default() }
    }
    async fn connect(&self, address: SocketAddr) -> Result<Client, String> {
        let known = self.lock().get(&address).cloned();
        if let Some(known) = known {
            return Ok(known);
        }
        // A ticket is enough there; the coordinator's token is none of another worker's business.
        let nothing = Credentials::default();
        let connecting =
            endpoint(&format!("http://{address}"), &nothing)?.connect_timeout(CONNECT_TIME).connect().await;
        let stamp = Stamp::new(self.versions.clone(), &nothing);
        let client = client(connecting.map_err(|e| reason(&e))?, stamp);
        self.lock().insert(address, client.clone());
        Ok(client)
    }
    fn forget(&self, address: SocketAddr) {
        self.lock().remove(&address);
    }
    /// Forgets all of them.
    pub(super) fn clear(&self) {
        self.lock().clear();
    }
    fn lock(&self) -> MutexGuard<'_, BTreeMap<SocketAddr, Client>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Fills `transfer` by `route`, of whose sources `coordinator` is the last; it is complete or failed afterwards.
pub(super) async fn fill(transfer: &Transfer, route: &Route, coordinator: &Client, peers: &Peers) {
    let stripe = |stripe| fill_stripe(transfer, route, stripe, coordinator, peers);
    const { assert!(STRIPES == 2, "both are filled at once") };
    if let Err(reason) = tokio::try_join!(stripe(0), stripe(1)) {
        transfer.fail(reason);
    }
}

async fn fill_stripe(
    transfer: &Transfer,
    route: &Route,
    stripe: usize,
    coordinator: &Client,
    peers: &Peers,
) -> Result<(), String> {
    for &address in &route.sources[stripe] {
        if transfer.due(stripe).is_none() {
            return Ok(());
        }
        let passed = match peers.connect(address).await {
            Ok(relay) => pass(transfer, route, stripe, relay, Some(SILENCE)).await,
            Err(reason) => Err(reason),
        };
        match passed {
            Ok(()) => return Ok(()),
            Err(reason) => {
                peers.forget(address);
                tracing::warn!(digest = %route.blob.digest, stripe, %address, reason, "relay given up");
            }
        }
    }
    // Its silence is a full link; a dead connection ends by itself.
    pass(transfer, route, stripe, coordinator.clone(), None).await
}

/// Takes the pieces of `stripe` that are not there from `relay`.
async fn pass(
    transfer: &Transfer,
    route: &Route,
    stripe: usize,
    mut relay: Client,
    silence: Option<Duration>,
) -> Result<(), String> {
    let Some(first) = transfer.due(stripe) else { return Ok(()) };
    let request = PassRequest { digest: route.blob.digest, ticket: route.ticket, stripe, first };
    let text = |status: Status| status.message().to_owned();
    let mut passed = within(silence, relay.pass(wire::PassRequest::from(request))).await?.map_err(text)?.into_inner();
    while transfer.due(stripe).is_some() {
        let message = within(silence, passed.message()).await?.map_err(text)?;
        match message.ok_or("it ended early")?.kind {
            Some(Kind::List(list)) => transfer.put_list(&list).map_err(|e| e.to_string())?,
            Some(Kind::Piece(p)) => transfer.put(stripe, p.index, &p.data).map_err(|e| e.to_string())?,
            Some(Kind::Waiting(_)) => {}
            None => return Err("a message says nothing".into()),
        }
    }
    Ok(())
}

/// What `f` gives, if it does before `silence` is over.
async fn within<T>(silence: Option<Duration>, f: impl Future<Output = T>) -> Result<T, String> {
    match silence {
        None => Ok(f.await),
        Some(silence) => timeout(silence, f).await.map_err(|_| format!("nothing came for {silence:?}")),
    }
}

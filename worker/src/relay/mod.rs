//! The broadcast at a worker: payloads come in from workers nearer to the coordinator, or from the coordinator, and are passed
//! on, piece by piece, to those below, as they arrive and are checked.
//!
//! - `transfer`: one payload on its way in;
//! - `held`: what is here, and the ways to the rest;
//! - `pull`: filling a transfer from its sources;
//! - `server`: passing on.

mod held;
mod pull;
mod server;
mod transfer;

pub(crate) use pull::{Client, client};

use crate::counters::Counters;
use crate::error::TaskError;
use bytes::Bytes;
use gatherlight_proto::Digest;
use gatherlight_proto::message::{BlobRef, PassTicket, RelayAddress, Route};
use gatherlight_proto::version::Versions;
use held::Held;
use pull::Peers;
use std::future::Future;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::net::{TcpListener, UdpSocket};
use tokio::sync::watch;
use transfer::Transfer;

/// Whether and where a worker listens for other workers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Listen {
    /// Nowhere: it gets everything from the coordinator.
    #[default]
    Off,
    /// On a free port of the address from which it reaches the coordinator.
    Auto,
    /// On this address; port 0 takes a free one.
    On(SocketAddr),
}

/// What a worker holds and passes on; clones share it. It outlives sessions.
#[derive(Clone)]
pub struct Relay {
    held: Arc<Mutex<Held>>,
    /// Told of every new route.
    told: watch::Sender<()>,
    peers: Peers,
}

impl Relay {
    /// Nothing held, of a worker that may use `memory_bytes`.
    pub(crate) fn new(memory_bytes: u64, versions: Versions) -> Self {
        Relay {
            held: Arc::new(Mutex::new(Held::new(memory_bytes))),
            told: watch::Sender::default(),
            peers: Peers::new(versions),
        }
    }
    /// Begins to listen for other workers, counting what they do; `coordinator` is where the coordinator is.
    ///
    /// # Errors
    /// When it cannot listen there.
    pub(crate) async fn listen(
        &self,
        listen: Listen,
        coordinator: &str,
        counters: Arc<Counters>,
    ) -> std::io::Result<Option<RelayAddress>> {
        let (address, given) = match listen {
            Listen::Off => return Ok(None),
            Listen::On(address) => (address, true),
            Listen::Auto => (SocketAddr::new(own_address(coordinator).await?, 0), false),
        };
        let listener = TcpListener::bind(address).await?;
        let mut address = listener.local_addr()?;
        if address.ip().is_unspecified() {
            address.set_ip(own_address(coordinator).await?);
        }
        tokio::spawn(server::serve(self.clone(), listener, counters));
        tracing::info!(%address, "listening for other workers");
        Ok(Some(RelayAddress { address, given }))
    }
    /// Takes in the way to a payload, and begins to get it if there is room before it is needed.
    pub(crate) fn announce(&self, route: Route, coordinator: Client) {
        // Begun before anybody may ask for it.
        let is_early = self.lock().has_room_ahead(route.blob.bytes);
        if is_early {
            drop(self.transfer(route.clone(), coordinator));
        }
        self.told(route);
    }
    /// The payload, from here or by its route, and whether it came for this; `locate` asks for one that was not announced.
    ///
    /// # Errors
    /// When it does not come.
    pub(crate) async fn fetch(
        &self,
        what: &str,
        blob: BlobRef,
        coordinator: Client,
        locate: impl Future<Output = Result<Route, TaskError>>,
    ) -> Result<(Bytes, bool), TaskError> {
        let failed = |reason| TaskError::Fetch { what: what.into(), reason };
        let here = self.lock().get(blob.digest);
        let transfer = match here {
            Some(transfer) => transfer,
            None => {
                let known = self.lock().route(blob.digest);
                let route = match known {
                    Some(route) => route,
                    None => locate.await?,
                };
                if route.blob != blob {
                    return Err(failed(format!("it has {} bytes, not {}", route.blob.bytes, blob.bytes)));
                }
                let transfer = self.transfer(route.clone(), coordinator);
                self.told(route);
                transfer
            }
        };
        let bytes = transfer.whole().await.map_err(failed)?;
        self.lock().make_room();
        Ok((bytes, transfer.begin_use()))
    }
    /// From now on others may ask for what `route` leads to.
    fn told(&self, route: Route) {
        self.lock().put_route(route);
        self.told.send_replace(());
    }
    /// The transfer by `route`, which is begun unless it is here.
    fn transfer(&self, route: Route, coordinator: Client) -> Arc<Transfer> {
        let (transfer, is_new) = self.lock().get_or_begin(route.blob);
        if is_new {
            let (filled, peers) = (transfer.clone(), self.peers.clone());
            tokio::spawn(async move {
                pull::fill(&filled, &route, &coordinator, &peers).await;
                let BlobRef { digest, bytes } = route.blob;
                tracing::info!(%digest, bytes, complete = filled.is_complete(), "payload received");
            });
        }
        transfer
    }
    /// Whether this payload was announced.
    fn is_told(&self, digest: Digest) -> bool {
        self.lock().route(digest).is_some()
    }
    /// Waits until this payload was announced; `None` if it was with another ticket, or is not here.
    async fn admitted(&self, digest: Digest, ticket: PassTicket) -> Option<Arc<Transfer>> {
        let mut told = self.told.subscribe();
        loop {
            let admits = self.lock().admits(digest, &ticket);
            match admits {
                Some(true) => return self.lock().get(digest),
                Some(false) => return None,
                None => drop(told.changed().await),
            }
        }
    }
    /// Drops a payload. Who is being sent it still gets it.
    pub(crate) fn forget(&self, digest: Digest) {
        self.lock().forget(digest);
    }
    /// Forgets the routes of a session that is over; what has arrived stays.
    pub(crate) fn end_session(&self) {
        self.lock().forget_routes();
        self.peers.clear();
    }
    fn lock(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The address of this machine from which it reaches `coordinator`, a host and a port. Nothing is sent.
async fn own_address(coordinator: &str) -> std::io::Result<std::net::IpAddr> {
    let mut last = None;
    for address in tokio::net::lookup_host(coordinator).await? {
        let any: SocketAddr = if address.is_ipv4() { ([0, 0, 0, 0], 0).into() } else { ([0_u16; 8], 0).into() };
        let connected = async {
            let socket = UdpSocket::bind(any).await?;
            socket.connect(address).await?;
            socket.local_addr()
        };
        match connected.await {
            Ok(own) => return Ok(own.ip()),
            Err(error) => last = Some(error),
        }
    }
    Err(last.unwrap_or_else(|| std::io::Error::other("the coordinator has no address")))
}

//! What workers call.

use super::quota::{Quota, Slot};
use super::{Context, ReplyStream};
use crate::counters::Counters;
use crate::driver::{Delivery, Handle, Offered, Ticket};
use crate::result;
use crate::room::{self, Room};
use bytes::Bytes;
use gatherlight_proto::chunk::Assembler;
use gatherlight_proto::message::{DeliverHeader, FromWorker, Hello, SessionKey, WorkerId};
use gatherlight_proto::serve::{Peer, Rate, Tally};
use gatherlight_proto::wire::cluster_server::Cluster;
use gatherlight_proto::wire::deliver_request::Kind;
use gatherlight_proto::wire::{
    CoordinatorMessage, DeliverReply, DeliverRequest, LocateRequest, Proceed, Receipt, Route, WorkerMessage,
    deliver_reply,
};
use gatherlight_proto::{Digest, WireError};
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};
use tokio::time::Instant;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Request, Response, Status, Streaming};

/// Time a worker has to introduce itself, and a delivery to send its next chunk.
const PATIENCE: Duration = Duration::from_secs(30);

/// Workers' sessions at once.
const MAX_SESSIONS: usize = 4_096;
/// Messages a worker may send a second: a heartbeat, and some for each of its leases.
const MESSAGES_PER_SECOND: u32 = 100;

/// Shared by the calls.
#[derive(Clone)]
pub(super) struct ClusterService {
    context: Context,
    sessions: Arc<Quota<()>>,
}

impl ClusterService {
    pub(super) fn new(context: Context) -> Self {
        ClusterService { context, sessions: Arc::new(Quota::new("sessions", MAX_SESSIONS)) }
    }
}

#[tonic::async_trait]
impl Cluster for ClusterService {
    type JoinStream = ReplyStream<CoordinatorMessage>;
    type DeliverStream = ReplyStream<DeliverReply>;

    async fn join(&self, request: Request<Streaming<WorkerMessage>>) -> Result<Response<Self::JoinStream>, Status> {
        let slot = self.sessions.take(())?;
        let from = Peer::of(request.extensions()).map(Peer::address);
        let mut inbound = request.into_inner();
        let first = next(&mut inbound).await?.ok_or(WireError::Missing("hello"))?;
        let FromWorker::Hello(mut hello) = FromWorker::try_from(first)? else {
            return Err(WireError::invalid("message", "the first one has to be hello").into());
        };
        drop_unreachable_relay(&mut hello, from);
        let driver = self.context.driver.clone();
        let joined = driver.join(hello).await.ok_or_else(|| Status::unavailable("shutting down"))?;
        let counters = self.context.counters.clone();
        tokio::spawn(listen(driver, counters, joined.worker, inbound, joined.dismissed, slot));
        let outbound = ReceiverStream::new(joined.messages).map(|m| Ok(m.into()));
        Ok(Response::new(Box::pin(outbound)))
    }

    async fn locate(&self, request: Request<LocateRequest>) -> Result<Response<Route>, Status> {
        let LocateRequest { session, digest } = request.into_inner();
        let digest = Digest::try_from(&digest[..])?;
        let route = self.context.driver.locate(SessionKey::try_from(&session[..])?, digest).await;
        let unknown = || Status::not_found(format!("{digest} belongs to no running job of this session"));
        Ok(Response::new(route.ok_or_else(unknown)?.into()))
    }

    async fn deliver(
        &self,
        request: Request<Streaming<DeliverRequest>>,
    ) -> Result<Response<Self::DeliverStream>, Status> {
        let mut inbound = request.into_inner();
        let first = next(&mut inbound).await?.and_then(|m| m.kind);
        let Some(Kind::Header(header)) = first else {
            return Err(WireError::invalid("delivery", "the first message has to be the header").into());
        };
        let header = DeliverHeader::try_from(header)?;
        let (replies, outbound) = mpsc::channel(2);
        let service = self.clone();
        tokio::spawn(async move {
            let last = service.take_in(header, inbound, &replies).await;
            drop(replies.send(last.map(|accepted| reply(deliver_reply::Kind::Receipt(Receipt { accepted })))).await);
        });
        Ok(Response::new(Box::pin(ReceiverStream::new(outbound))))
    }
}

/// What is sent back to whoever delivers.
type Replies = mpsc::Sender<Result<DeliverReply, Status>>;

fn reply(kind: deliver_reply::Kind) -> DeliverReply {
    DeliverReply { kind: Some(kind) }
}

/// A worker that says it listens on an address from which it does not connect is behind NAT: nobody could reach it.
fn drop_unreachable_relay(hello: &mut Hello, from: Option<SocketAddr>) {
    let seen = |address: SocketAddr| from.is_some_and(|f| f.ip().to_canonical() == address.ip().to_canonical());
    if let Some(relay) = hello.relay.take_if(|r| !r.given && !seen(r.address)) {
        tracing::info!(name = hello.name, address = %relay.address, ?from, "is behind NAT, so it does not relay");
    }
}

impl ClusterService {
    /// Takes in a result and returns whether it counts. None of it is sent before there is room, nor if it is not wanted.
    async fn take_in(
        &self,
        header: DeliverHeader,
        mut inbound: Streaming<DeliverRequest>,
        replies: &Replies,
    ) -> Result<bool, Status> {
        let began = Instant::now();
        let ticket = match self.context.driver.offer(header).await {
            Offered::Wanted(ticket) => *ticket,
            Offered::Repeated(worker) => {
                self.context.driver.repeated(worker, header, header.digest).await;
                return Ok(false);
            }
            Offered::Stale => return Ok(false),
        };
        let room = tokio::select! {
            room = self.context.rooms.take(room::needed(&ticket, header.bytes), ticket.is_early) => room,
            () = replies.closed() => return Ok(false),
        };
        if replies.send(Ok(reply(deliver_reply::Kind::Proceed(Proceed {})))).await.is_err() {
            return Ok(false);
        }
        let received = match receive(&mut inbound, header.bytes).await {
            Ok((bytes, digest)) => self.decode(&ticket, bytes, digest, began.elapsed(), room).await,
            Err(status) => Err(status),
        };
        match received {
            Ok(delivery) => Ok(self.context.driver.complete(delivery).await),
            Err(status) => {
                // A broken connection is no fault of the task: its worker is lost, or tells us itself.
                if !is_broken_connection(&status) {
                    self.context.driver.refuse(ticket, status.message().to_owned()).await;
                }
                Err(status)
            }
        }
    }
    /// Decodes a result on the compute threads.
    async fn decode(
        &self,
        ticket: &Ticket,
        raw: Bytes,
        digest: Digest,
        transfer: Duration,
        room: Room,
    ) -> Result<Delivery, Status> {
        let ticket = ticket.clone();
        let decode = move || {
            let payload = result::read(&ticket.shape, ticket.phase.1, ticket.range, &raw)?;
            Ok::<_, WireError>(Delivery { ticket, payload, raw, digest, room, transfer })
        };
        let decoded = self.context.compute.run(decode).await;
        Ok(decoded.map_err(|e| Status::internal(e.to_string()))??)
    }
}

fn is_broken_connection(status: &Status) -> bool {
    matches!(status.code(), Code::Cancelled | Code::Unknown | Code::Unavailable)
}

/// The chunks that follow the header, as one payload with its digest.
async fn receive(inbound: &mut Streaming<DeliverRequest>, announced: u64) -> Result<(Bytes, Digest), Status> {
    let mut assembler = Assembler::new("result size in bytes", announced, "as the header says");
    while let Some(message) = next(inbound).await? {
        let Some(Kind::Chunk(chunk)) = message.kind else {
            return Err(WireError::invalid("delivery", "only chunks may follow the header").into());
        };
        assembler.push(&chunk)?;
    }
    Ok(assembler.finish()?)
}

/// The next message, within [`PATIENCE`].
async fn next<T>(inbound: &mut Streaming<T>) -> Result<Option<T>, Status> {
    let waited = tokio::time::timeout(PATIENCE, inbound.message()).await;
    waited.unwrap_or_else(|_| Err(Status::deadline_exceeded("the next message did not come in time")))
}

/// Passes on what a worker says until its session ends, from either side, or it says too much.
async fn listen(
    driver: Handle,
    counters: Arc<Counters>,
    worker: WorkerId,
    mut inbound: Streaming<WorkerMessage>,
    mut dismissed: oneshot::Receiver<()>,
    _slot: Slot<()>,
) {
    let (began, mut rate) = (Instant::now(), Rate::new(MESSAGES_PER_SECOND));
    loop {
        let message = tokio::select! {
            message = inbound.message() => message,
            _ = &mut dismissed => break,
        };
        let message = match message {
            Ok(Some(message)) => FromWorker::try_from(message),
            Ok(None) | Err(_) => break,
        };
        if !rate.admit(began.elapsed()) {
            tracing::warn!(worker = worker.0, "more than {MESSAGES_PER_SECOND} messages a second: dismissed");
            counters.refused("too_many_messages");
            break;
        }
        match message {
            Ok(message) => driver.message(worker, message).await,
            Err(error) => {
                tracing::warn!(worker = worker.0, %error, "senseless message");
                counters.refused("senseless_message");
                break;
            }
        }
    }
    driver.left(worker).await;
}

//! What workers call.

use super::{Context, ReplyStream, memory_chunks, stored_chunks};
use crate::driver::{Delivery, Handle, Offered, Source, Ticket};
use crate::result;
use bytes::Bytes;
use gatherlight_proto::chunk::Assembler;
use gatherlight_proto::limits::MAX_RESULT_BYTES;
use gatherlight_proto::message::{DeliverHeader, FromWorker, WorkerId};
use gatherlight_proto::wire::cluster_server::Cluster;
use gatherlight_proto::wire::deliver_request::Kind;
use gatherlight_proto::wire::{Chunk, CoordinatorMessage, DeliverRequest, FetchRequest, Receipt, WorkerMessage};
use gatherlight_proto::{Digest, WireError};
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::sync::oneshot;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Request, Response, Status, Streaming};

/// Time a worker has to introduce itself, and a delivery to send its next chunk.
const PATIENCE: Duration = Duration::from_secs(30);

pub(super) struct ClusterService {
    context: Context,
}

impl ClusterService {
    pub(super) fn new(context: Context) -> Self {
        ClusterService { context }
    }
}

#[tonic::async_trait]
impl Cluster for ClusterService {
    type JoinStream = ReplyStream<CoordinatorMessage>;
    type FetchStream = ReplyStream<Chunk>;

    async fn join(&self, request: Request<Streaming<WorkerMessage>>) -> Result<Response<Self::JoinStream>, Status> {
        let mut inbound = request.into_inner();
        let first = next(&mut inbound).await?.ok_or(WireError::Missing("hello"))?;
        let FromWorker::Hello(hello) = FromWorker::try_from(first)? else {
            return Err(WireError::invalid("message", "the first one has to be hello").into());
        };
        let driver = self.context.driver.clone();
        let joined = driver.join(hello).await.ok_or_else(|| Status::unavailable("shutting down"))?;
        tokio::spawn(listen(driver, joined.worker, inbound, joined.dismissed));
        let outbound = ReceiverStream::new(joined.messages).map(|m| Ok(m.into()));
        Ok(Response::new(Box::pin(outbound)))
    }

    async fn fetch(&self, request: Request<FetchRequest>) -> Result<Response<Self::FetchStream>, Status> {
        let FetchRequest { session, digest } = request.into_inner();
        let digest = Digest::try_from(&digest[..])?;
        let source = self.context.driver.source(session, digest).await;
        let stream = match source {
            None => return Err(Status::not_found(format!("{digest} belongs to no running job of this session"))),
            Some(Source::Blob(digest)) => stored_chunks(self.context.store.clone(), digest)?,
            Some(Source::Memory { bytes, sent }) => memory_chunks(bytes, digest, move |n| {
                sent.fetch_add(n, Ordering::Relaxed);
            }),
        };
        Ok(Response::new(stream))
    }

    async fn deliver(&self, request: Request<Streaming<DeliverRequest>>) -> Result<Response<Receipt>, Status> {
        let mut inbound = request.into_inner();
        let first = next(&mut inbound).await?.and_then(|m| m.kind);
        let Some(Kind::Header(header)) = first else {
            return Err(WireError::invalid("delivery", "the first message has to be the header").into());
        };
        let header = DeliverHeader::try_from(header)?;
        // Asked before any of it is read: what is not wanted costs nothing.
        let ticket = match self.context.driver.offer(header).await {
            Offered::Wanted(ticket) => *ticket,
            Offered::Repeated(worker) => {
                if let Some(digest) = announced(&mut inbound).await? {
                    self.context.driver.repeated(worker, header, digest).await;
                }
                return Ok(Response::new(Receipt { accepted: false }));
            }
            Offered::Stale => return Ok(Response::new(Receipt { accepted: false })),
        };
        let received = match receive(&mut inbound).await {
            Ok((bytes, digest)) => self.decode(&ticket, bytes, digest).await,
            Err(status) => Err(status),
        };
        match received {
            Ok(delivery) => {
                let accepted = self.context.driver.complete(delivery).await;
                Ok(Response::new(Receipt { accepted }))
            }
            Err(status) => {
                // A broken connection is no fault of the task: its worker is lost, or tells us itself.
                if !is_broken_connection(&status) {
                    self.context.driver.refuse(ticket, status.message().to_owned()).await;
                }
                Err(status)
            }
        }
    }
}

impl ClusterService {
    /// Decodes a result on the compute threads.
    async fn decode(&self, ticket: &Ticket, raw: Bytes, digest: Digest) -> Result<Delivery, Status> {
        let ticket = ticket.clone();
        let decode = move || {
            let payload = result::read(&ticket.shape, ticket.phase.1, ticket.range, &raw)?;
            Ok::<_, WireError>(Delivery { ticket, payload, raw, digest })
        };
        let decoded = self.context.compute.run(decode).await;
        Ok(decoded.map_err(|e| Status::internal(e.to_string()))??)
    }
}

fn is_broken_connection(status: &Status) -> bool {
    matches!(status.code(), Code::Cancelled | Code::Unknown | Code::Unavailable)
}

/// The digest that the first chunk after the header announces.
async fn announced(inbound: &mut Streaming<DeliverRequest>) -> Result<Option<Digest>, Status> {
    match next(inbound).await?.and_then(|m| m.kind) {
        Some(Kind::Chunk(chunk)) if chunk.index == 0 => Ok(Some(Digest::try_from(&chunk.digest[..])?)),
        _ => Ok(None),
    }
}

/// The chunks that follow the header, as one payload with its digest.
async fn receive(inbound: &mut Streaming<DeliverRequest>) -> Result<(Bytes, Digest), Status> {
    let mut assembler = Assembler::new("result size in bytes", MAX_RESULT_BYTES, "MAX_RESULT_BYTES");
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

/// Passes on what a worker says until its session ends, from either side.
async fn listen(
    driver: Handle,
    worker: WorkerId,
    mut inbound: Streaming<WorkerMessage>,
    mut dismissed: oneshot::Receiver<()>,
) {
    loop {
        let message = tokio::select! {
            message = inbound.message() => message,
            _ = &mut dismissed => break,
        };
        let message = match message {
            Ok(Some(message)) => FromWorker::try_from(message),
            Ok(None) | Err(_) => break,
        };
        match message {
            Ok(message) => driver.message(worker, message).await,
            Err(error) => {
                tracing::warn!(worker = worker.0, %error, "senseless message");
                break;
            }
        }
    }
    driver.left(worker).await;
}

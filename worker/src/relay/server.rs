//! What a worker passes on to others.

use super::Relay;
use super::pull::SILENCE;
use super::transfer::{Piece, Transfer};
use crate::counters::Counters;
use gatherlight_proto::message::PassRequest;
use gatherlight_proto::serve::{Call, ConnectionLimits, CountRefusals, Incoming, Peer, server};
use gatherlight_proto::version;
use gatherlight_proto::wire::passed::Kind;
use gatherlight_proto::wire::relay_server::{self, RelayServer};
use gatherlight_proto::wire::{self, Passed, Waiting};
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio::time::timeout;
use tokio_stream::wrappers::ReceiverStream;
use tonic::service::interceptor::InterceptedService;
use tonic::{Request, Response, Status};
use tower::layer::layer_fn;

/// Streams that are served at once: two for each worker below this one, those that go around lost ones, and latecomers.
const MAX_STREAMS: usize = 256;
/// Of one connection.
const MAX_STREAMS_OF_ONE: u32 = 64;
/// Calls at once that name a payload this worker has not heard of, by peers who had none from here yet.
const MAX_WAITING: usize = 64;
/// Longest request, in bytes: a digest, a ticket and two numbers.
const MAX_REQUEST_BYTES: usize = 1 << 10;
/// What a peer may send before it is read, in bytes, on a stream or a connection: HTTP/2's own least, since requests are short.
const REQUEST_WINDOW_BYTES: u32 = (64 << 10) - 1;
/// Time a request may take to be there as a whole and be answered.
const REQUEST_TIME: Duration = Duration::from_secs(10);
/// Time a reader may take for a message; it has a window of many to fall behind.
const READ_TIME: Duration = Duration::from_secs(60);
/// Time between two signs of life while there is nothing to pass on.
const SIGN_OF_LIFE: Duration = Duration::from_millis(500);
/// Messages that wait for a slow reader.
const QUEUE: usize = 2;
/// Other workers connect again when they have to. Together with what a worker opens itself, below 1,024 files, which systems allow.
const CONNECTIONS: ConnectionLimits =
    ConnectionLimits { introduction: REQUEST_TIME, unknown: 256, all: 512, idle: Some(Duration::from_secs(300)) };

/// The service, over what `relay` holds.
struct Service {
    relay: Relay,
    streams: Arc<Semaphore>,
    waiting: Semaphore,
}

/// Serves on `listener` until it fails.
pub(super) async fn serve(relay: Relay, listener: TcpListener, counters: Arc<Counters>) {
    let (streams, waiting) = (Arc::new(Semaphore::new(MAX_STREAMS)), Semaphore::new(MAX_WAITING));
    let service = RelayServer::new(Service { relay, streams, waiting }).max_decoding_message_size(MAX_REQUEST_BYTES);
    let check = |request: Request<()>| {
        if Peer::of(request.extensions()).is_some_and(|p| !p.may_call()) {
            return Err(Status::resource_exhausted("too many calls a second on this connection; slow down"));
        }
        version::check(request.metadata(), "worker", true)?;
        Ok(request)
    };
    let tally = counters.clone();
    let server = server(MAX_STREAMS_OF_ONE, REQUEST_WINDOW_BYTES, REQUEST_WINDOW_BYTES)
        .timeout(REQUEST_TIME)
        .layer(layer_fn(move |inner| CountRefusals::new(inner, tally.clone())))
        .add_service(InterceptedService::new(service, check));
    let incoming = Incoming::new(listener, CONNECTIONS, counters);
    if let Err(error) = server.serve_with_incoming(incoming).await {
        tracing::warn!(%error, "relaying ended");
    }
}

impl Service {
    /// The payload that `request` has the ticket for. Whoever asks may have heard of it a moment before this worker does.
    async fn admitted(&self, peer: Option<&Peer>, request: PassRequest) -> Option<Arc<Transfer>> {
        let PassRequest { digest, ticket, .. } = request;
        let _waiting = match self.relay.is_told(digest) || peer.is_some_and(Peer::is_known) {
            true => None,
            false => Some(self.waiting.try_acquire().ok()?),
        };
        timeout(SILENCE / 2, self.relay.admitted(digest, ticket)).await.ok().flatten()
    }
}

#[tonic::async_trait]
impl relay_server::Relay for Service {
    type PassStream = ReceiverStream<Result<Passed, Status>>;

    async fn pass(&self, request: Request<wire::PassRequest>) -> Result<Response<Self::PassStream>, Status> {
        let peer = Peer::of(request.extensions()).cloned();
        let request = PassRequest::try_from(request.into_inner())?;
        let transfer = self.admitted(peer.as_ref(), request).await;
        let transfer = transfer.ok_or_else(|| Status::not_found("no such payload with this ticket"))?;
        // Nothing is kept of a call before its ticket is known to be good.
        let call = peer.as_ref().map(Peer::begin_call);
        peer.iter().for_each(Peer::introduce);
        let busy = |_| Status::resource_exhausted(format!("{MAX_STREAMS} streams are served already"));
        let stream = self.streams.clone().try_acquire_owned().map_err(busy)?;
        let (sender, receiver) = mpsc::channel(QUEUE);
        tokio::spawn(send(transfer, request.first, sender, (stream, call)));
        Ok(Response::new(ReceiverStream::new(receiver)))
    }
}

/// Sends the list and the pieces of the stripe from `first` on, as they arrive here.
async fn send(
    transfer: Arc<Transfer>,
    first: u64,
    to: mpsc::Sender<Result<Passed, Status>>,
    _held: (OwnedSemaphorePermit, Option<Call>),
) {
    let mut changes = transfer.changes();
    let mut place = transfer.join(first);
    let mut rest = None;
    loop {
        let next = match (&mut rest, transfer.list()) {
            (None, Some(list)) => {
                rest = Some(list.cut().from(first).peekable());
                Ok(Some(Kind::List(list.to_bytes())))
            }
            (Some(rest), _) => match rest.peek().map(|&index| (index, transfer.piece(index))) {
                None => return,
                Some((index, Piece::Here(data))) => {
                    rest.next();
                    place.advance().await;
                    Ok(Some(Kind::Piece(wire::Piece { index, data })))
                }
                Some((_, Piece::NotYet)) => Ok(None),
                Some((_, Piece::Never(reason))) => Err(Status::aborted(reason)),
            },
            (None, None) if transfer.is_failed() => Err(Status::aborted("its list did not come")),
            (None, None) => Ok(None),
        };
        let failed = next.is_err();
        let message = match next {
            Ok(Some(kind)) => Ok(kind),
            // Nothing new: wait, and say so now and then.
            Ok(None) => match timeout(SIGN_OF_LIFE, changes.changed()).await {
                Ok(_) => continue,
                Err(_) => Ok(Kind::Waiting(Waiting {})),
            },
            Err(status) => Err(status),
        };
        let sent = timeout(READ_TIME, to.send(message.map(|kind| Passed { kind: Some(kind) }))).await;
        if !matches!(sent, Ok(Ok(()))) || failed {
            return;
        }
    }
}

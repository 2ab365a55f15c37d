//! What a worker passes on to others.

use super::Relay;
use super::pull::SILENCE;
use super::transfer::{Piece, Transfer};
use gatherlight_proto::limits::{CONNECTION_WINDOW_BYTES, STREAM_WINDOW_BYTES};
use gatherlight_proto::message::PassRequest;
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
use tonic::transport::Server;
use tonic::transport::server::TcpIncoming;
use tonic::{Request, Response, Status};

/// Streams that are served at once: two for each worker below this one, those that go around lost ones, and latecomers.
const MAX_STREAMS: usize = 256;
/// Time between two signs of life while there is nothing to pass on.
const SIGN_OF_LIFE: Duration = Duration::from_millis(500);
/// Messages that wait for a slow reader.
const QUEUE: usize = 2;

/// The service, over what `relay` holds.
struct Service {
    relay: Relay,
    streams: Arc<Semaphore>,
}

/// Serves on `listener` until it fails.
pub(super) async fn serve(relay: Relay, listener: TcpListener) {
    let service = RelayServer::new(Service { relay, streams: Arc::new(Semaphore::new(MAX_STREAMS)) });
    let check = |request: Request<()>| {
        version::check(request.metadata(), "worker", true)?;
        Ok::<_, Status>(request)
    };
    let server = Server::builder()
        .initial_stream_window_size(STREAM_WINDOW_BYTES)
        .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
        .max_concurrent_streams(MAX_STREAMS as u32)
        .tcp_nodelay(true)
        .add_service(InterceptedService::new(service, check));
    let incoming = TcpIncoming::from(listener).with_nodelay(Some(true));
    if let Err(error) = server.serve_with_incoming(incoming).await {
        tracing::warn!(%error, "relaying ended");
    }
}

#[tonic::async_trait]
impl relay_server::Relay for Service {
    type PassStream = ReceiverStream<Result<Passed, Status>>;

    async fn pass(&self, request: Request<wire::PassRequest>) -> Result<Response<Self::PassStream>, Status> {
        let request = PassRequest::try_from(request.into_inner())?;
        let busy = |_| Status::resource_exhausted(format!("{MAX_STREAMS} streams are served already"));
        let stream = self.streams.clone().try_acquire_owned().map_err(busy)?;
        // Whoever asks may have heard of it a moment before this worker does.
        let admitted = timeout(SILENCE / 2, self.relay.admitted(request.digest, request.ticket)).await;
        let transfer = admitted.ok().flatten().ok_or_else(|| Status::not_found("no such payload with this ticket"))?;
        let (sender, receiver) = mpsc::channel(QUEUE);
        tokio::spawn(send(transfer, request.first, sender, stream));
        Ok(Response::new(ReceiverStream::new(receiver)))
    }
}

/// Sends the list and the pieces of the stripe from `first` on, as they arrive here.
async fn send(
    transfer: Arc<Transfer>,
    first: u64,
    to: mpsc::Sender<Result<Passed, Status>>,
    _stream: OwnedSemaphorePermit,
) {
    let mut changes = transfer.changes();
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
        if to.send(message.map(|kind| Passed { kind: Some(kind) })).await.is_err() || failed {
            return;
        }
    }
}

//! The gRPC edge: decode, ask the driver, reply. No decisions here.

mod cluster;
mod jobs;
mod relay;

use crate::compute::Compute;
use crate::driver::Handle;
use crate::room::Rooms;
use crate::store::Store;
use gatherlight_proto::Digest;
use gatherlight_proto::chunk::chunk;
use gatherlight_proto::limits::{CONNECTION_WINDOW_BYTES, MAX_MESSAGE_BYTES, STREAM_WINDOW_BYTES};
use gatherlight_proto::version;
use gatherlight_proto::wire::Chunk;
use gatherlight_proto::wire::cluster_server::ClusterServer;
use gatherlight_proto::wire::jobs_server::JobsServer;
use gatherlight_proto::wire::relay_server::RelayServer;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;
use tokio_stream::{Stream, StreamExt};
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Server;
use tonic::transport::server::Router;
use tonic::{Request, Status};

/// Silence on a connection after which it is probed, and after which an unanswered probe ends it.
const KEEPALIVE: Duration = Duration::from_secs(10);
/// Streams one connection may have open: sessions, fetches and deliveries of one peer.
const MAX_STREAMS: u32 = 256;

/// A stream of replies.
type ReplyStream<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

/// What the services share.
#[derive(Clone, Debug)]
pub(crate) struct Context {
    pub(crate) driver: Handle,
    pub(crate) compute: Compute,
    pub(crate) store: Arc<Store>,
    pub(crate) rooms: Rooms,
}

type Check = fn(Request<()>) -> Result<Request<()>, Status>;

fn check_worker(request: Request<()>) -> Result<Request<()>, Status> {
    version::check(request.metadata(), "worker", true)?;
    Ok(request)
}

fn check_client(request: Request<()>) -> Result<Request<()>, Status> {
    version::check(request.metadata(), "client", false)?;
    Ok(request)
}

/// Both services and the standard health service, ready to be served.
pub(crate) async fn router(context: Context) -> Router {
    let cluster =
        ClusterServer::new(cluster::ClusterService::new(context.clone())).max_decoding_message_size(MAX_MESSAGE_BYTES);
    let relay = RelayServer::new(relay::RelayService::new(context.clone()));
    let jobs = JobsServer::new(jobs::JobsService::new(context)).max_decoding_message_size(MAX_MESSAGE_BYTES);
    let (reporter, health) = tonic_health::server::health_reporter();
    reporter.set_serving::<ClusterServer<cluster::ClusterService>>().await;
    reporter.set_serving::<JobsServer<jobs::JobsService>>().await;
    Server::builder()
        .initial_stream_window_size(STREAM_WINDOW_BYTES)
        .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
        .max_concurrent_streams(MAX_STREAMS)
        .http2_keepalive_interval(Some(KEEPALIVE))
        .http2_keepalive_timeout(Some(KEEPALIVE))
        .tcp_nodelay(true)
        .add_service(health)
        .add_service(InterceptedService::new(cluster, check_worker as Check))
        .add_service(InterceptedService::new(relay, check_worker as Check))
        .add_service(InterceptedService::new(jobs, check_client as Check))
}

/// A blob of the store as chunks, read as they are sent.
fn stored_chunks(store: Arc<Store>, digest: Digest) -> Result<ReplyStream<Chunk>, Status> {
    let total = store.len(digest).map_err(|e| Status::not_found(e.to_string()))?;
    let (sender, receiver) = tokio::sync::mpsc::channel(1);
    tokio::task::spawn_blocking(move || {
        let (mut index, mut offset) = (0, 0);
        loop {
            let piece = store.read_at(digest, offset).map_err(|e| Status::data_loss(e.to_string()));
            let length = piece.as_ref().map_or(0, |p| p.len() as u64);
            let done = length == 0 && offset < total;
            let item = match done {
                true => Err(piece.err().unwrap_or_else(|| Status::data_loss("a stored blob is cut off"))),
                false => piece.map(|data| chunk(index, digest, total, data)),
            };
            let failed = item.is_err();
            if sender.blocking_send(item).is_err() || failed {
                return;
            }
            (index, offset) = (index + 1, offset + length);
            if offset >= total {
                return;
            }
        }
    });
    Ok(Box::pin(tokio_stream::wrappers::ReceiverStream::new(receiver).map(|item| item)))
}

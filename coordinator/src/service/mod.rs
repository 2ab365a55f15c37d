//! The gRPC edge: decode, ask the driver, reply. No decisions here.

mod cluster;
mod gate;
mod jobs;
mod quota;
mod relay;

use crate::access::{Access, Role};
use crate::compute::Compute;
use crate::counters::Counters;
use crate::driver::Handle;
use crate::room::Rooms;
use crate::store::Store;
use bytes::Bytes;
use gate::Gate;
use gatherlight_proto::Digest;
use gatherlight_proto::chunk::chunk;
use gatherlight_proto::limits::{CONNECTION_WINDOW_BYTES, MAX_MESSAGE_BYTES, STREAM_WINDOW_BYTES};
use gatherlight_proto::serve::{self, ConnectionLimits, CountRefusals};
use gatherlight_proto::wire::Chunk;
use gatherlight_proto::wire::cluster_server::ClusterServer;
use gatherlight_proto::wire::jobs_server::JobsServer;
use gatherlight_proto::wire::relay_server::RelayServer;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;
use tokio_stream::Stream;
use tonic::Status;
use tonic::service::Routes;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Server;
use tonic::transport::server::Router;
use tower::Layer;
use tower::layer::layer_fn;

/// Time a connection has to prove who it is, at most 256 at once that have not, and 8,192 in all. Sessions and watches are silent for
/// hours, so nobody is closed for that. The system's limit of open files has to be above both.
pub(crate) const CONNECTIONS: ConnectionLimits =
    ConnectionLimits { introduction: Duration::from_secs(10), unknown: 256, all: 8_192, idle: None };
/// Streams one connection may have open: sessions, fetches and deliveries of one peer.
const MAX_STREAMS: u32 = 256;
/// Longest question to the health service, which anyone may ask.
const MAX_HEALTH_BYTES: usize = 1 << 10;

/// A stream of replies.
type ReplyStream<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

/// What the services share.
#[derive(Clone, Debug)]
pub(crate) struct Context {
    pub(crate) driver: Handle,
    pub(crate) compute: Compute,
    pub(crate) store: Arc<Store>,
    pub(crate) rooms: Rooms,
    pub(crate) access: Access,
    pub(crate) counters: Arc<Counters>,
}

/// All services, their refusals counted.
type Counting = CountRefusals<Routes>;

/// A server with this project's windows and limits.
pub(crate) fn server() -> Server {
    serve::server(MAX_STREAMS, STREAM_WINDOW_BYTES, CONNECTION_WINDOW_BYTES)
}

/// Both services and the standard health service, ready to be served.
pub(crate) async fn router(server: Server, context: Context) -> Router<impl Layer<Routes, Service = Counting> + Clone> {
    let (access, counters) = (context.access.clone(), context.counters.clone());
    let cluster =
        ClusterServer::new(cluster::ClusterService::new(context.clone())).max_decoding_message_size(MAX_MESSAGE_BYTES);
    let relay = RelayServer::new(relay::RelayService::new(context.clone()));
    let jobs = JobsServer::new(jobs::JobsService::new(context)).max_decoding_message_size(MAX_MESSAGE_BYTES);
    let (reporter, health) = tonic_health::server::health_reporter();
    reporter.set_serving::<ClusterServer<cluster::ClusterService>>().await;
    reporter.set_serving::<JobsServer<jobs::JobsService>>().await;
    let gate = |role| Gate { access: access.clone(), role };
    server
        .layer(layer_fn(move |inner| CountRefusals::new(inner, counters.clone())))
        // Anyone may ask for it, so that it takes little.
        .add_service(health.max_decoding_message_size(MAX_HEALTH_BYTES))
        .add_service(InterceptedService::new(cluster, gate(Role::Worker)))
        .add_service(InterceptedService::new(relay, gate(Role::Worker)))
        .add_service(InterceptedService::new(jobs, gate(Role::Client)))
}

/// A blob of the store as chunks, read as they are sent.
fn stored_chunks(store: Arc<Store>, digest: Digest) -> Result<ReplyStream<Chunk>, Status> {
    let total = store.len(digest).map_err(|e| Status::not_found(e.to_string()))?;
    let (sender, receiver) = tokio::sync::mpsc::channel(1);
    tokio::spawn(async move {
        let (mut index, mut offset) = (0, 0);
        loop {
            let item = stored_piece(store.clone(), digest, offset, total).await;
            let length = item.as_ref().map_or(0, |data| data.len() as u64);
            let failed = item.is_err();
            let item = item.map(|data| chunk(index, digest, total, data));
            if sender.send(item).await.is_err() || failed {
                return;
            }
            (index, offset) = (index + 1, offset + length);
            if offset >= total {
                return;
            }
        }
    });
    Ok(Box::pin(tokio_stream::wrappers::ReceiverStream::new(receiver)))
}

/// The piece of a blob at `offset`. It holds a thread while the disk works, and none while its reader is slow.
async fn stored_piece(store: Arc<Store>, digest: Digest, offset: u64, total: u64) -> Result<Bytes, Status> {
    let read = tokio::task::spawn_blocking(move || store.read_at(digest, offset)).await;
    let data = read.map_err(|e| Status::internal(e.to_string()))?.map_err(|e| Status::data_loss(e.to_string()))?;
    if data.is_empty() && offset < total {
        return Err(Status::data_loss("a stored blob is cut off"));
    }
    Ok(data)
}

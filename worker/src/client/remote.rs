//! The coordinator's calls, as a worker makes them.

use crate::counters::Counters;
use crate::error::TaskError;
use crate::relay::{self, Relay};
use bytes::Bytes;
use gatherlight_proto::chunk::chunks;
use gatherlight_proto::connect::Stamp;
use gatherlight_proto::limits::MAX_MESSAGE_BYTES;
use gatherlight_proto::message::{BlobRef, DeliverHeader, FromWorker, Route, SessionKey};
use gatherlight_proto::wire::cluster_client::ClusterClient;
use gatherlight_proto::wire::deliver_request::Kind;
use gatherlight_proto::wire::{CoordinatorMessage, DeliverReply, DeliverRequest, LocateRequest, deliver_reply};
use gatherlight_proto::{Digest, WireError};
use std::sync::Arc;
use tokio::sync::mpsc;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;
use tonic::{Status, Streaming};

/// One session's connection; clones share it.
#[derive(Clone)]
pub struct Remote {
    client: ClusterClient<InterceptedService<Channel, Stamp>>,
    /// The coordinator as a source of payloads.
    source: relay::Client,
    relay: Relay,
    session: SessionKey,
    counters: Arc<Counters>,
}

impl Remote {
    /// Over `channel`, not joined yet; payloads are fetched by way of `relay`.
    pub(super) fn new(channel: Channel, stamp: Stamp, relay: Relay, counters: Arc<Counters>) -> Self {
        let source = relay::client(channel.clone(), stamp.clone());
        let client = ClusterClient::with_interceptor(channel, stamp);
        let client = client.max_decoding_message_size(MAX_MESSAGE_BYTES);
        Remote { client, source, relay, session: SessionKey([0; 16]), counters }
    }
    /// The same connection, with the session's secret name.
    pub(super) fn in_session(&self, session: SessionKey) -> Self {
        Remote { session, ..self.clone() }
    }
    /// Opens the session; `messages` has the hello in it already.
    pub(super) async fn join(
        &mut self,
        messages: mpsc::Receiver<FromWorker>,
    ) -> Result<Streaming<CoordinatorMessage>, Status> {
        let outbound = ReceiverStream::new(messages).map(Into::into);
        Ok(self.client.join(outbound).await?.into_inner())
    }
    /// Fetches a scene file or map, checked, and says whether it came for this; `limit_bytes` is called `limit_name`.
    ///
    /// # Errors
    /// When it does not come, or is not what its digest says.
    pub async fn fetch(
        &self,
        what: &str,
        blob: BlobRef,
        limit_bytes: u64,
        limit_name: &'static str,
    ) -> Result<(Bytes, bool), TaskError> {
        WireError::check_limit("fetched size in bytes", blob.bytes, limit_bytes, limit_name)?;
        let locate = async || {
            let request = LocateRequest { session: self.session.into(), digest: blob.digest.to_bytes() };
            let failed = |status: Status| TaskError::Fetch { what: what.into(), reason: status.message().into() };
            let route = self.client.clone().locate(request).await.map_err(failed)?;
            Ok(Route::try_from(route.into_inner())?)
        };
        let (bytes, is_new) = self.relay.fetch(what, blob, self.source.clone(), locate()).await?;
        if is_new {
            self.counters.fetched_bytes.add(bytes.len() as u64);
        }
        Ok((bytes, is_new))
    }
    /// The bytes of this payload are not needed here any more.
    pub(crate) fn forget(&self, digest: Digest) {
        self.relay.forget(digest);
    }
    /// Takes in the way to a payload that will be read soon.
    pub(super) fn announce(&self, route: Route) {
        self.relay.announce(route, self.source.clone());
    }
    /// Hands in a result; returns whether it counts. A test may want a header that is not the payload's.
    ///
    /// # Errors
    /// When it cannot be sent or is refused.
    pub async fn deliver(&self, header: DeliverHeader, payload: Bytes) -> Result<bool, TaskError> {
        let header = DeliverHeader { session: self.session, ..header };
        let failed = |s: Status| TaskError::Deliver(s.message().into());
        let (requests, outbound) = mpsc::channel(1);
        let send = async |kind| requests.send(DeliverRequest { kind: Some(kind) }).await.is_ok();
        send(Kind::Header(header.into())).await;
        let mut replies =
            self.client.clone().deliver(ReceiverStream::new(outbound)).await.map_err(failed)?.into_inner();
        if let Some(accepted) = receipt(replies.message().await.map_err(failed)?)? {
            return Ok(accepted);
        }
        for chunk in chunks(payload, header.digest) {
            // Whoever does not listen any more has said why.
            if !send(Kind::Chunk(chunk)).await {
                break;
            }
        }
        drop(requests);
        let accepted = receipt(replies.message().await.map_err(failed)?)?;
        accepted.ok_or_else(|| TaskError::Deliver("the coordinator asked for the result twice".into()))
    }
}

/// What the coordinator says of a delivery: whether it counts, or `None`: there is room for it now.
fn receipt(reply: Option<DeliverReply>) -> Result<Option<bool>, TaskError> {
    match reply.and_then(|r| r.kind) {
        Some(deliver_reply::Kind::Receipt(receipt)) => Ok(Some(receipt.accepted)),
        Some(deliver_reply::Kind::Proceed(_)) => Ok(None),
        None => Err(TaskError::Deliver("the coordinator did not answer".into())),
    }
}

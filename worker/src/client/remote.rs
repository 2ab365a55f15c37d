//! The coordinator's calls, as a worker makes them.

use crate::error::TaskError;
use bytes::Bytes;
use gatherlight_proto::chunk::{Assembler, chunks};
use gatherlight_proto::connect::Stamp;
use gatherlight_proto::limits::MAX_MESSAGE_BYTES;
use gatherlight_proto::message::{BlobRef, DeliverHeader, FromWorker};
use gatherlight_proto::version::Versions;
use gatherlight_proto::wire::cluster_client::ClusterClient;
use gatherlight_proto::wire::deliver_request::Kind;
use gatherlight_proto::wire::{CoordinatorMessage, DeliverRequest, FetchRequest};
use gatherlight_proto::{Digest, WireError};
use tokio::sync::mpsc;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;
use tonic::{Status, Streaming};

/// One session's connection; clones share it.
#[derive(Clone, Debug)]
pub struct Remote {
    client: ClusterClient<InterceptedService<Channel, Stamp>>,
    session: u64,
}

impl Remote {
    /// Over `channel`, not joined yet.
    pub(super) fn new(channel: Channel, versions: Versions) -> Self {
        let client = ClusterClient::with_interceptor(channel, Stamp(versions));
        Remote { client: client.max_decoding_message_size(MAX_MESSAGE_BYTES), session: 0 }
    }
    /// The same connection, with the session's secret name.
    pub(super) fn in_session(&self, session: u64) -> Self {
        Remote { client: self.client.clone(), session }
    }
    /// Opens the session; `messages` has the hello in it already.
    pub(super) async fn join(
        &mut self,
        messages: mpsc::Receiver<FromWorker>,
    ) -> Result<Streaming<CoordinatorMessage>, Status> {
        let outbound = ReceiverStream::new(messages).map(Into::into);
        Ok(self.client.join(outbound).await?.into_inner())
    }
    /// Fetches a scene file or map, checked; `limit_bytes` is called `limit_name`.
    ///
    /// # Errors
    /// When it does not come, or is not what its digest says.
    pub async fn fetch(
        &self,
        what: &str,
        blob: BlobRef,
        limit_bytes: u64,
        limit_name: &'static str,
    ) -> Result<Bytes, TaskError> {
        let failed = |status: Status| TaskError::Fetch { what: what.into(), reason: status.message().into() };
        let request = FetchRequest { session: self.session, digest: blob.digest.to_bytes() };
        let mut stream = self.client.clone().fetch(request).await.map_err(failed)?.into_inner();
        let mut assembler = Assembler::new("fetched size in bytes", limit_bytes.min(blob.bytes), limit_name);
        while let Some(chunk) = stream.message().await.map_err(failed)? {
            assembler.push(&chunk)?;
        }
        let (bytes, digest) = assembler.finish()?;
        if digest != blob.digest {
            let (expected, actual) = (blob.digest.to_string(), digest.to_string());
            return Err(WireError::Digest { expected, actual }.into());
        }
        Ok(bytes)
    }
    /// Hands in a result; returns whether it counts. `digest` is the payload's, unless a test wants another.
    ///
    /// # Errors
    /// When it cannot be sent or is refused.
    pub async fn deliver(&self, header: DeliverHeader, payload: Bytes, digest: Digest) -> Result<bool, TaskError> {
        let header = DeliverHeader { session: self.session, ..header };
        let first = DeliverRequest { kind: Some(Kind::Header(header.into())) };
        let rest = chunks(payload, digest).map(|c| DeliverRequest { kind: Some(Kind::Chunk(c)) });
        let stream = tokio_stream::iter(std::iter::once(first).chain(rest));
        let reply = self.client.clone().deliver(stream).await;
        reply.map(|r| r.into_inner().accepted).map_err(|s| TaskError::Deliver(s.message().into()))
    }
}

//! The coordinator as a source of the broadcast: the first one of each payload, and the last resort of every worker.

use super::{Context, ReplyStream};
use crate::driver::Source;
use crate::store::Store;
use bytes::Bytes;
use gatherlight_proto::message::PassRequest;
use gatherlight_proto::pieces::{PieceList, Pieces};
use gatherlight_proto::serve::{Abreast, Place};
use gatherlight_proto::wire::passed::Kind;
use gatherlight_proto::wire::relay_server::Relay;
use gatherlight_proto::wire::{self, Passed};
use gatherlight_proto::{Digest, WireError};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::{OnceCell, mpsc};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};

/// Lists of stored blobs that are kept; each is small beside its blob, which had to be read to make it.
const MAX_LISTS: usize = 4_096;
/// Messages that wait for a slow reader.
const QUEUE: usize = 1;

pub(super) struct RelayService {
    context: Context,
    lists: Lists,
    /// Streams that leave here, by payload.
    streams: Mutex<BTreeMap<Digest, Abreast>>,
}

impl RelayService {
    pub(super) fn new(context: Context) -> Self {
        RelayService { context, lists: Lists::default(), streams: Mutex::default() }
    }
    /// The place of a stream from piece `first` on among those of its payload.
    fn join(&self, digest: Digest, first: u64) -> Place {
        let mut streams = self.streams.lock().unwrap_or_else(PoisonError::into_inner);
        streams.retain(|_, of| !of.is_idle());
        streams.entry(digest).or_default().join(first)
    }
}

#[tonic::async_trait]
impl Relay for RelayService {
    type PassStream = ReplyStream<Passed>;

    async fn pass(&self, request: Request<wire::PassRequest>) -> Result<Response<Self::PassStream>, Status> {
        let PassRequest { digest, ticket, first, .. } = PassRequest::try_from(request.into_inner())?;
        let source = self.context.driver.pass(digest, ticket).await;
        let payload = match source {
            None => return Err(Status::not_found("no such payload, or not with this ticket")),
            Some(Source::Memory { pieces, sent }) => Payload::Memory(pieces, sent),
            Some(Source::Blob(digest)) => {
                let list = self.lists.get(&self.context.store, digest).await?;
                Payload::Stored(self.context.store.clone(), digest, list)
            }
        };
        let (sender, receiver) = mpsc::channel(QUEUE);
        tokio::spawn(payload.send(first, self.join(digest, first), sender));
        Ok(Response::new(Box::pin(ReceiverStream::new(receiver))))
    }
}

fn passed(kind: Kind) -> Passed {
    Passed { kind: Some(kind) }
}

fn piece(index: u64, data: Bytes) -> Passed {
    passed(Kind::Piece(wire::Piece { index, data }))
}

/// What is handed out.
enum Payload {
    /// In memory; the counter is told the bytes of each piece as it goes out.
    Memory(Pieces, Arc<AtomicU64>),
    /// A blob of the store, read as it is sent.
    Stored(Arc<Store>, Digest, Arc<PieceList>),
}

impl Payload {
    fn list(&self) -> &PieceList {
        match self {
            Payload::Memory(pieces, _) => pieces.list(),
            Payload::Stored(_, _, list) => list,
        }
    }
    async fn piece(&self, index: u64) -> Result<Bytes, Status> {
        let (store, digest, range) = match self {
            Payload::Memory(pieces, _) => return Ok(pieces.piece(index)),
            Payload::Stored(store, digest, list) => (store.clone(), *digest, list.cut().range(index)),
        };
        let read = move || store.read_range(digest, range.start, (range.end - range.start) as usize);
        let read = tokio::task::spawn_blocking(read).await.map_err(|e| Status::internal(e.to_string()))?;
        read.map_err(|e| Status::data_loss(e.to_string()))
    }
    /// Sends the list and the pieces of a stripe from `first` on, abreast with the other streams of the payload.
    async fn send(self, first: u64, mut place: Place, to: mpsc::Sender<Result<Passed, Status>>) {
        if to.send(Ok(passed(Kind::List(self.list().to_bytes())))).await.is_err() {
            return;
        }
        for index in self.list().cut().from(first) {
            place.advance().await;
            let data = self.piece(index).await;
            let bytes = data.as_ref().ok().map(|d| d.len() as u64);
            let is_sent = to.send(data.map(|d| piece(index, d))).await.is_ok();
            let Some(bytes) = bytes.filter(|_| is_sent) else { return };
            if let Payload::Memory(_, sent) = &self {
                sent.fetch_add(bytes, Ordering::Relaxed);
            }
        }
    }
}

/// Lists of stored blobs, each made once, when the blob is first asked for.
#[derive(Default)]
struct Lists(Mutex<BTreeMap<Digest, Arc<OnceCell<Arc<PieceList>>>>>);

impl Lists {
    async fn get(&self, store: &Arc<Store>, digest: Digest) -> Result<Arc<PieceList>, Status> {
        let cell = {
            let mut lists = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            if lists.len() >= MAX_LISTS && !lists.contains_key(&digest) {
                lists.clear();
            }
            lists.entry(digest).or_default().clone()
        };
        let store = store.clone();
        let make = async || {
            let made = tokio::task::spawn_blocking(move || make(&store, digest)).await;
            made.map_err(|e| Status::internal(e.to_string()))?
        };
        cell.get_or_try_init(make).await.cloned()
    }
}

fn make(store: &Store, digest: Digest) -> Result<Arc<PieceList>, Status> {
    let bytes = store.len(digest).map_err(|e| Status::not_found(e.to_string()))?;
    let read = |range: std::ops::Range<u64>| store.read_range(digest, range.start, (range.end - range.start) as usize);
    let list = PieceList::read(bytes, read).map_err(|e| Status::data_loss(e.to_string()))?;
    let actual = list.digest();
    if actual != digest {
        let damaged = WireError::Digest { expected: digest.to_string(), actual: actual.to_string() };
        return Err(Status::data_loss(format!("a stored blob: {damaged}")));
    }
    Ok(Arc::new(list))
}

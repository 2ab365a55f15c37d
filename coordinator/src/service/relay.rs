//! The coordinator as a source of the broadcast: the first one of each payload, and the last resort of every worker.

use super::{Context, ReplyStream};
use crate::driver::Source;
use crate::store::Store;
use bytes::Bytes;
use gatherlight_proto::message::PassRequest;
use gatherlight_proto::pieces::{Cut, PieceList, Pieces, STRIPES};
use gatherlight_proto::serve::{Abreast, Place};
use gatherlight_proto::wire::passed::Kind;
use gatherlight_proto::wire::relay_server::Relay;
use gatherlight_proto::wire::{self, Passed};
use gatherlight_proto::{Digest, WireError};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::OnceCell;
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
        streams.entry(digest).or_default().join(first / STRIPES as u64)
    }
}

#[tonic::async_trait]
impl Relay for RelayService {
    type PassStream = ReplyStream<Passed>;

    async fn pass(&self, request: Request<wire::PassRequest>) -> Result<Response<Self::PassStream>, Status> {
        let PassRequest { digest, ticket, first, .. } = PassRequest::try_from(request.into_inner())?;
        let source = self.context.driver.pass(digest, ticket).await;
        Ok(Response::new(match source {
            None => return Err(Status::not_found("no such payload, or not with this ticket")),
            Some(Source::Memory { pieces, sent }) => in_memory(pieces, first, sent, self.join(digest, first)),
            Some(Source::Blob(digest)) => {
                let list = self.lists.get(&self.context.store, digest).await?;
                stored(self.context.store.clone(), list, first, self.join(digest, first))
            }
        }))
    }
}

fn passed(kind: Kind) -> Passed {
    Passed { kind: Some(kind) }
}

fn piece(index: u64, data: Bytes) -> Passed {
    passed(Kind::Piece(wire::Piece { index, data }))
}

/// A payload in memory; `sent` is told the bytes of each piece as it goes out.
fn in_memory(pieces: Pieces, first: u64, sent: Arc<AtomicU64>, mut place: Place) -> ReplyStream<Passed> {
    let (sender, receiver) = tokio::sync::mpsc::channel(QUEUE);
    tokio::spawn(async move {
        if sender.send(Ok(passed(Kind::List(pieces.list().to_bytes())))).await.is_err() {
            return;
        }
        for index in pieces.list().cut().from(first) {
            place.advance().await;
            let data = pieces.piece(index);
            let bytes = data.len() as u64;
            if sender.send(Ok(piece(index, data))).await.is_err() {
                return;
            }
            sent.fetch_add(bytes, Ordering::Relaxed);
        }
    });
    Box::pin(ReceiverStream::new(receiver))
}

/// A blob of the store, read as it is sent.
fn stored(store: Arc<Store>, list: Arc<PieceList>, first: u64, mut place: Place) -> ReplyStream<Passed> {
    let (sender, receiver) = tokio::sync::mpsc::channel(QUEUE);
    let runtime = tokio::runtime::Handle::current();
    tokio::task::spawn_blocking(move || {
        if sender.blocking_send(Ok(passed(Kind::List(list.to_bytes())))).is_err() {
            return;
        }
        let digest = list.digest();
        for index in list.cut().from(first) {
            runtime.block_on(place.advance());
            let data = read(&store, digest, list.cut(), index).map_err(|e| Status::data_loss(e.to_string()));
            let failed = data.is_err();
            if sender.blocking_send(data.map(|d| piece(index, d))).is_err() || failed {
                return;
            }
        }
    });
    Box::pin(ReceiverStream::new(receiver))
}

fn read(store: &Store, digest: Digest, cut: Cut, index: u64) -> std::io::Result<Bytes> {
    let range = cut.range(index);
    store.read_range(digest, range.start, (range.end - range.start) as usize)
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

//! One payload on its way in: pieces are checked as they arrive and may be read by whoever waits for them.

use bytes::Bytes;
use gatherlight_proto::WireError;
use gatherlight_proto::message::BlobRef;
use gatherlight_proto::pieces::{Cut, PieceList, STRIPES};
use gatherlight_proto::serve::{Abreast, Place};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;

/// Where a transfer stands.
enum State {
    /// Pieces of each stripe that are there, from its first one on.
    Arriving { buffer: Vec<u8>, there: [u64; STRIPES] },
    /// All of it.
    Complete(Bytes),
    /// It will not come; the text says why.
    Failed(String),
}

/// A piece of a transfer.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Piece {
    /// Its bytes.
    Here(Bytes),
    /// It has not arrived.
    NotYet,
    /// It will not arrive; the text says why.
    Never(String),
}

/// See the module.
pub(super) struct Transfer {
    blob: BlobRef,
    list: Mutex<Option<Arc<PieceList>>>,
    state: Mutex<State>,
    /// Told whenever something changes.
    changes: watch::Sender<()>,
    /// Those who are sent it from here.
    streams: Abreast,
    /// Somebody here has used it.
    is_used: AtomicBool,
}

impl Transfer {
    /// Of `blob`, nothing of which is there.
    pub(super) fn new(blob: BlobRef) -> Self {
        // Zeroed memory is given by the system as it is written to, so a large claim costs nothing by itself.
        let buffer = vec![0; usize::try_from(blob.bytes).unwrap_or(usize::MAX)];
        let state = Mutex::new(State::Arriving { buffer, there: [0; STRIPES] });
        Transfer {
            blob,
            list: Mutex::default(),
            state,
            changes: watch::Sender::default(),
            streams: Abreast::default(),
            is_used: AtomicBool::new(false),
        }
    }
    /// The payload.
    pub(super) fn blob(&self) -> BlobRef {
        self.blob
    }
    /// Notes that it is used here; whether that is for the first time since it came.
    pub(super) fn begin_use(&self) -> bool {
        !self.is_used.swap(true, Ordering::Relaxed)
    }
    /// The place of a stream from piece `first` on among those that leave here.
    pub(super) fn join(&self, first: u64) -> Place {
        self.streams.join(first)
    }
    fn cut(&self) -> Cut {
        Cut { bytes: self.blob.bytes }
    }
    /// Ready, again and again, when something has changed.
    pub(super) fn changes(&self) -> watch::Receiver<()> {
        self.changes.subscribe()
    }
    /// The list of its pieces, once it is there.
    pub(super) fn list(&self) -> Option<Arc<PieceList>> {
        lock(&self.list).clone()
    }
    /// Takes the list of its pieces.
    ///
    /// # Errors
    /// When it is another payload's.
    pub(super) fn put_list(&self, list: &[u8]) -> Result<(), WireError> {
        if self.list().is_none() {
            let list = PieceList::checked(list, self.blob.digest, self.blob.bytes)?;
            *lock(&self.list) = Some(Arc::new(list));
            self.changes.send_replace(());
        }
        Ok(())
    }
    /// The piece of `stripe` that is due; `None` when all of them are there.
    pub(super) fn due(&self, stripe: usize) -> Option<u64> {
        match &*lock(&self.state) {
            State::Arriving { there, .. } if there[stripe] < self.cut().count_in(stripe) => {
                Some(stripe as u64 + there[stripe] * STRIPES as u64)
            }
            _ => None,
        }
    }
    /// Takes the piece of `stripe` that is due.
    ///
    /// # Errors
    /// When it is not that piece, or the list is not there to check it.
    pub(super) fn put(&self, stripe: usize, index: u64, data: &[u8]) -> Result<(), WireError> {
        let Some(due) = self.due(stripe).filter(|&due| due == index) else {
            return Err(WireError::Order { expected: self.due(stripe).unwrap_or(u64::MAX), actual: index });
        };
        self.list().ok_or(WireError::Missing("the list of pieces"))?.check(due, data)?;
        let range = self.cut().range(due);
        if let State::Arriving { buffer, there } = &mut *lock(&self.state) {
            buffer[range.start as usize..range.end as usize].copy_from_slice(data);
            there[stripe] += 1;
        }
        self.finish();
        self.changes.send_replace(());
        Ok(())
    }
    /// Makes the payload of the pieces, if all of them are there.
    fn finish(&self) {
        let mut state = lock(&self.state);
        if let State::Arriving { buffer, there } = &mut *state
            && (0..STRIPES).all(|s| there[s] == self.cut().count_in(s))
        {
            *state = State::Complete(std::mem::take(buffer).into());
        }
    }
    /// Gives up, unless it is complete.
    pub(super) fn fail(&self, reason: String) {
        let mut state = lock(&self.state);
        if matches!(*state, State::Arriving { .. }) {
            *state = State::Failed(reason);
        }
        drop(state);
        self.changes.send_replace(());
    }
    /// Piece `index`.
    pub(super) fn piece(&self, index: u64) -> Piece {
        let range = self.cut().range(index);
        let range = range.start as usize..range.end as usize;
        match &*lock(&self.state) {
            State::Complete(bytes) => Piece::Here(bytes.slice(range)),
            State::Failed(reason) => Piece::Never(reason.clone()),
            State::Arriving { buffer, there }
                if index / (STRIPES as u64) < there[(index % STRIPES as u64) as usize] =>
            {
                Piece::Here(Bytes::copy_from_slice(&buffer[range]))
            }
            State::Arriving { .. } => Piece::NotYet,
        }
    }
    /// Whether it has failed.
    pub(super) fn is_failed(&self) -> bool {
        matches!(*lock(&self.state), State::Failed(_))
    }
    /// Whether all of it is there.
    pub(super) fn is_complete(&self) -> bool {
        matches!(*lock(&self.state), State::Complete(_))
    }
    /// Waits for all of it.
    ///
    /// # Errors
    /// Why it will not come.
    pub(super) async fn whole(&self) -> Result<Bytes, String> {
        let mut changes = self.changes();
        loop {
            match &*lock(&self.state) {
                State::Complete(bytes) => return Ok(bytes.clone()),
                State::Failed(reason) => return Err(reason.clone()),
                State::Arriving { .. } => {}
            }
            // The sender is our own.
            drop(changes.changed().await);
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gatherlight_proto::limits::MIN_PIECE_BYTES;
    use gatherlight_proto::pieces::Pieces;

    fn payload(pieces: u64) -> Pieces {
        Pieces::of((0..pieces * MIN_PIECE_BYTES + 5).map(|i| (i * 7 % 253) as u8).collect::<Vec<_>>().into())
    }

    fn transfer(of: &Pieces) -> Transfer {
        Transfer::new(BlobRef { digest: of.list().digest(), bytes: of.bytes().len() as u64 })
    }

    #[tokio::test]
    async fn pieces_of_both_stripes_make_the_payload_and_are_read_as_they_arrive() {
        let source = payload(4);
        let t = transfer(&source);
        t.put_list(&source.list().to_bytes()).unwrap();
        assert_eq!((t.due(0), t.due(1), t.piece(0)), (Some(0), Some(1), Piece::NotYet));
        for index in [0, 2, 4, 1, 3] {
            assert!(!t.is_complete());
            t.put(index as usize % 2, index, &source.piece(index)).unwrap();
            assert_eq!(t.piece(index), Piece::Here(source.piece(index)));
        }
        assert_eq!((t.due(0), t.due(1)), (None, None));
        assert_eq!(t.whole().await.as_ref(), Ok(source.bytes()));
        assert_eq!(t.piece(3), Piece::Here(source.piece(3)));
    }

    #[test]
    fn wrong_pieces_and_lists_are_refused_and_the_right_ones_are_still_taken() {
        let source = payload(3);
        let t = transfer(&source);
        let mut damaged = source.piece(0).to_vec();
        damaged[9] ^= 1;
        assert_eq!(t.put(0, 0, &source.piece(0)), Err(WireError::Missing("the list of pieces")));
        assert!(t.put_list(&payload(4).list().to_bytes()).is_err());
        t.put_list(&source.list().to_bytes()).unwrap();
        assert!(matches!(t.put(0, 0, &damaged), Err(WireError::Digest { .. })));
        assert_eq!(t.put(0, 2, &source.piece(2)), Err(WireError::Order { expected: 0, actual: 2 }));
        assert_eq!(t.piece(0), Piece::NotYet);
        t.put(0, 0, &source.piece(0)).unwrap();
        assert_eq!(t.put(0, 0, &source.piece(0)), Err(WireError::Order { expected: 2, actual: 0 }));
    }

    #[tokio::test]
    async fn failure_is_told_to_all_who_wait() {
        let t = Arc::new(transfer(&payload(2)));
        let own = t.clone();
        let waiting = tokio::spawn(async move { own.whole().await });
        tokio::task::yield_now().await;
        t.fail("gone".into());
        assert_eq!(waiting.await.unwrap(), Err("gone".into()));
        assert_eq!((t.piece(1), t.is_failed()), (Piece::Never("gone".into()), true));
    }

    #[tokio::test]
    async fn an_empty_payload_is_one_empty_piece() {
        let source = Pieces::of(Bytes::new());
        let t = transfer(&source);
        t.put_list(&source.list().to_bytes()).unwrap();
        t.put(0, 0, &[]).unwrap();
        assert_eq!(t.whole().await, Ok(Bytes::new()));
    }
}

//! Payloads in pieces that are checked one by one, in any order, before they are used or passed on.
//!
//! BLAKE3 is a Merkle tree (O'Connor, Aumasson, Neves and Wilcox-O'Hearn 2020, §2.1): a piece of a power of two of bytes is a
//! subtree of it, and the digest of a payload is computed from the chaining values of its pieces. So whoever knows a
//! payload's digest and length can check the list of chaining values against them, and each piece against the list.
//!
//! The pieces are dealt to two stripes, even and odd ones, which come by different ways.

use crate::digest::Digest;
use crate::error::WireError;
use crate::limits::{MAX_PIECES, MIN_PIECE_BYTES};
use blake3::hazmat::{ChainingValue, HasherExt, Mode, merge_subtrees_non_root, merge_subtrees_root};
use bytes::Bytes;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// Parts of a payload that travel by different ways: piece i is in stripe i mod 2.
pub const STRIPES: usize = 2;

/// Bytes of a chaining value.
const VALUE_BYTES: usize = 32;

/// How a payload is cut: a function of its length alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cut {
    /// Length of the payload in bytes.
    pub bytes: u64,
}

impl Cut {
    /// Length of every piece but the last: a power of two, at least [`MIN_PIECE_BYTES`], such that there are at most
    /// [`MAX_PIECES`].
    pub fn piece_bytes(self) -> u64 {
        self.bytes.div_ceil(MAX_PIECES).next_power_of_two().max(MIN_PIECE_BYTES)
    }
    /// Number of pieces, ≥ 1: an empty payload is one empty piece.
    pub fn count(self) -> u64 {
        self.bytes.div_ceil(self.piece_bytes()).max(1)
    }
    /// The bytes of piece `index`; empty beyond the last.
    pub fn range(self, index: u64) -> Range<u64> {
        let at = |i: u64| i.saturating_mul(self.piece_bytes()).min(self.bytes);
        at(index)..at(index.saturating_add(1))
    }
    /// Pieces of `stripe`.
    pub fn count_in(self, stripe: usize) -> u64 {
        (self.count() + (STRIPES - 1 - stripe) as u64) / STRIPES as u64
    }
    /// The pieces of `stripe` from `first` on, which is one of them.
    pub fn from(self, first: u64) -> impl Iterator<Item = u64> + Send {
        (first..self.count()).step_by(STRIPES)
    }
    /// What piece `index`, being `data`, adds to the tree.
    fn value(self, index: u64, data: &[u8]) -> ChainingValue {
        if self.count() == 1 {
            return Digest::of(data).0;
        }
        // No piece of several is empty: the reader ended early, and the digest will not be right.
        if data.is_empty() {
            return ChainingValue::default();
        }
        blake3::Hasher::new().set_input_offset(self.range(index).start).update(data).finalize_non_root()
    }
}

/// The chaining values of a payload's pieces.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PieceList {
    cut: Cut,
    values: Vec<ChainingValue>,
}

impl PieceList {
    /// Of a payload in memory; hashes in parallel on the current rayon pool.
    pub fn of(payload: &[u8]) -> Self {
        let cut = Cut { bytes: payload.len() as u64 };
        let piece = |i: u64| cut.value(i, &payload[cut.range(i).start as usize..cut.range(i).end as usize]);
        PieceList { cut, values: (0..cut.count()).into_par_iter().map(piece).collect() }
    }
    /// Of a payload of `bytes` that is read piece by piece.
    ///
    /// # Errors
    /// The reader's.
    pub fn read<E>(bytes: u64, mut read: impl FnMut(Range<u64>) -> Result<Bytes, E>) -> Result<Self, E> {
        let cut = Cut { bytes };
        let values = (0..cut.count()).map(|i| read(cut.range(i)).map(|data| cut.value(i, &data)));
        Ok(PieceList { cut, values: values.collect::<Result<_, _>>()? })
    }
    /// Checks a list that came from a peer against the payload's `digest` and length.
    ///
    /// # Errors
    /// When it is not the list of that payload.
    pub fn checked(list: &[u8], digest: Digest, bytes: u64) -> Result<Self, WireError> {
        let cut = Cut { bytes };
        let expected = cut.count() * VALUE_BYTES as u64;
        if list.len() as u64 != expected {
            return Err(WireError::Length { expected, actual: list.len() as u64 });
        }
        let values = list.as_chunks().0.to_vec();
        let list = PieceList { cut, values };
        let actual = list.digest();
        if actual != digest {
            return Err(WireError::Digest { expected: digest.to_string(), actual: actual.to_string() });
        }
        Ok(list)
    }
    /// The payload's digest, by BLAKE3.
    pub fn digest(&self) -> Digest {
        let (left, right) = match &self.values[..] {
            [only] => return Digest(*only),
            values => values.split_at(left_count(values.len())),
        };
        Digest(*merge_subtrees_root(&subtree(left), &subtree(right), Mode::Hash).as_bytes())
    }
    /// How the payload is cut.
    pub fn cut(&self) -> Cut {
        self.cut
    }
    /// For the wire.
    pub fn to_bytes(&self) -> Bytes {
        Bytes::from(self.values.concat())
    }
    /// Checks piece `index`.
    ///
    /// # Errors
    /// When `data` is not that piece.
    pub fn check(&self, index: u64, data: &[u8]) -> Result<(), WireError> {
        let (range, actual) = (self.cut.range(index), data.len() as u64);
        let Some(value) = usize::try_from(index).ok().and_then(|i| self.values.get(i)) else {
            return Err(WireError::Order { expected: self.cut.count(), actual: index });
        };
        if actual != range.end - range.start {
            return Err(WireError::Length { expected: range.end - range.start, actual });
        }
        let actual = self.cut.value(index, data);
        if actual != *value {
            return Err(WireError::Digest { expected: Digest(*value).to_string(), actual: Digest(actual).to_string() });
        }
        Ok(())
    }
}

/// Pieces of the left subtree of `count` ≥ 2: the largest power of two below it (BLAKE3, §2.1).
fn left_count(count: usize) -> usize {
    count.next_power_of_two() / 2
}

fn subtree(values: &[ChainingValue]) -> ChainingValue {
    match values {
        [only] => *only,
        _ => {
            let (left, right) = values.split_at(left_count(values.len()));
            merge_subtrees_non_root(&subtree(left), &subtree(right), Mode::Hash)
        }
    }
}

/// A payload in memory, with the list of its pieces; clones share both.
#[derive(Clone, Debug)]
pub struct Pieces {
    bytes: Bytes,
    list: Arc<PieceList>,
}

impl Pieces {
    /// Of `payload`; hashes it in parallel on the current rayon pool.
    pub fn of(payload: Bytes) -> Self {
        let list = Arc::new(PieceList::of(&payload));
        Pieces { bytes: payload, list }
    }
    /// The whole payload.
    pub fn bytes(&self) -> &Bytes {
        &self.bytes
    }
    /// The list of its pieces.
    pub fn list(&self) -> &PieceList {
        &self.list
    }
    /// Piece `index`, sharing memory; empty beyond the last.
    pub fn piece(&self, index: u64) -> Bytes {
        let range = self.list.cut.range(index);
        self.bytes.slice(range.start as usize..range.end as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIECE: usize = MIN_PIECE_BYTES as usize;

    fn payload(len: usize) -> Bytes {
        (0..len).map(|i| (i * 31 % 251) as u8 ^ (i / PIECE) as u8).collect::<Vec<_>>().into()
    }

    #[test]
    fn the_list_gives_the_digest_of_the_whole_at_every_number_of_pieces() {
        for pieces in 0..=17 {
            for len in [pieces * PIECE, pieces * PIECE + 1, pieces * PIECE + 1_025, (pieces + 1) * PIECE - 1] {
                let payload = payload(len);
                let list = PieceList::of(&payload);
                let digest = Digest::of(&payload);
                assert_eq!(list.digest(), digest, "{len} bytes");
                let again = PieceList::checked(&list.to_bytes(), digest, len as u64).unwrap();
                assert_eq!(again, list);
                let read = |r: Range<u64>| Ok::<_, ()>(payload.slice(r.start as usize..r.end as usize));
                assert_eq!(PieceList::read(len as u64, read), Ok(list));
            }
        }
    }

    #[test]
    fn pieces_are_checked_in_any_order_and_only_the_right_ones_pass() {
        let pieces = Pieces::of(payload(4 * PIECE + 77));
        let list = pieces.list();
        for index in [4, 0, 3, 1, 2] {
            let data = pieces.piece(index);
            assert_eq!(list.check(index, &data), Ok(()));
            assert!(list.check((index + 1) % 5, &data).is_err() && list.check(5, &data).is_err());
            assert!(matches!(list.check(index, &data[1..]), Err(WireError::Length { .. })));
            for bit in [0, 7, 8 * data.len() - 1] {
                let mut flipped = data.to_vec();
                flipped[bit / 8] ^= 1 << (bit % 8);
                assert!(matches!(list.check(index, &flipped), Err(WireError::Digest { .. })));
            }
        }
    }

    #[test]
    fn a_list_of_another_payload_is_refused() {
        let pieces = Pieces::of(payload(5 * PIECE));
        let (bytes, digest, length) = (pieces.list().to_bytes(), pieces.list().digest(), 5 * MIN_PIECE_BYTES);
        assert!(PieceList::checked(&bytes[32..], digest, length).is_err());
        assert!(PieceList::checked(&bytes, digest, length + 1).is_err());
        assert!(PieceList::checked(&bytes, Digest([1; 32]), length).is_err());
        for place in [0, bytes.len() - 1] {
            let mut flipped = bytes.to_vec();
            flipped[place] ^= 1;
            assert!(matches!(PieceList::checked(&flipped, digest, length), Err(WireError::Digest { .. })));
        }
    }

    #[test]
    fn every_piece_is_in_one_stripe_and_lists_stay_short() {
        for bytes in [0, 1, MIN_PIECE_BYTES, MIN_PIECE_BYTES + 1, 9 * MIN_PIECE_BYTES - 1, 64 << 30, (64 << 30) - 1] {
            let cut = Cut { bytes };
            assert!(cut.count() <= MAX_PIECES && cut.count() >= 1);
            assert_eq!(cut.range(cut.count() - 1).end, bytes);
            let striped: u64 = (0..STRIPES).map(|s| cut.count_in(s)).sum();
            assert_eq!(striped, cut.count());
            for stripe in 0..STRIPES {
                assert_eq!(cut.from(stripe as u64).count() as u64, cut.count_in(stripe), "{bytes} bytes");
            }
        }
    }
}

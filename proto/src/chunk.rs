//! Bytes as a stream of chunks, and back.
//!
//! The first chunk announces digest and length; the receiver checks the length against its limit before it allocates
//! anything, the order as chunks arrive, and the digest at the end.

use crate::digest::Digest;
use crate::error::WireError;
use crate::limits::CHUNK_BYTES;
use crate::wire::Chunk;
use bytes::Bytes;

/// Most bytes reserved on the word of a peer alone; beyond it the buffer grows with what really arrives.
const MAX_RESERVED_BYTES: u64 = 32 << 20;

/// The chunks of `payload`, which share its memory. An empty payload is one empty chunk.
pub fn chunks(payload: Bytes, digest: Digest) -> impl Iterator<Item = Chunk> + Send {
    let total_bytes = payload.len() as u64;
    let count = payload.len().div_ceil(CHUNK_BYTES).max(1);
    (0..count).map(move |i| {
        let start = i * CHUNK_BYTES;
        let data = payload.slice(start..payload.len().min(start + CHUNK_BYTES));
        chunk(i as u64, digest, total_bytes, data)
    })
}

/// Chunk `index` of a payload: the first one carries the announcement.
pub fn chunk(index: u64, digest: Digest, total_bytes: u64, data: Bytes) -> Chunk {
    match index {
        0 => Chunk { index, digest: digest.to_bytes(), total_bytes, data },
        _ => Chunk { index, data, ..Chunk::default() },
    }
}

/// What the first chunk announces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Announcement {
    /// BLAKE3 of the payload.
    pub digest: Digest,
    /// Its length in bytes.
    pub bytes: u64,
}

/// Checks chunks as they arrive, without keeping them.
#[derive(Debug)]
pub struct Checker {
    what: &'static str,
    limit_bytes: u64,
    limit_name: &'static str,
    announced: Option<Announcement>,
    next: u64,
    received: u64,
    hasher: blake3::Hasher,
}

impl Checker {
    /// For a payload (`what`) of at most `limit_bytes`, a limit called `limit_name`.
    pub fn new(what: &'static str, limit_bytes: u64, limit_name: &'static str) -> Self {
        Checker { what, limit_bytes, limit_name, announced: None, next: 0, received: 0, hasher: blake3::Hasher::new() }
    }
    /// Takes the next chunk; its data may be used once this has returned.
    ///
    /// # Errors
    /// When it is out of order, over a limit, empty without reason, or more than was announced.
    pub fn accept(&mut self, chunk: &Chunk) -> Result<Announcement, WireError> {
        if chunk.index != self.next {
            return Err(WireError::Order { expected: self.next, actual: chunk.index });
        }
        WireError::check_limit("chunk size in bytes", chunk.data.len() as u64, CHUNK_BYTES as u64, "CHUNK_BYTES")?;
        let announced = match self.announced {
            Some(a) => a,
            None => {
                WireError::check_limit(self.what, chunk.total_bytes, self.limit_bytes, self.limit_name)?;
                Announcement { digest: Digest::try_from(&chunk.digest[..])?, bytes: chunk.total_bytes }
            }
        };
        let received = self.received + chunk.data.len() as u64;
        if received > announced.bytes || (chunk.data.is_empty() && announced.bytes > 0) {
            return Err(WireError::Length { expected: announced.bytes, actual: received });
        }
        self.hasher.update(&chunk.data);
        (self.announced, self.next, self.received) = (Some(announced), self.next + 1, received);
        Ok(announced)
    }
    /// Whether everything announced has arrived.
    pub fn is_complete(&self) -> bool {
        self.announced.is_some_and(|a| a.bytes == self.received)
    }
    /// To call at the end of the stream.
    ///
    /// # Errors
    /// When bytes are missing, or they are not those announced.
    pub fn finish(self) -> Result<Announcement, WireError> {
        let announced = self.announced.ok_or(WireError::Missing("the first chunk"))?;
        if self.received != announced.bytes {
            return Err(WireError::Length { expected: announced.bytes, actual: self.received });
        }
        let actual = Digest(*self.hasher.finalize().as_bytes());
        if actual != announced.digest {
            return Err(WireError::Digest { expected: announced.digest.to_string(), actual: actual.to_string() });
        }
        Ok(announced)
    }
}

/// Puts a payload together in memory.
#[derive(Debug)]
pub struct Assembler {
    checker: Checker,
    buffer: Vec<u8>,
}

impl Assembler {
    /// As [`Checker::new`].
    pub fn new(what: &'static str, limit_bytes: u64, limit_name: &'static str) -> Self {
        Assembler { checker: Checker::new(what, limit_bytes, limit_name), buffer: Vec::new() }
    }
    /// Takes the next chunk.
    ///
    /// # Errors
    /// As [`Checker::accept`].
    pub fn push(&mut self, chunk: &Chunk) -> Result<(), WireError> {
        let announced = self.checker.accept(chunk)?;
        if self.buffer.capacity() == 0 {
            self.buffer.reserve_exact(announced.bytes.min(MAX_RESERVED_BYTES) as usize);
        }
        self.buffer.extend_from_slice(&chunk.data);
        Ok(())
    }
    /// Bytes so far.
    pub fn received(&self) -> u64 {
        self.checker.received
    }
    /// The payload and its digest.
    ///
    /// # Errors
    /// As [`Checker::finish`].
    pub fn finish(self) -> Result<(Bytes, Digest), WireError> {
        let announced = self.checker.finish()?;
        Ok((Bytes::from(self.buffer), announced.digest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn payload(len: usize) -> Bytes {
        (0..len).map(|i| (i * 31 % 251) as u8).collect::<Vec<_>>().into()
    }

    fn assemble(chunks: impl IntoIterator<Item = Chunk>, limit: u64) -> Result<Bytes, WireError> {
        let mut assembler = Assembler::new("payload", limit, "TEST_LIMIT");
        for chunk in chunks {
            assembler.push(&chunk)?;
        }
        assembler.finish().map(|(bytes, _)| bytes)
    }

    fn three_chunks() -> Vec<Chunk> {
        let bytes = payload(2 * CHUNK_BYTES + 5);
        chunks(bytes.clone(), Digest::of(&bytes)).collect()
    }

    #[test]
    fn round_trips_at_the_edges_of_a_chunk() {
        for len in [0, 1, CHUNK_BYTES - 1, CHUNK_BYTES, CHUNK_BYTES + 1, 3 * CHUNK_BYTES] {
            let bytes = payload(len);
            assert_eq!(assemble(chunks(bytes.clone(), Digest::of(&bytes)), 1 << 30), Ok(bytes), "{len} bytes");
        }
    }

    #[test]
    fn missing_repeated_and_reordered_chunks_are_errors() {
        let c = three_chunks();
        let order = |list: &[usize]| assemble(list.iter().map(|&i| c[i].clone()), 1 << 30);
        assert_eq!(order(&[0, 2]), Err(WireError::Order { expected: 1, actual: 2 }));
        assert_eq!(order(&[0, 1, 1, 2]), Err(WireError::Order { expected: 2, actual: 1 }));
        assert_eq!(order(&[1, 0, 2]), Err(WireError::Order { expected: 0, actual: 1 }));
        assert!(matches!(order(&[0, 1]), Err(WireError::Length { .. })));
        assert_eq!(order(&[]), Err(WireError::Missing("the first chunk")));
    }

    #[test]
    fn more_than_announced_is_an_error() {
        let mut c = three_chunks();
        c[0].total_bytes -= 1;
        assert!(matches!(assemble(c, 1 << 30), Err(WireError::Length { .. })));
    }

    #[test]
    fn a_flipped_bit_is_an_error() {
        let mut c = three_chunks();
        let mut data = c[1].data.to_vec();
        data[77] ^= 4;
        c[1].data = data.into();
        assert!(matches!(assemble(c, 1 << 30), Err(WireError::Digest { .. })));
    }

    #[test]
    fn a_huge_claim_is_refused_before_anything_is_allocated() {
        let claim = Chunk { total_bytes: u64::MAX, digest: Digest([0; 32]).to_bytes(), ..Chunk::default() };
        let mut assembler = Assembler::new("payload", 1_000, "TEST_LIMIT");
        let error = assembler.push(&claim).unwrap_err();
        assert!(error.to_string().contains("TEST_LIMIT"), "{error}");
        assert_eq!(assembler.buffer.capacity(), 0);
    }

    #[test]
    fn oversized_and_empty_chunks_are_refused() {
        let bytes = payload(CHUNK_BYTES + 1);
        let whole = chunk(0, Digest::of(&bytes), bytes.len() as u64, bytes);
        assert!(matches!(assemble([whole], 1 << 30), Err(WireError::Limit { .. })));
        let endless = Chunk { total_bytes: 9, digest: Digest([0; 32]).to_bytes(), ..Chunk::default() };
        assert!(matches!(assemble([endless], 1 << 30), Err(WireError::Length { .. })));
    }
}

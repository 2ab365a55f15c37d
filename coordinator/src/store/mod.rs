//! What outlives the process: content-addressed blobs (scene files that clients upload and images that jobs leave), and the
//! [`journal`] of what jobs are and have done.
//!
//! A blob is written under a temporary name, checked against its digest, and then renamed to it, so that a name is there
//! only with its whole content.

mod disk;
pub mod journal;

use bytes::Bytes;
use disk::{Directory, PartialFile};
use gatherlight_proto::chunk::{Announcement, Checker};
use gatherlight_proto::limits::{CHUNK_BYTES, MAX_BLOB_BYTES};
use gatherlight_proto::message::BlobRef;
use gatherlight_proto::wire::Chunk;
use gatherlight_proto::{Digest, WireError};
use journal::Journal;
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Why a blob was not taken.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// What arrived makes no sense.
    #[error(transparent)]
    Wire(#[from] WireError),
    /// There is no room.
    #[error(
        "the store holds {used} of at most {limit} bytes and cannot take {wanted} more; raise --max-store on the coordinator"
    )]
    Full {
        /// Bytes held.
        used: u64,
        /// Bytes wanted.
        wanted: u64,
        /// The limit.
        limit: u64,
    },
    /// The disk failed.
    #[error("the coordinator's store failed: {0}")]
    Io(#[from] io::Error),
}

/// Blobs in memory or in a directory.
#[derive(Debug)]
pub struct Store {
    place: Place,
    journal: Option<Journal>,
    limit_bytes: u64,
    used_bytes: AtomicU64,
}

#[derive(Debug)]
enum Place {
    Memory(Mutex<BTreeMap<Digest, Bytes>>),
    Directory(Directory),
}

impl Store {
    /// An empty store in memory, without a limit: what is in it belongs to the caller already.
    pub fn memory() -> Self {
        let place = Place::Memory(Mutex::default());
        Store { place, journal: None, limit_bytes: u64::MAX, used_bytes: AtomicU64::new(0) }
    }
    /// The store in `directory`, which is made if missing. Remains of interrupted uploads are removed.
    ///
    /// # Errors
    /// When the directory cannot be made, read or written.
    pub fn open(directory: &Path, limit_bytes: u64) -> io::Result<Self> {
        let store = Self::without_journal(directory, limit_bytes)?;
        // After the directory is there.
        let journal = Some(Journal::open(&directory.join("jobs.redb"))?);
        Ok(Store { journal, ..store })
    }
    /// The same, but jobs end with the process.
    ///
    /// # Errors
    /// As [`Store::open`].
    pub fn without_journal(directory: &Path, limit_bytes: u64) -> io::Result<Self> {
        let (place, used) = Directory::open(directory)?;
        Ok(Store { place: Place::Directory(place), journal: None, limit_bytes, used_bytes: AtomicU64::new(used) })
    }
    /// What jobs are and have done; none for a store in memory, or without one.
    pub fn journal(&self) -> Option<&Journal> {
        self.journal.as_ref()
    }
    /// Most bytes of blobs.
    pub fn limit_bytes(&self) -> u64 {
        self.limit_bytes
    }
    /// Whether `bytes` more would not find room.
    pub fn lacks_room(&self, bytes: u64) -> bool {
        self.used_bytes.load(Ordering::Relaxed).saturating_add(bytes) > self.limit_bytes
    }
    /// Whether the blob is there; if so, it will not be collected for a while.
    pub fn touch(&self, digest: Digest) -> bool {
        match &self.place {
            Place::Memory(_) => self.contains(digest),
            Place::Directory(d) => d.touch(digest),
        }
    }
    /// Removes blobs that are not `wanted`, the longest untouched first, until there is room for `bytes` more. Those that were touched
    /// lately stay: somebody may be about to submit a job of them.
    pub fn collect(&self, wanted: &BTreeSet<Digest>, bytes: u64) {
        let Place::Directory(directory) = &self.place else { return };
        let old = directory.untouched().unwrap_or_default();
        for (digest, length) in old.into_iter().filter(|(digest, _)| !wanted.contains(digest)) {
            if !self.lacks_room(bytes) {
                return;
            }
            match directory.remove(digest) {
                Ok(()) => {
                    self.used_bytes.fetch_sub(length, Ordering::Relaxed);
                    tracing::info!(%digest, bytes = length, "an old blob was collected");
                }
                Err(error) => tracing::warn!(%digest, %error, "an old blob cannot be removed"),
            }
        }
    }
    /// Bytes held, and reserved for what is on its way.
    pub fn used_bytes(&self) -> u64 {
        self.used_bytes.load(Ordering::Relaxed)
    }
    /// Whether the blob is there.
    pub fn contains(&self, digest: Digest) -> bool {
        match &self.place {
            Place::Memory(blobs) => lock(blobs).contains_key(&digest),
            Place::Directory(d) => d.contains(digest),
        }
    }
    /// The blob's content; its digest is checked when it comes from a disk.
    ///
    /// # Errors
    /// When it is not there, cannot be read, or is damaged.
    pub fn get(&self, digest: Digest) -> io::Result<Bytes> {
        match &self.place {
            Place::Memory(blobs) => lock(blobs).get(&digest).cloned().ok_or_else(|| missing(digest)),
            Place::Directory(d) => d.read(digest).map(Bytes::from),
        }
    }
    /// A piece of a blob for streaming: up to one chunk from `offset` on.
    ///
    /// # Errors
    /// When it is not there or cannot be read.
    pub fn read_at(&self, digest: Digest, offset: u64) -> io::Result<Bytes> {
        self.read_range(digest, offset, CHUNK_BYTES)
    }
    /// Up to `most` bytes of a blob from `offset` on.
    ///
    /// # Errors
    /// As [`Store::read_at`].
    pub fn read_range(&self, digest: Digest, offset: u64, most: usize) -> io::Result<Bytes> {
        match &self.place {
            Place::Memory(blobs) => {
                let blob = lock(blobs).get(&digest).cloned().ok_or_else(|| missing(digest))?;
                let start = usize::try_from(offset).unwrap_or(usize::MAX).min(blob.len());
                Ok(blob.slice(start..blob.len().min(start.saturating_add(most))))
            }
            Place::Directory(d) => d.read_at(digest, offset, most).map(Bytes::from),
        }
    }
    /// Length of a blob.
    ///
    /// # Errors
    /// When it is not there.
    pub fn len(&self, digest: Digest) -> io::Result<u64> {
        match &self.place {
            Place::Memory(blobs) => lock(blobs).get(&digest).map(|b| b.len() as u64).ok_or_else(|| missing(digest)),
            Place::Directory(d) => d.len(digest),
        }
    }
    /// Stores `bytes`.
    ///
    /// # Errors
    /// When there is no room or the disk fails.
    pub fn put(&self, bytes: Bytes) -> Result<BlobRef, StoreError> {
        let blob = BlobRef { digest: Digest::of(&bytes), bytes: bytes.len() as u64 };
        if self.contains(blob.digest) {
            return Ok(blob);
        }
        let mut room = self.reserve(blob.bytes)?;
        match &self.place {
            Place::Memory(blobs) => drop(lock(blobs).insert(blob.digest, bytes)),
            Place::Directory(d) => {
                let mut file = d.begin()?;
                file.write(&bytes)?;
                file.finish(blob.digest)?;
            }
        }
        room.keep();
        Ok(blob)
    }
    /// Begins to receive a blob in chunks.
    pub fn upload(self: &Arc<Self>) -> Upload {
        Upload {
            checker: Checker::new("blob size in bytes", MAX_BLOB_BYTES, "MAX_BLOB_BYTES"),
            store: self.clone(),
            room: None,
            sink: Sink::None,
        }
    }
    fn reserve(&self, wanted: u64) -> Result<Room<'_>, StoreError> {
        let limit = self.limit_bytes;
        let grow = |used: u64| used.checked_add(wanted).filter(|&sum| sum <= limit);
        match self.used_bytes.fetch_update(Ordering::Relaxed, Ordering::Relaxed, grow) {
            Ok(_) => Ok(Room { store: self, bytes: wanted }),
            Err(used) => Err(StoreError::Full { used, wanted, limit }),
        }
    }
}

/// Reserved bytes, given back unless kept.
struct Room<'a> {
    store: &'a Store,
    bytes: u64,
}

impl Room<'_> {
    fn keep(&mut self) -> u64 {
        std::mem::take(&mut self.bytes)
    }
}

impl Drop for Room<'_> {
    fn drop(&mut self) {
        self.store.used_bytes.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

/// A blob on its way in. Dropped before the end, it leaves nothing behind.
#[derive(Debug)]
pub struct Upload {
    store: Arc<Store>,
    checker: Checker,
    room: Option<u64>,
    sink: Sink,
}

#[derive(Debug)]
enum Sink {
    None,
    /// The blob is there already: what comes is checked and dropped.
    Known,
    Memory(Vec<u8>),
    File(PartialFile),
}

impl Upload {
    /// Takes the next chunk. Blocks on the disk.
    ///
    /// # Errors
    /// When it makes no sense, there is no room, or the disk fails.
    pub fn push(&mut self, chunk: &Chunk) -> Result<(), StoreError> {
        let announced = self.checker.accept(chunk)?;
        if self.room.is_none() {
            self.begin(announced)?;
        }
        match &mut self.sink {
            Sink::None | Sink::Known => {}
            Sink::Memory(bytes) => bytes.extend_from_slice(&chunk.data),
            Sink::File(file) => file.write(&chunk.data)?,
        }
        Ok(())
    }
    fn begin(&mut self, announced: Announcement) -> Result<(), StoreError> {
        if self.store.contains(announced.digest) {
            (self.room, self.sink) = (Some(0), Sink::Known);
            return Ok(());
        }
        self.room = Some(self.store.reserve(announced.bytes)?.keep());
        self.sink = match &self.store.place {
            Place::Memory(_) => Sink::Memory(Vec::new()),
            Place::Directory(d) => Sink::File(d.begin()?),
        };
        Ok(())
    }
    /// Checks and stores what arrived.
    ///
    /// # Errors
    /// When bytes are missing or are not those announced, or the disk fails.
    pub fn finish(mut self) -> Result<BlobRef, StoreError> {
        let fresh = Checker::new("", 0, "");
        let announced = std::mem::replace(&mut self.checker, fresh).finish()?;
        let blob = BlobRef { digest: announced.digest, bytes: announced.bytes };
        if self.store.contains(announced.digest) {
            // Somebody else was faster; this one's room is given back.
            return Ok(blob);
        }
        match std::mem::replace(&mut self.sink, Sink::None) {
            Sink::None | Sink::Known => {}
            Sink::Memory(bytes) => {
                if let Place::Memory(blobs) = &self.store.place {
                    lock(blobs).insert(announced.digest, bytes.into());
                }
            }
            Sink::File(file) => file.finish(announced.digest)?,
        }
        self.room = None;
        Ok(blob)
    }
}

impl Drop for Upload {
    fn drop(&mut self) {
        self.store.used_bytes.fetch_sub(self.room.unwrap_or(0), Ordering::Relaxed);
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    // Nothing panics while it is held, and a map of whole blobs is valid at any moment.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn missing(digest: Digest) -> io::Error {
    io::Error::new(io::ErrorKind::NotFound, format!("blob {digest} is not in the store"))
}

#[cfg(test)]
mod tests;

//! Blobs as files: `DIRECTORY/blobs/<digest>`, written as `DIRECTORY/partial/<n>` first.

use gatherlight_proto::Digest;
use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

/// Time since it was touched for which a blob is not collected.
const GRACE: Duration = Duration::from_secs(600);

/// The directory of a store. Every path in it is made of a digest or a number, never of a name that a peer chose.
#[derive(Debug)]
pub(super) struct Directory {
    blobs: PathBuf,
    partial: PathBuf,
    last: AtomicU64,
}

impl Directory {
    /// Opens or makes it; returns the bytes in it as well.
    pub(super) fn open(path: &Path) -> io::Result<(Self, u64)> {
        let (blobs, partial) = (path.join("blobs"), path.join("partial"));
        fs::create_dir_all(&blobs)?;
        fs::create_dir_all(&partial)?;
        for entry in fs::read_dir(&partial)? {
            fs::remove_file(entry?.path())?;
        }
        let sizes = fs::read_dir(&blobs)?.map(|entry| entry?.metadata().map(|m| m.len()));
        let used = sizes.sum::<io::Result<u64>>()?;
        let directory = Directory { blobs, partial, last: AtomicU64::new(0) };
        // A store that cannot be written is found now, not at the end of the first job.
        drop(directory.begin()?);
        Ok((directory, used))
    }
    fn path(&self, digest: Digest) -> PathBuf {
        self.blobs.join(digest.to_string())
    }
    pub(super) fn contains(&self, digest: Digest) -> bool {
        self.path(digest).is_file()
    }
    /// Whether it is there; if so, it is as new from now on.
    pub(super) fn touch(&self, digest: Digest) -> bool {
        let touched =
            File::options().append(true).open(self.path(digest)).and_then(|f| f.set_modified(SystemTime::now()));
        // One that cannot be touched can be read all the same.
        touched.is_ok() || self.contains(digest)
    }
    /// Digests and lengths of blobs that were not touched lately, the longest untouched first.
    pub(super) fn untouched(&self) -> io::Result<Vec<(Digest, u64)>> {
        let mut found = Vec::new();
        for entry in fs::read_dir(&self.blobs)? {
            let entry = entry?;
            let (metadata, name) = (entry.metadata()?, entry.file_name());
            let Some(digest) = name.to_str().and_then(|n| Digest::from_str(n).ok()) else { continue };
            let touched = metadata.modified()?;
            if touched.elapsed().is_ok_and(|age| age >= GRACE) {
                found.push((touched, digest, metadata.len()));
            }
        }
        found.sort_unstable_by_key(|&(touched, digest, _)| (touched, digest.0));
        Ok(found.into_iter().map(|(_, digest, length)| (digest, length)).collect())
    }
    pub(super) fn remove(&self, digest: Digest) -> io::Result<()> {
        fs::remove_file(self.path(digest))
    }
    pub(super) fn len(&self, digest: Digest) -> io::Result<u64> {
        fs::metadata(self.path(digest)).map(|m| m.len())
    }
    pub(super) fn read(&self, digest: Digest) -> io::Result<Vec<u8>> {
        let bytes = fs::read(self.path(digest))?;
        if Digest::of(&bytes) != digest {
            let message = format!("blob {digest} is damaged on the coordinator's disk; delete it and submit again");
            return Err(io::Error::new(io::ErrorKind::InvalidData, message));
        }
        Ok(bytes)
    }
    pub(super) fn read_at(&self, digest: Digest, offset: u64, limit: usize) -> io::Result<Vec<u8>> {
        let mut file = File::open(self.path(digest))?;
        file.seek(SeekFrom::Start(offset))?;
        let mut bytes = Vec::with_capacity(limit);
        file.take(limit as u64).read_to_end(&mut bytes)?;
        Ok(bytes)
    }
    /// A new file that has no digest yet.
    pub(super) fn begin(&self) -> io::Result<PartialFile> {
        let path = self.partial.join(self.last.fetch_add(1, Ordering::Relaxed).to_string());
        let file = File::create(&path)?;
        Ok(PartialFile { file, path, blobs: self.blobs.clone() })
    }
}

/// A file on its way in; removed unless finished.
#[derive(Debug)]
pub(super) struct PartialFile {
    file: File,
    path: PathBuf,
    blobs: PathBuf,
}

impl PartialFile {
    pub(super) fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.file.write_all(bytes)
    }
    /// Gives it its name, once it is safely on the disk.
    pub(super) fn finish(self, digest: Digest) -> io::Result<()> {
        self.file.sync_all()?;
        fs::rename(&self.path, self.blobs.join(digest.to_string()))?;
        // The name is on the disk when its directory is.
        File::open(&self.blobs)?.sync_all()
    }
}

impl Drop for PartialFile {
    fn drop(&mut self) {
        // After `finish` there is nothing under this name; an error here leaves a file that the next start removes.
        drop(fs::remove_file(&self.path));
    }
}

//! A scene of which only the bytes that an image needs are sent.
//!
//! A cut scene is a .glb: the JSON as it was, to the byte; a binary chunk of those pieces of the original's that are
//! read; and a chunk of type `PART` with the digest of the original and the place of every piece, in each file. External
//! files are cut likewise, and left out where nothing of them is read. A cut scene is loaded as the original is: it
//! gives the same description, to the bit, for the settings it was cut for.

use super::buffer::{Buffers, ByteRange, Files};
use super::document::Document;
use super::needs::Needs;
use super::{SceneBundle, Wanted, glb, parsed};
use crate::error::SceneError;
use std::collections::BTreeSet;
use std::sync::Arc;

/// A file is cut where at least this share of it goes: small gains are not worth sending a scene again that the
/// coordinator has already in another cut.
const WORTHWHILE: f64 = 1.0 / 16.0;
/// Bytes between two pieces that are sent rather than cut out.
const SMALL_GAP: u64 = 64;
/// Bytes of a digest.
const DIGEST_BYTES: usize = 32;

/// Ascending pieces of a file that do not touch, stored one after the other.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Pieces {
    /// Offset in the file, length, and where it is stored.
    list: Vec<[u64; 3]>,
}

impl Pieces {
    /// The union of ascending ranges.
    pub(super) fn of<'r>(ranges: impl Iterator<Item = &'r ByteRange>) -> Self {
        Pieces::joined(ranges.map(|r| (r.offset as u64, r.length as u64)), 0).unwrap_or_default()
    }
    /// Joins ascending ranges whose gaps are at most `gap`; `None` where one begins before the one ahead of it.
    fn joined(ranges: impl Iterator<Item = (u64, u64)>, gap: u64) -> Option<Self> {
        let mut list: Vec<[u64; 3]> = Vec::new();
        for (offset, length) in ranges {
            let end = offset.checked_add(length)?;
            match list.last_mut() {
                Some([first, len, _]) if offset < *first => return None,
                Some([first, len, _]) if offset <= first.checked_add(*len)?.checked_add(gap)? => {
                    *len = (*len).max(end - *first);
                }
                _ => list.push([offset, length, 0]),
            }
        }
        let mut stored = 0u64;
        for [_, length, at] in &mut list {
            *at = stored;
            stored = stored.checked_add(*length)?;
        }
        Some(Pieces { list })
    }
    /// Bytes of all pieces.
    pub(super) fn len(&self) -> u64 {
        self.list.last().map_or(0, |[_, length, at]| at + length)
    }
    /// Where the bytes from `offset` on are stored, if they are all there.
    pub(super) fn find(&self, offset: u64, length: u64) -> Option<usize> {
        let next = self.list.partition_point(|[first, ..]| *first <= offset);
        let [first, len, at] = *self.list.get(next.checked_sub(1)?)?;
        let fits = offset.checked_add(length)? <= first.checked_add(len)?;
        fits.then(|| usize::try_from(at + (offset - first)).ok()).flatten()
    }
    fn cut(&self, bytes: &[u8]) -> Option<Vec<u8>> {
        let mut out = Vec::with_capacity(usize::try_from(self.len()).ok()?);
        for &[offset, length, _] in &self.list {
            let (first, end) = (usize::try_from(offset).ok()?, usize::try_from(offset + length).ok()?);
            out.extend_from_slice(bytes.get(first..end)?);
        }
        Some(out)
    }
}

/// What a cut scene says about itself.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Cut {
    /// Digest of the scene that was cut.
    digest: [u8; DIGEST_BYTES],
    /// The pieces of the binary chunk, then of each external file; `None`: the file is whole.
    files: Vec<Option<Pieces>>,
}

impl Cut {
    /// The pieces of an external file, or of the binary chunk; `None` where it is whole.
    pub(super) fn pieces(&self, external: Option<usize>) -> Option<&Pieces> {
        self.files.get(external.map_or(0, |e| e + 1))?.as_ref()
    }
    /// Little-endian: the digest; for each file the number of its pieces + 1 (0: whole), and their offsets and lengths.
    fn encode(&self) -> Vec<u8> {
        let mut out = self.digest.to_vec();
        out.extend((self.files.len() as u64).to_le_bytes());
        for file in &self.files {
            let list = file.as_ref().map(|f| &f.list);
            out.extend(list.map_or(0, |l| l.len() as u64 + 1).to_le_bytes());
            let numbers = list.into_iter().flatten().flat_map(|[offset, length, _]| [*offset, *length]);
            out.extend(numbers.flat_map(u64::to_le_bytes));
        }
        out
    }
    /// Reads the table of `file`, whatever it holds.
    ///
    /// # Errors
    /// When it is cut short, or its pieces do not ascend.
    pub(super) fn decode(file: &str, table: &[u8]) -> Result<Self, SceneError> {
        let bad = || SceneError::invalid(format!("{file}: chunk PART"), "the table of the cut scene is damaged");
        let (digest, rest) = table.split_first_chunk::<DIGEST_BYTES>().ok_or_else(bad)?;
        let mut numbers = rest.as_chunks::<8>().0.iter().map(|b| u64::from_le_bytes(*b));
        let count = numbers.next().ok_or_else(bad)?;
        let mut files = Vec::new();
        for _ in 0..count {
            let pieces = numbers.next().ok_or_else(bad)?;
            let Some(pieces) = pieces.checked_sub(1) else {
                files.push(None);
                continue;
            };
            if pieces > numbers.len() as u64 / 2 {
                return Err(bad());
            }
            let ranges: Vec<(u64, u64)> =
                (0..pieces).filter_map(|_| Some((numbers.next()?, numbers.next()?))).collect();
            let joined = Pieces::joined(ranges.iter().copied(), 0).ok_or_else(bad)?;
            if joined.list.len() != ranges.len() {
                return Err(bad());
            }
            files.push(Some(joined));
        }
        Ok(Cut { digest: *digest, files })
    }
}

/// The digest of the scene from which `root` was cut; `None` for a scene that is whole.
pub fn original_digest(root: &[u8]) -> Option<[u8; 32]> {
    let table = glb::split("", root).ok()?.table?;
    Cut::decode("", table).ok().map(|cut| cut.digest)
}

/// The scene without the bytes that an image for `wanted` does not need; `digest` is that of the whole, by which it is still
/// known. The scene itself where there is next to nothing to leave out.
///
/// # Errors
/// When the scene is damaged.
pub fn cut(bundle: &SceneBundle, digest: [u8; 32], wanted: Wanted) -> Result<SceneBundle, SceneError> {
    let container = glb::split(&bundle.name, &bundle.root)?;
    if wanted.everything || container.table.is_some() {
        return Ok(bundle.clone());
    }
    let whole = Files { binary: container.binary, externals: &bundle.externals, cut: None };
    let (needs, uris) = parsed(&bundle.name, container.json, wanted, |doc, needs| {
        // What is missing from a buffer cannot be seen from its pieces.
        Buffers::resolve(doc, whole, needs)?;
        Uris::read(doc, needs)
    })?;
    let binary = container.binary.map(|bytes| shortened(bytes, uris.pieces(&needs, None)));
    let mut changed = matches!(binary, Some(Some(_)));
    let mut files = vec![None];
    let mut kept_binary = container.binary.map(<[u8]>::to_vec);
    if let Some(Some((bytes, pieces))) = binary {
        (kept_binary, files[0]) = (Some(bytes), Some(pieces));
    }
    let mut externals = Vec::new();
    for (uri, bytes) in &bundle.externals {
        if !uris.read.contains(uri) {
            changed = true;
            continue;
        }
        // An image is read whole.
        let pieces = if uris.images.contains(uri) { None } else { Some(uris.pieces(&needs, Some(uri))) };
        let (bytes, pieces) = match pieces.and_then(|p| shortened(bytes, p)) {
            Some((kept, pieces)) => (Arc::from(kept), Some(pieces)),
            None => (bytes.clone(), None),
        };
        changed |= pieces.is_some();
        files.push(pieces);
        externals.push((uri.clone(), bytes));
    }
    let table = Cut { digest, files }.encode();
    let root = glb::join(container.json, kept_binary.as_deref(), &table).filter(|_| changed);
    Ok(root
        .map_or_else(|| bundle.clone(), |root| SceneBundle { name: bundle.name.clone(), root: root.into(), externals }))
}

/// What is left of a file, where that is worth while.
fn shortened(bytes: &[u8], pieces: Pieces) -> Option<(Vec<u8>, Pieces)> {
    let worthwhile = pieces.len() as f64 <= bytes.len() as f64 * (1.0 - WORTHWHILE);
    let kept = if worthwhile { pieces.cut(bytes) } else { None };
    kept.map(|kept| (kept, pieces))
}

/// Names of external files.
struct Uris {
    /// Of each buffer, where it is not in the file itself.
    buffers: Vec<Option<String>>,
    /// Of images that are read.
    images: BTreeSet<String>,
    /// Of all files that are read.
    read: Vec<String>,
}

impl Uris {
    fn read(doc: &Document, needs: &Needs) -> Result<Self, SceneError> {
        let uri = |section, index| doc.item(section, index)?.opt("uri", |u| u.text().map(String::from));
        let images = (0..doc.count("images")).filter(|i| needs.reads_image(*i)).map(|i| uri("images", i));
        Ok(Uris {
            buffers: (0..doc.count("buffers")).map(|b| uri("buffers", b)).collect::<Result<_, _>>()?,
            images: images.filter_map(Result::transpose).collect::<Result<_, _>>()?,
            read: needs.external_uris(doc)?,
        })
    }
    /// What is read of the file `uri`, or of the binary chunk, by all buffers that are in it.
    fn pieces(&self, needs: &Needs, uri: Option<&str>) -> Pieces {
        let is_of = |b: usize| self.buffers.get(b).is_some_and(|u| u.as_deref() == uri);
        let mut ranges: Vec<(u64, u64)> =
            needs.ranges().filter(|r| is_of(r.buffer)).map(|r| (r.offset as u64, r.length as u64)).collect();
        ranges.sort_unstable();
        Pieces::joined(ranges.into_iter(), SMALL_GAP).unwrap_or_default()
    }
}

//! Buffers and buffer views: the bytes behind accessors and images.

use super::cut::{Cut, Pieces};
use super::document::Document;
use super::json::{Item, Result};
use super::needs::Needs;
use super::uri;
use std::borrow::Cow;
use std::sync::Arc;

/// Least and greatest `byteStride` the specification allows.
const STRIDE_RANGE: std::ops::RangeInclusive<usize> = 4..=252;

/// A checked slice of a buffer.
#[derive(Clone, Copy)]
pub(super) struct View {
    buffer: usize,
    offset: usize,
    length: usize,
    /// Bytes from one element to the next, where the file says.
    pub(super) stride: Option<usize>,
}

/// Bytes of a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct ByteRange {
    /// Index of the buffer.
    pub(super) buffer: usize,
    /// The first byte.
    pub(super) offset: usize,
    /// How many.
    pub(super) length: usize,
}

impl View {
    /// A part of the view, which lies inside it.
    pub(super) fn part(&self, offset: usize, length: usize) -> ByteRange {
        ByteRange { buffer: self.buffer, offset: self.offset + offset, length }
    }
    /// All of it.
    pub(super) fn range(&self) -> ByteRange {
        self.part(0, self.length)
    }
    /// Bytes of the view.
    pub(super) fn len(&self) -> usize {
        self.length
    }
    /// Where the view begins in its buffer.
    pub(super) fn offset(&self) -> usize {
        self.offset
    }
}

/// Checks all buffer views against the lengths that the buffers state.
///
/// # Errors
/// Names the first view that does not fit.
pub(super) fn check_views(doc: &Document) -> Result<Vec<View>> {
    let lengths = (0..doc.count("buffers"))
        .map(|i| doc.item("buffers", i)?.require("byteLength")?.size())
        .collect::<Result<Vec<usize>>>()?;
    (0..doc.count("bufferViews")).map(|i| check_view(doc, &doc.item("bufferViews", i)?, &lengths)).collect()
}

fn check_view(doc: &Document, item: &Item, lengths: &[usize]) -> Result<View> {
    let buffer = doc.index(&item.require("buffer")?, "buffers")?;
    let offset = item.opt("byteOffset", Item::size)?.unwrap_or(0);
    let length_item = item.require("byteLength")?;
    let length = length_item.size()?;
    let available = lengths.get(buffer).copied().unwrap_or(0);
    if length == 0 {
        return Err(length_item.error("must be at least 1"));
    }
    if offset.checked_add(length).is_none_or(|end| end > available) {
        return Err(item.error(format!(
            "bytes {offset} to {offset} + {length} lie outside buffers[{buffer}], which has {available} bytes"
        )));
    }
    let stride_item = item.get("byteStride")?;
    let stride = stride_item.as_ref().map(Item::size).transpose()?;
    if let Some((item, stride)) = stride_item.zip(stride)
        && (!STRIDE_RANGE.contains(&stride) || !stride.is_multiple_of(4))
    {
        return Err(item.error(format!("must be a multiple of 4 from 4 to 252, found {stride}")));
    }
    Ok(View { buffer, offset, length, stride })
}

/// The bytes of a buffer, as far as they are here.
enum Source<'b> {
    /// Nobody reads it.
    Unread,
    /// All of it.
    Whole(Cow<'b, [u8]>),
    /// What a client left of it.
    Cut(&'b [u8], &'b Pieces),
}

/// The bytes of all buffers that are read.
pub(super) struct Buffers<'b> {
    sources: Vec<Source<'b>>,
}

/// Where a scene's bytes come from.
#[derive(Clone, Copy)]
pub(super) struct Files<'b> {
    /// The binary chunk of a .glb.
    pub(super) binary: Option<&'b [u8]>,
    /// External files by their URI.
    pub(super) externals: &'b [(String, Arc<[u8]>)],
    /// What of them is here, where the client sent a part.
    pub(super) cut: Option<&'b Cut>,
}

impl<'b> Buffers<'b> {
    /// Finds the bytes of every buffer that `needs` reads.
    ///
    /// # Errors
    /// When an external file is missing, a data URI is damaged, or there are fewer bytes than the buffer states or the
    /// image needs.
    pub(super) fn resolve(doc: &Document, files: Files<'b>, needs: &Needs) -> Result<Self> {
        let sources = (0..doc.count("buffers"))
            .map(|i| if needs.reads_buffer(i) { source(doc, i, files) } else { Ok(Source::Unread) });
        let buffers = Buffers { sources: sources.collect::<Result<_>>()? };
        if let Some(lost) = needs.ranges().find(|r| buffers.find(**r).is_none()) {
            let ByteRange { buffer, offset, length } = *lost;
            let item = doc.item("buffers", buffer)?;
            return Err(item.error(format!("bytes {offset} to {offset} + {length} were cut out, but are needed")));
        }
        Ok(buffers)
    }
    /// The bytes of a range that [`Needs`] names.
    pub(super) fn bytes(&self, range: ByteRange) -> &[u8] {
        self.find(range).unwrap_or(&[])
    }
    fn find(&self, r: ByteRange) -> Option<&[u8]> {
        match self.sources.get(r.buffer)? {
            Source::Unread => None,
            Source::Whole(bytes) => bytes.get(r.offset..r.offset.checked_add(r.length)?),
            Source::Cut(bytes, pieces) => {
                let at = pieces.find(r.offset as u64, r.length as u64)?;
                bytes.get(at..at.checked_add(r.length)?)
            }
        }
    }
}

fn source<'b>(doc: &Document, index: usize, files: Files<'b>) -> Result<Source<'b>> {
    let item = doc.item("buffers", index)?;
    let (bytes, pieces) = match item.get("uri")? {
        None => {
            let bytes = files.binary.filter(|_| index == 0).ok_or_else(|| {
                item.error("has no uri, and the file has no binary chunk for it (only the first buffer of a .glb may do without)")
            })?;
            (Cow::Borrowed(bytes), files.cut.and_then(|c| c.pieces(None)))
        }
        Some(uri_item) => {
            let uri = uri_item.text()?;
            if uri::is_data(uri) {
                (Cow::Owned(uri::decode_data(&uri_item, uri)?.1), None)
            } else {
                let (at, bytes) = uri::find_external(&uri_item, uri, files.externals)?;
                (Cow::Borrowed(bytes), files.cut.and_then(|c| c.pieces(Some(at))))
            }
        }
    };
    if let (Cow::Borrowed(bytes), Some(pieces)) = (&bytes, pieces) {
        return Ok(Source::Cut(bytes, pieces));
    }
    let length = item.require("byteLength")?;
    if bytes.len() < length.size()? {
        return Err(length.error(format!("says {} bytes, but there are only {}", length.size()?, bytes.len())));
    }
    Ok(Source::Whole(bytes))
}

//! Buffers and buffer views: the bytes behind accessors and images.

use super::document::Document;
use super::json::{Item, Result};
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

impl View {
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

/// The bytes of all buffers.
pub(super) struct Buffers<'b> {
    bytes: Vec<Cow<'b, [u8]>>,
}

impl<'b> Buffers<'b> {
    /// Finds the bytes of every buffer.
    ///
    /// # Errors
    /// When an external file is missing, a data URI is damaged, or there are fewer bytes than the buffer states.
    pub(super) fn resolve(
        doc: &Document,
        binary: Option<&'b [u8]>,
        externals: &'b [(String, Arc<[u8]>)],
    ) -> Result<Self> {
        let bytes = (0..doc.count("buffers")).map(|i| {
            let item = doc.item("buffers", i)?;
            let bytes = match item.get("uri")? {
                None => Cow::Borrowed(binary.filter(|_| i == 0).ok_or_else(|| {
                    item.error("has no uri, and the file has no binary chunk for it (only the first buffer of a .glb may do without)")
                })?),
                Some(uri_item) => {
                    let uri = uri_item.text()?;
                    if uri::is_data(uri) {
                        Cow::Owned(uri::decode_data(&uri_item, uri)?.1)
                    } else {
                        Cow::Borrowed(uri::find_external(&uri_item, uri, externals)?)
                    }
                }
            };
            let length = item.require("byteLength")?;
            if bytes.len() < length.size()? {
                return Err(length.error(format!("says {} bytes, but there are only {}", length.size()?, bytes.len())));
            }
            Ok(bytes)
        });
        Ok(Buffers { bytes: bytes.collect::<Result<_>>()? })
    }
    /// The bytes of a view.
    pub(super) fn view(&self, view: &View) -> &[u8] {
        let buffer: &[u8] = self.bytes.get(view.buffer).map_or(&[], |b| b);
        buffer.get(view.offset..view.offset + view.length).unwrap_or(&[])
    }
}

//! Reading OpenEXR files, ours or another program's: any channel names, half, float or integer samples, scan lines or
//! tiles (the largest level), any compression but deep data. Hostile bytes give an error, never a panic.

use crate::error::ImageError;
use crate::film::Image;
use ::exr::block::lines::LineRef;
use ::exr::block::reader::ChunksReader;
use ::exr::block::{self, UncompressedBlock};
use ::exr::meta::attribute::{AttributeValue, SampleType};
use ::exr::meta::header::Header;
use ::exr::prelude::f16;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Largest number of bytes the decoded pixels of one file may take, as 32-bit floats.
pub const MAX_DECODED_BYTES: u64 = 16 << 30;
/// Largest ratio of decoded to encoded size; ZIP itself ends at 1032.
pub const MAX_EXPANSION: u64 = 16_384;

/// Decodes every channel of the first part, and those of further parts of the same window, their names preceded by the
/// part's name.
///
/// # Errors
/// [`ImageError::Exr`] when the bytes are not OpenEXR, are damaged, or claim more pixels than the limits allow.
pub fn decode(bytes: &[u8]) -> Result<Image, ImageError> {
    // The crate asserts in places that only damaged files reach; the error is then as good as any other.
    match catch_unwind(AssertUnwindSafe(|| decode_unguarded(bytes))) {
        Ok(result) => result,
        Err(_) => Err(ImageError::Exr("the file is damaged".into())),
    }
}

fn decode_unguarded(bytes: &[u8]) -> Result<Image, ImageError> {
    let reader = block::read(Cursor::new(bytes), false).map_err(error)?;
    let parts = Parts::new(reader.headers());
    check_size(reader.headers(), &parts, bytes.len())?;
    let first = reader.headers().first().ok_or_else(|| ImageError::Exr("no part".into()))?;
    let (width, height) = (first.layer_size.width(), first.layer_size.height());
    let attributes = attributes(first);
    let mut channels: Vec<(String, Vec<f32>)> =
        parts.names.into_iter().map(|name| (name, vec![0.0; width * height])).collect();
    let firsts = parts.first_channel;
    let wanted = |layer: usize| firsts.get(layer).copied().flatten();

    let mut chunks = reader
        .filter_chunks(false, |_, tile, block| {
            tile.level_index.0 == 0 && tile.level_index.1 == 0 && wanted(block.layer).is_some()
        })
        .map_err(error)?;
    let meta = chunks.meta_data().clone();
    for chunk in chunks.by_ref() {
        let block = UncompressedBlock::decompress_chunk(chunk.map_err(error)?, &meta, false).map_err(error)?;
        let Some((header, first)) = meta.headers.get(block.index.layer).zip(wanted(block.index.layer)) else {
            continue;
        };
        for line in block.lines(&header.channels) {
            let kind = header.channels.list.get(line.location.channel).map(|c| c.sample_type);
            let target = channels.get_mut(first + line.location.channel).zip(kind);
            target.and_then(|((_, values), kind)| copy_line(&line, kind, values, width)).ok_or_else(damaged)?;
        }
    }
    Ok(Image { width, height, channels, attributes })
}

fn error(e: ::exr::error::Error) -> ImageError {
    ImageError::Exr(e.to_string())
}

fn damaged() -> ImageError {
    ImageError::Exr("the file is damaged".into())
}

/// The channels that are read, over all parts.
struct Parts {
    /// Their names.
    names: Vec<String>,
    /// Index of the first channel of each part; `None` for parts that are left out.
    first_channel: Vec<Option<usize>>,
}

impl Parts {
    fn new(headers: &[Header]) -> Self {
        let mut parts = Parts { names: Vec::new(), first_channel: Vec::new() };
        let window = headers.first().map(Header::data_window);
        for (i, header) in headers.iter().enumerate() {
            if header.deep || Some(header.data_window()) != window {
                parts.first_channel.push(None);
                continue;
            }
            parts.first_channel.push(Some(parts.names.len()));
            let part =
                header.own_attributes.layer_name.as_ref().map(|n| String::from_utf8_lossy(n.bytes()).into_owned());
            for channel in &header.channels.list {
                let name = String::from_utf8_lossy(channel.name.bytes());
                parts.names.push(match &part {
                    Some(part) if i > 0 && !name.starts_with(part.as_str()) => format!("{part}.{name}"),
                    _ => name.into_owned(),
                });
            }
        }
        parts
    }
}

/// Refuses sizes that would exhaust memory before anything of that size is allocated.
fn check_size(headers: &[Header], parts: &Parts, file_bytes: usize) -> Result<(), ImageError> {
    let Some(first) = headers.first() else { return Err(damaged()) };
    let (width, height) = (first.layer_size.width() as u64, first.layer_size.height() as u64);
    let decoded = width.saturating_mul(height).saturating_mul(4).saturating_mul(parts.names.len() as u64);
    if decoded == 0 {
        return Err(ImageError::Exr(format!("the image is empty: {width} × {height} pixels")));
    }
    if decoded > MAX_DECODED_BYTES {
        return Err(ImageError::Exr(format!(
            "{width} × {height} pixels with {} channels take {decoded} bytes, over the limit of {MAX_DECODED_BYTES}",
            parts.names.len()
        )));
    }
    let chunks: u64 = headers.iter().map(|h| h.chunk_count as u64).fold(0, u64::saturating_add);
    if chunks.saturating_mul(8) > file_bytes as u64 || decoded / MAX_EXPANSION > file_bytes as u64 {
        return Err(ImageError::Exr(format!(
            "the file is cut short: {width} × {height} pixels do not fit in {file_bytes} bytes"
        )));
    }
    Ok(())
}

/// Copies one line of one channel into its place; `None` when it lies outside.
fn copy_line(line: &LineRef<'_>, kind: SampleType, values: &mut [f32], width: usize) -> Option<()> {
    let at = line.location;
    if at.position.x().checked_add(at.sample_count)? > width {
        return None;
    }
    let first = at.position.y().checked_mul(width)?.checked_add(at.position.x())?;
    let target = values.get_mut(first..first.checked_add(at.sample_count)?)?;
    let bytes = line.value;
    match kind {
        SampleType::F16 => {
            for (t, b) in target.iter_mut().zip(bytes.chunks_exact(2)) {
                *t = f16::from_ne_bytes([b[0], b[1]]).to_f32();
            }
        }
        SampleType::F32 => {
            for (t, b) in target.iter_mut().zip(bytes.chunks_exact(4)) {
                *t = f32::from_ne_bytes([b[0], b[1], b[2], b[3]]);
            }
        }
        SampleType::U32 => {
            for (t, b) in target.iter_mut().zip(bytes.chunks_exact(4)) {
                *t = u32::from_ne_bytes([b[0], b[1], b[2], b[3]]) as f32;
            }
        }
    }
    Some(())
}

fn attributes(header: &Header) -> BTreeMap<String, String> {
    let lossy = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    header
        .all_named_attributes()
        .filter_map(|(name, value)| {
            let value = match value {
                AttributeValue::Text(t) => lossy(t.bytes()),
                AttributeValue::I32(v) => v.to_string(),
                AttributeValue::F32(v) => v.to_string(),
                AttributeValue::F64(v) => v.to_string(),
                _ => return None,
            };
            Some((lossy(name), value))
        })
        .collect()
}

//! The .glb container: a 12-byte header, a JSON chunk, an optional binary chunk.

use super::json::Result;
use crate::error::SceneError;

const MAGIC: &[u8; 4] = b"glTF";
const CHUNK_JSON: u32 = 0x4e4f_534a;
const CHUNK_BIN: u32 = 0x004e_4942;
/// `PART`: the private chunk of [`mod@super::cut`].
const CHUNK_TABLE: u32 = 0x5452_4150;
const HEADER_BYTES: usize = 12;
const CHUNK_HEADER_BYTES: usize = 8;

/// The parts of a scene file.
pub(super) struct Container<'a> {
    /// The JSON text.
    pub(super) json: &'a [u8],
    /// The binary chunk of a .glb.
    pub(super) binary: Option<&'a [u8]>,
    /// The table of a .glb of which a client sent a part: see [`mod@super::cut`].
    pub(super) table: Option<&'a [u8]>,
    /// Bytes after the declared end of a .glb.
    pub(super) trailing: usize,
}

/// Splits a .glb, told by its first bytes, or takes a .gltf as it is.
///
/// # Errors
/// When the file is neither, of another version, cut short, or its chunks do not fit.
pub(super) fn split<'a>(file: &str, bytes: &'a [u8]) -> Result<Container<'a>> {
    if bytes.is_empty() {
        return Err(SceneError::invalid(file, "the file is empty"));
    }
    if !bytes.starts_with(MAGIC) {
        if file.to_ascii_lowercase().ends_with(".glb") {
            return Err(SceneError::invalid(file, "not a .glb file: it does not begin with \"glTF\""));
        }
        let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        if text.iter().find(|b| !b.is_ascii_whitespace()) != Some(&b'{') {
            return Err(SceneError::invalid(
                file,
                "not a glTF 2.0 file: neither .glb nor JSON; convert the scene to .glb or .gltf",
            ));
        }
        return Ok(Container { json: bytes, binary: None, table: None, trailing: 0 });
    }
    split_binary(file, bytes)
}

fn split_binary<'a>(file: &str, bytes: &'a [u8]) -> Result<Container<'a>> {
    let truncated = || {
        SceneError::invalid(file, format!("the file is cut short: {} bytes do not hold the .glb header", bytes.len()))
    };
    let version = word(bytes, 4).ok_or_else(truncated)?;
    let length = word(bytes, 8).ok_or_else(truncated)? as usize;
    if version != 2 {
        return Err(SceneError::invalid(
            format!("{file}: header"),
            format!("container version {version} is not supported; re-export as glTF 2.0"),
        ));
    }
    let Some(body) = bytes.get(..length) else {
        return Err(SceneError::invalid(
            format!("{file}: header"),
            format!("the file is cut short: the header says {length} bytes, there are {}", bytes.len()),
        ));
    };
    let (kind, json, next) = chunk(file, body, HEADER_BYTES)?;
    if kind != CHUNK_JSON {
        return Err(SceneError::invalid(format!("{file}: chunk 0"), "the first chunk must be JSON"));
    }
    let more = |start| if start < body.len() { chunk(file, body, start).map(Some) } else { Ok(None) };
    let second = more(next)?;
    let binary = second.and_then(|(kind, data, _)| (kind == CHUNK_BIN).then_some(data));
    // Chunks of other types are nobody's business (glTF §4.4), and what follows them may be anything.
    let third = match second {
        Some((CHUNK_BIN, _, next)) => more(next).ok().flatten(),
        other => other,
    };
    let table = third.and_then(|(kind, data, _)| (kind == CHUNK_TABLE).then_some(data));
    Ok(Container { json, binary, table, trailing: bytes.len() - length })
}

/// The .glb of these chunks, each padded to a multiple of 4 bytes.
pub(super) fn join(json: &[u8], binary: Option<&[u8]>, table: &[u8]) -> Option<Vec<u8>> {
    let chunks = [(CHUNK_JSON, Some(json)), (CHUNK_BIN, binary), (CHUNK_TABLE, Some(table))];
    let mut out = MAGIC.to_vec();
    out.extend([2u32, 0].map(u32::to_le_bytes).as_flattened());
    for (kind, data) in chunks {
        let Some(data) = data else { continue };
        let padded = data.len().next_multiple_of(4);
        out.extend(u32::try_from(padded).ok()?.to_le_bytes());
        out.extend(kind.to_le_bytes());
        out.extend(data);
        let fill = if kind == CHUNK_JSON { b' ' } else { 0 };
        out.resize(out.len() + padded - data.len(), fill);
    }
    let length = u32::try_from(out.len()).ok()?.to_le_bytes();
    out.get_mut(8..12)?.copy_from_slice(&length);
    Some(out)
}

/// Type, data and end of the chunk at `start`.
fn chunk<'a>(file: &str, body: &'a [u8], start: usize) -> Result<(u32, &'a [u8], usize)> {
    let place = || format!("{file}: chunk at byte {start}");
    let header = word(body, start).zip(word(body, start + 4));
    let (length, kind) = header.ok_or_else(|| SceneError::invalid(place(), "the chunk header is cut short"))?;
    if !length.is_multiple_of(4) {
        return Err(SceneError::invalid(place(), format!("the chunk's length {length} is not a multiple of 4")));
    }
    let begin = start + CHUNK_HEADER_BYTES;
    let end = begin.saturating_add(length as usize);
    let data = body.get(begin..end).ok_or_else(|| {
        let there = body.len().saturating_sub(begin);
        SceneError::invalid(place(), format!("the chunk says {length} bytes, there are {there}"))
    })?;
    Ok((kind, data, end))
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    let four = bytes.get(at..at.checked_add(4)?)?;
    Some(u32::from_le_bytes(four.try_into().ok()?))
}

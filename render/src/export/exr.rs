//! OpenEXR files: one part, scan lines, ZIP, the full window, 32-bit float; layers are channels called `layer.X`.
//!
//! Equal films and metadata give equal bytes: compression runs in parallel but chunks are written in order, and
//! attributes are sorted by name.

use super::ImageMetadata;
use crate::error::ImageError;
use crate::film::Film;
use ::exr::block::chunk::Chunk;
use ::exr::block::lines::LineRefMut;
use ::exr::block::writer::{ChunkWriter, ChunksWriter};
use ::exr::block::{BlockIndex, UncompressedBlock, writer};
use ::exr::error::{Error, Result as ExrResult};
use ::exr::meta::attribute::{AttributeValue, ChannelDescription, Chromaticities, SampleType, Text};
use ::exr::meta::header::{Header, LayerAttributes};
use ::exr::meta::{BlockDescription, MetaData};
use ::exr::prelude::{Compression, LineOrder, SmallVec, Vec2};
use rayon::prelude::*;
use std::io::{Cursor, Seek, Write};

/// Blocks compressed together before they are written: bounds the memory beside the file itself.
const BLOCKS_AT_ONCE: usize = 64;

/// The film as an OpenEXR file with `meta` as attributes (`gatherlight:…`).
///
/// # Errors
/// [`ImageError::Exr`] when the image is larger than the format can hold.
pub fn encode(film: &Film, meta: &ImageMetadata) -> Result<Vec<u8>, ImageError> {
    let layout = Layout::new(film);
    let mut bytes = Cursor::new(Vec::new());
    let headers = std::iter::once(header(film, meta, &layout)).collect();
    writer::write_chunks_with(&mut bytes, headers, true, |meta, chunks| write_blocks(film, &layout, &meta, chunks))
        .map_err(|e| ImageError::Exr(e.to_string()))?;
    let mut bytes = bytes.into_inner();
    sort_attributes(&mut bytes)
        .ok_or_else(|| ImageError::Exr("the header that was written cannot be read back".into()))?;
    Ok(bytes)
}

/// Channel order in the file (alphabetical, as the format demands) against that of the film.
struct Layout {
    names: Vec<String>,
    film_index: Vec<usize>,
}

impl Layout {
    fn new(film: &Film) -> Self {
        let mut order: Vec<(String, usize)> = film.channels.names().into_iter().zip(0..).collect();
        order.sort();
        let (names, film_index) = order.into_iter().unzip();
        Layout { names, film_index }
    }
}

fn text(s: &str) -> Text {
    // The crate thinks of Latin-1; the format's own readers take bytes, and UTF-8 is what they show.
    Text::from_bytes_unchecked(SmallVec::from_slice(s.as_bytes()))
}

fn header(film: &Film, meta: &ImageMetadata, layout: &Layout) -> Header {
    let size = Vec2(film.grid.width as usize, film.grid.height as usize);
    let channels = layout.names.iter().map(|n| ChannelDescription::named(text(n), SampleType::F32)).collect();
    let own = LayerAttributes {
        software_name: Some(text(&format!("Gatherlight {}", crate::VERSION))),
        other: meta.attributes().iter().map(|(n, v)| (text(n), AttributeValue::Text(text(v)))).collect(),
        ..Default::default()
    };
    let mut header = Header::new(text(""), size, channels)
        .with_encoding(Compression::ZIP16, BlockDescription::ScanLines, LineOrder::Increasing)
        .with_attributes(own);
    header.shared_attributes.chromaticities = Some(Chromaticities {
        red: Vec2(0.64, 0.33),
        green: Vec2(0.3, 0.6),
        blue: Vec2(0.15, 0.06),
        white: Vec2(0.3127, 0.329),
    });
    header
}

fn write_blocks<W: Write + Seek>(
    film: &Film,
    layout: &Layout,
    meta: &MetaData,
    chunks: &mut ChunkWriter<W>,
) -> ExrResult<()> {
    let blocks: Vec<(usize, BlockIndex)> = meta.enumerate_ordered_header_block_indices().collect();
    for group in blocks.chunks(BLOCKS_AT_ONCE) {
        let compressed: Vec<ExrResult<Chunk>> =
            group.par_iter().map(|&(_, block)| compress(film, layout, meta, block)).collect();
        for (&(index, _), chunk) in group.iter().zip(compressed) {
            chunks.write_chunk(index, chunk?)?;
        }
    }
    Ok(())
}

fn compress(film: &Film, layout: &Layout, meta: &MetaData, block: BlockIndex) -> ExrResult<Chunk> {
    let header = meta.headers.first().ok_or(Error::Invalid("no header".into()))?;
    let (stride, width) = (film.channels.len(), film.grid.width as usize);
    let fill = |line: LineRefMut<'_>| {
        let at = line.location;
        let channel = layout.film_index[at.channel];
        let first = (at.position.y() * width + at.position.x()) * stride + channel;
        for (bytes, value) in line.value.chunks_exact_mut(4).zip(film.pixels[first..].iter().step_by(stride)) {
            bytes.copy_from_slice(&value.to_ne_bytes());
        }
    };
    UncompressedBlock::from_lines(&header.channels, block, fill).compress_to_chunk(&meta.headers)
}

/// Puts the attributes of a single-part file into the order of their names: the crate keeps them in a hash map, whose
/// order differs from run to run. Lengths do not change, so the chunk offsets stay right.
fn sort_attributes(file: &mut [u8]) -> Option<()> {
    const START: usize = 8; // magic number and version
    let mut attributes: Vec<Vec<u8>> = Vec::new();
    let mut at = START;
    while *file.get(at)? != 0 {
        let rest = file.get(at..)?;
        let name = rest.iter().position(|&b| b == 0)? + 1;
        let kind = name + rest.get(name..)?.iter().position(|&b| b == 0)? + 1;
        let size = i32::from_le_bytes(rest.get(kind..kind + 4)?.try_into().ok()?);
        let end = kind + 4 + usize::try_from(size).ok()?;
        attributes.push(rest.get(..end)?.to_vec());
        at += end;
    }
    attributes.sort();
    file.get_mut(START..at)?.copy_from_slice(&attributes.concat());
    Some(())
}

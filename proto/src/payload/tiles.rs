//! Finished tiles ↔ bytes.
//!
//! Layout, little-endian: `GLTI`, version u32, channels u32, tile count u32; then per tile index u32, non_finite u64,
//! rays u64 and its floats. Lengths follow from the image's grid, so nothing a peer says decides an allocation. Damage
//! on the way is found by the digest that every payload carries (see [`crate::chunk`]).

use crate::error::WireError;
use crate::limits::MAX_RESULT_COUNT;
use bytes::{BufMut, BytesMut};
use gatherlight_render::film::{ChannelSet, Tile, TileGrid};
use gatherlight_render::photon::EmissionRange;
use gatherlight_render::settings::Layer;

const MAGIC: [u8; 4] = *b"GLTI";
const VERSION: u32 = 1;
const HEADER_BYTES: usize = 16;
const TILE_HEADER_BYTES: usize = 20;
const WHAT: &str = "tiles";

/// Encodes `tiles`, each pixel with `channels` floats.
pub fn encode(tiles: &[Tile], channels: usize) -> BytesMut {
    let floats: usize = tiles.iter().map(|t| t.pixels.len()).sum();
    let mut out = BytesMut::with_capacity(HEADER_BYTES + tiles.len() * TILE_HEADER_BYTES + floats * 4);
    out.put_slice(&MAGIC);
    out.put_u32_le(VERSION);
    out.put_u32_le(channels as u32);
    out.put_u32_le(tiles.len() as u32);
    for tile in tiles {
        out.put_u32_le(tile.index);
        out.put_u64_le(tile.non_finite);
        out.put_u64_le(tile.rays);
        tile.pixels.iter().for_each(|&v| out.put_f32_le(v));
    }
    out
}

/// Decodes the tiles `range` of an image cut by `grid`; also returns the bytes that follow.
///
/// # Errors
/// When they are not exactly those tiles, in order, with the right sizes, or a float is not finite that has to be.
pub fn decode<'b>(
    bytes: &'b [u8],
    range: EmissionRange,
    grid: TileGrid,
    channels: &ChannelSet,
) -> Result<(Vec<Tile>, &'b [u8]), WireError> {
    let mut reader = Reader { bytes };
    if reader.array::<4>()? != MAGIC {
        return Err(WireError::payload(WHAT, "does not start with GLTI"));
    }
    expect("version", u64::from(reader.u32()?), u64::from(VERSION))?;
    expect("channel count", u64::from(reader.u32()?), channels.len() as u64)?;
    expect("tile count", u64::from(reader.u32()?), range.len())?;
    if range.end > u64::from(grid.len()) {
        return Err(WireError::payload(WHAT, format!("tile {} is outside the image", range.end)));
    }
    let mut tiles = Vec::with_capacity(range.len() as usize);
    for index in range.first..range.end {
        expect("tile index", u64::from(reader.u32()?), index)?;
        let (non_finite, rays) = (reader.u64()?, reader.u64()?);
        WireError::check_limit(
            "samples or rays of a tile",
            non_finite.max(rays),
            MAX_RESULT_COUNT,
            "MAX_RESULT_COUNT",
        )?;
        let rect = grid.rect(index as u32).ok_or_else(|| WireError::payload(WHAT, "tile outside the image"))?;
        let pixels = reader.floats(rect.width as usize * rect.height as usize * channels.len())?;
        check_finite(&pixels, channels)?;
        tiles.push(Tile { index: index as u32, pixels, non_finite, rays });
    }
    Ok((tiles, reader.bytes))
}

/// A worker leaves samples that are not finite out and counts them, so a float that is not finite is a broken worker. Only the
/// depth of a pixel where nothing was hit is infinite.
fn check_finite(pixels: &[f32], channels: &ChannelSet) -> Result<(), WireError> {
    let depth = channels.offset(Layer::Depth);
    let fine = |(c, v): (usize, &f32)| v.is_finite() || (Some(c) == depth && *v == f32::INFINITY);
    match pixels.chunks_exact(channels.len()).all(|p| p.iter().enumerate().all(fine)) {
        true => Ok(()),
        false => Err(WireError::payload(WHAT, "holds a float that is not finite")),
    }
}

fn expect(what: &str, actual: u64, expected: u64) -> Result<(), WireError> {
    if actual == expected {
        return Ok(());
    }
    Err(WireError::payload(WHAT, format!("{what} is {actual}, expected {expected}")))
}

struct Reader<'a> {
    bytes: &'a [u8],
}

impl<'a> Reader<'a> {
    fn take(&mut self, n: usize) -> Result<&'a [u8], WireError> {
        let (head, rest) = self
            .bytes
            .split_at_checked(n)
            .ok_or_else(|| WireError::payload(WHAT, format!("ends {} bytes early", n - self.bytes.len())))?;
        self.bytes = rest;
        Ok(head)
    }
    fn array<const N: usize>(&mut self) -> Result<[u8; N], WireError> {
        let mut out = [0; N];
        out.copy_from_slice(self.take(N)?);
        Ok(out)
    }
    fn u32(&mut self) -> Result<u32, WireError> {
        self.array().map(u32::from_le_bytes)
    }
    fn u64(&mut self) -> Result<u64, WireError> {
        self.array().map(u64::from_le_bytes)
    }
    fn floats(&mut self, n: usize) -> Result<Vec<f32>, WireError> {
        let raw = self.take(n * 4)?;
        let floats: Vec<f32> = raw.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        Ok(floats)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: TileGrid = TileGrid { width: 40, height: 17 };
    const CHANNELS: usize = 5;

    fn channels() -> ChannelSet {
        ChannelSet::new(&[Layer::Depth])
    }

    fn tiles(range: EmissionRange) -> Vec<Tile> {
        (range.first as u32..range.end as u32)
            .map(|index| {
                let rect = GRID.rect(index).expect("in the grid");
                let n = rect.width as usize * rect.height as usize * CHANNELS;
                let pixels = (0..n).map(|i| (i as f32 - 3.5) * 1e-3 + index as f32).collect();
                Tile { index, pixels, non_finite: u64::from(index), rays: 1 << 40 }
            })
            .collect()
    }

    fn range(first: u64, end: u64) -> EmissionRange {
        EmissionRange { first, end }
    }

    #[test]
    fn round_trips_with_cropped_edge_tiles() {
        for r in [range(0, 6), range(2, 3), range(5, 6), range(4, 4)] {
            let encoded = encode(&tiles(r), CHANNELS);
            assert_eq!(decode(&encoded, r, GRID, &channels()), Ok((tiles(r), &[][..])));
        }
    }

    #[test]
    fn every_truncation_is_an_error_and_what_follows_is_left() {
        let encoded = encode(&tiles(range(5, 6)), CHANNELS);
        for n in 0..encoded.len() {
            assert!(decode(&encoded[..n], range(5, 6), GRID, &channels()).is_err(), "{n} bytes");
        }
        let longer = [&encoded[..], &[0]].concat();
        assert_eq!(decode(&longer, range(5, 6), GRID, &channels()), Ok((tiles(range(5, 6)), &[0][..])));
    }

    #[test]
    fn other_tiles_than_asked_for_are_errors() {
        let encoded = encode(&tiles(range(1, 3)), CHANNELS);
        for r in [range(0, 2), range(1, 2), range(1, 4), range(1, u64::MAX)] {
            assert!(decode(&encoded, r, GRID, &channels()).is_err(), "{r:?}");
        }
        assert!(decode(&encoded, range(1, 3), GRID, &ChannelSet::new(&[])).is_err());
    }

    #[test]
    fn a_float_that_is_not_finite_is_an_error_but_for_an_infinite_depth() {
        let mut bad = tiles(range(0, 1));
        let mut put = |at: usize, v: f32| {
            let before = std::mem::replace(&mut bad[0].pixels[at], v);
            let decoded = decode(&encode(&bad, CHANNELS), range(0, 1), GRID, &channels()).is_ok();
            bad[0].pixels[at] = before;
            decoded
        };
        assert!(!put(7, f32::NAN) && !put(7, f32::INFINITY));
        // The depth of nothing.
        assert!(put(9, f32::INFINITY) && !put(9, f32::NEG_INFINITY) && !put(9, f32::NAN));
    }
}

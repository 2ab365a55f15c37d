//! Sample maps ↔ bytes: the broadcast that tells how many samples each pixel takes.
//!
//! Layout, little-endian: `GLSM`, version u32, samples of the pilot u32; then a byte a pixel, row by row, or none where all pixels are
//! alike. The count follows from the image, which the receiver knows, so nothing a peer says decides an allocation.

use super::header::Reader;
use crate::error::WireError;
use bytes::{BufMut, Bytes, BytesMut};
use gatherlight_render::film::{SampleMap, TileGrid};

const MAGIC: [u8; 4] = *b"GLSM";
const VERSION: u32 = 1;
const HEADER_BYTES: usize = 12;
const WHAT: &str = "sample map";

/// Encodes `map`.
pub fn encode(map: &SampleMap) -> Bytes {
    let mut out = BytesMut::with_capacity(HEADER_BYTES + map.densities().len());
    out.put_slice(&MAGIC);
    out.put_u32_le(VERSION);
    out.put_u32_le(map.pilot());
    out.put_slice(map.densities());
    out.freeze()
}

/// Decodes the sample map of an image cut by `grid`.
///
/// # Errors
/// When it is none, or of another number of pixels.
pub fn decode(bytes: &[u8], grid: TileGrid) -> Result<SampleMap, WireError> {
    let reader = Reader::new(WHAT, bytes);
    reader.magic(MAGIC, VERSION)?;
    let pilot = u32::from_le_bytes(reader.array()?);
    let body = bytes.get(HEADER_BYTES..).unwrap_or_default();
    let pixels = u64::from(grid.width) * u64::from(grid.height);
    if !body.is_empty() {
        reader.expect("the number of its pixels", body.len() as u64, pixels)?;
    }
    Ok(SampleMap::new(pilot, body.to_vec()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: TileGrid = TileGrid { width: 3, height: 2 };

    #[test]
    fn round_trips() {
        for densities in [vec![], vec![0, 8, 32, 33, 200, 255]] {
            let map = SampleMap::new(16, densities);
            assert_eq!(decode(&encode(&map), GRID), Ok(map));
        }
    }

    #[test]
    fn maps_of_other_images_and_truncations_are_errors() {
        let encoded = encode(&SampleMap::new(8, vec![32; 6]));
        for n in (0..encoded.len()).filter(|&n| n != HEADER_BYTES) {
            assert!(decode(&encoded[..n], GRID).is_err(), "{n} bytes");
        }
        assert!(decode(&[&encoded[..], &[1]].concat(), GRID).is_err());
        assert!(decode(&encoded, TileGrid { width: 6, height: 2 }).is_err());
    }
}

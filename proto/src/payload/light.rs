//! Light images ↔ bytes: what a lease splatted, on its way to the exact sum.
//!
//! Layout, little-endian: `GLLI`, version u32, width u32, height u32, planes u32, quantum i32, non_finite u64, rays u64,
//! mutations 4 × u64 (large, accepted, small, accepted) and 2 × u128 (luminance of the large ones and its square), block count u32; a table with number u32 and length u32 of each block that something landed on, by number; then the
//! blocks. A block is a shift (u8), a bit for each of its pixels (row by row, the least bit of the first byte first), and
//! for each pixel whose bit is set its three sums without their `shift` least bits, zigzag and in groups of 7 bits, the
//! least first. Sums are 128 bits wide, but few are longer than a float's 24 bits and some carries, and many pixels are
//! black.
//!
//! Size, planes and quantum are those of the job, and every block is one of its grid: nothing a peer says decides an
//! allocation beyond the job's own light image. Damage on the way is found by the digest that every payload carries.

use super::header::Reader;
use crate::error::WireError;
use crate::limits::MAX_RESULT_COUNT;
use bytes::{BufMut, Bytes, BytesMut};
use gatherlight_render::film::LightImage;
use gatherlight_render::film::light_image::{BLOCK_VALUES, Mutations};
use rayon::prelude::*;

const MAGIC: [u8; 4] = *b"GLLI";
const VERSION: u32 = 2;
const HEADER_BYTES: usize = 108;
const ENTRY_BYTES: usize = 8;
const WHAT: &str = "light image";
/// Pixels of a block.
const PIXELS: usize = BLOCK_VALUES / 3;
/// Bytes before a block's sums: the shift and the pixels' bits.
const BLOCK_HEADER_BYTES: usize = 1 + PIXELS / 8;

/// Encodes `image`, in parallel on the current rayon pool.
pub fn encode(image: &LightImage) -> Bytes {
    let mut out = BytesMut::new();
    append(image, &mut out);
    out.freeze()
}

/// Encodes `image` behind what is in `out`.
pub fn append(image: &LightImage, out: &mut BytesMut) {
    let blocks: Vec<(u32, &[i128])> = image.blocks().collect();
    let encoded: Vec<Vec<u8>> = blocks.par_iter().map(|(_, values)| encode_block(values)).collect();
    let bytes: usize = encoded.iter().map(|b| b.len() + ENTRY_BYTES).sum();
    out.reserve(HEADER_BYTES + bytes);
    let grid = image.grid();
    out.put_slice(&MAGIC);
    [VERSION, grid.width, grid.height, image.planes()].into_iter().for_each(|v| out.put_u32_le(v));
    out.put_i32_le(image.quantum());
    out.put_u64_le(image.non_finite());
    out.put_u64_le(image.rays());
    let m = image.mutations();
    [m.large, m.large_accepted, m.small, m.small_accepted].into_iter().for_each(|v| out.put_u64_le(v));
    out.put_u128_le(m.large_luminance);
    out.put_u128_le(m.large_luminance_squared);
    out.put_u32_le(blocks.len() as u32);
    for ((number, _), bytes) in blocks.iter().zip(&encoded) {
        out.put_u32_le(*number);
        out.put_u32_le(bytes.len() as u32);
    }
    encoded.iter().for_each(|b| out.put_slice(b));
}

fn encode_block(values: &[i128]) -> Vec<u8> {
    let shift = values.iter().fold(0, |all, v| all | v).trailing_zeros() % 128;
    let mut out = vec![0; BLOCK_HEADER_BYTES];
    out[0] = shift as u8;
    for (i, pixel) in values.chunks_exact(3).enumerate() {
        if pixel.iter().all(|&v| v == 0) {
            continue;
        }
        out[1 + i / 8] |= 1 << (i % 8);
        for v in pixel {
            let v = v >> shift;
            let mut rest = ((v << 1) ^ (v >> 127)) as u128;
            while rest >= 0x80 {
                out.push(rest as u8 | 0x80);
                rest >>= 7;
            }
            out.push(rest as u8);
        }
    }
    out
}

/// Decodes a light image of the size, planes and quantum of `empty`, in parallel on the current rayon pool.
///
/// # Errors
/// When the bytes are not exactly such an image.
pub fn decode(bytes: &[u8], empty: &LightImage) -> Result<LightImage, WireError> {
    let damaged = |message: String| WireError::payload(WHAT, message);
    let reader = Reader::new(WHAT, bytes);
    let word = || reader.array().map(u32::from_le_bytes);
    reader.magic(MAGIC, VERSION)?;
    reader.expect("the width", word()?, empty.grid().width)?;
    reader.expect("the height", word()?, empty.grid().height)?;
    reader.expect("the number of planes", word()?, empty.planes())?;
    reader.expect("the quantum", i32::from_le_bytes(reader.array()?), empty.quantum())?;
    let long = || reader.array().map(u64::from_le_bytes);
    let (non_finite, rays) = (long()?, long()?);
    let (large, large_accepted, small, small_accepted) = (long()?, long()?, long()?, long()?);
    let large_luminance = u128::from_le_bytes(reader.array()?);
    let large_luminance_squared = u128::from_le_bytes(reader.array()?);
    let most = non_finite.max(rays).max(large).max(small);
    WireError::check_limit("splats, rays or mutations of a light image", most, MAX_RESULT_COUNT, "MAX_RESULT_COUNT")?;
    if large_accepted > large || small_accepted > small {
        return Err(damaged("more mutations accepted than made".into()));
    }
    let count = u64::from(word()?);
    let there = u64::from(empty.grid().len()) * u64::from(empty.planes());
    if count > there {
        return Err(damaged(format!("announces {count} blocks, the image has {there}")));
    }
    let table_end = HEADER_BYTES + count as usize * ENTRY_BYTES;
    let table = bytes.get(HEADER_BYTES..table_end).ok_or_else(|| damaged("ends within its table".into()))?;
    let blocks = cut(table, &bytes[table_end..]).map_err(damaged)?;
    let decoded: Vec<_> = blocks.par_iter().map(|&(n, b)| decode_block(b).map(|values| (n, values))).collect();
    let mut image = empty.clone();
    for block in decoded {
        let (number, values) = block.map_err(|m| damaged(m.into()))?;
        if !image.insert_block(number, values) {
            return Err(damaged(format!("block {number} is outside the image")));
        }
    }
    image.add_non_finite(non_finite);
    image.add_rays(rays);
    image.add_mutations(&Mutations {
        large,
        large_accepted,
        small,
        small_accepted,
        large_luminance,
        large_luminance_squared,
    });
    Ok(image)
}

/// Cuts `rest` into the blocks of `table`, whose numbers must rise.
fn cut<'a>(table: &[u8], mut rest: &'a [u8]) -> Result<Vec<(u32, &'a [u8])>, String> {
    let mut blocks: Vec<(u32, &[u8])> = Vec::with_capacity(table.len() / ENTRY_BYTES);
    for entry in table.as_chunks::<ENTRY_BYTES>().0 {
        let [a, b, c, d, e, f, g, h] = *entry;
        let (number, length) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]) as usize);
        if blocks.last().is_some_and(|&(last, _)| last >= number) {
            return Err(format!("block {number} is out of order"));
        }
        let (block, tail) =
            rest.split_at_checked(length).ok_or_else(|| format!("ends {} bytes early", length - rest.len()))?;
        blocks.push((number, block));
        rest = tail;
    }
    if !rest.is_empty() {
        return Err(format!("{} bytes follow the last block", rest.len()));
    }
    Ok(blocks)
}

fn decode_block(bytes: &[u8]) -> Result<Box<[i128]>, &'static str> {
    let (head, mut rest) = bytes.split_at_checked(BLOCK_HEADER_BYTES).ok_or("a block ends within its header")?;
    let shift = u32::from(head[0]);
    if shift > 127 {
        return Err("a block is shifted by more bits than a sum has");
    }
    let mut values: Box<[i128]> = vec![0; BLOCK_VALUES].into();
    for (i, pixel) in values.chunks_exact_mut(3).enumerate() {
        if head[1 + i / 8] >> (i % 8) & 1 == 0 {
            continue;
        }
        for v in pixel {
            let zigzag = varint(&mut rest)?;
            let value = (zigzag >> 1) as i128 ^ -((zigzag & 1) as i128);
            *v = value << shift;
            if *v >> shift != value {
                return Err("a sum is wider than 128 bits");
            }
        }
    }
    if rest.is_empty() { Ok(values) } else { Err("a block is longer than its pixels") }
}

fn varint(bytes: &mut &[u8]) -> Result<u128, &'static str> {
    let mut value = 0;
    for (i, &byte) in bytes.iter().enumerate() {
        let part = u128::from(byte & 0x7f);
        let shifted = part.checked_shl(7 * i as u32).filter(|s| s >> (7 * i) == part);
        value |= shifted.ok_or("a sum is wider than 128 bits")?;
        if byte < 0x80 {
            *bytes = &bytes[i + 1..];
            return Ok(value);
        }
    }
    Err("a block ends within a sum")
}

#[cfg(test)]
mod tests {
    use super::*;
    use gatherlight_render::film::TileGrid;
    use gatherlight_render::math::{Purpose, Rgb, Stream};

    const GRID: TileGrid = TileGrid { width: 40, height: 33 };

    fn empty() -> LightImage {
        LightImage::new(GRID, 2, 3.0)
    }

    /// Splats of very different size, both signs, on both planes.
    fn splatted(n: usize) -> LightImage {
        let mut s = Stream::new(3, Purpose::Test, 0, n as u64);
        let mut image = empty();
        for _ in 0..n {
            let [u, v] = s.next_2d();
            let m = f32::from_bits(((s.next_f32() * 100.0) as u32 + 60) << 23);
            let value = Rgb::new(m, m * s.next_f32(), -m * s.next_f32());
            image.splat(u32::from(s.next_f32() < 0.5), (u * 40.0) as u32, (v * v * 33.0) as u32, value);
        }
        image.add_rays(77);
        image.add_mutations(&Mutations {
            large: 9,
            large_accepted: 8,
            small: 70,
            small_accepted: 6,
            large_luminance: 1 << 100,
            large_luminance_squared: 1 << 90,
        });
        image
    }

    /// The extremes of what a sum can be.
    fn extreme() -> LightImage {
        let mut image = empty();
        let mut values = vec![0; BLOCK_VALUES];
        values[..6].copy_from_slice(&[i128::MAX, i128::MIN, -1, 1, 0, 1 << 100]);
        values[BLOCK_VALUES - 1] = -(1 << 90);
        assert!(image.insert_block(4, values.into()));
        // Nothing but zeros, and a lone sum with the sign's bit only.
        assert!(image.insert_block(5, vec![0; BLOCK_VALUES].into()));
        let mut values = vec![0; BLOCK_VALUES];
        values[7] = i128::MIN;
        assert!(image.insert_block(17, values.into()));
        image.add_non_finite(5);
        image
    }

    #[test]
    fn round_trips_exactly() {
        for image in [empty(), splatted(1), splatted(50), splatted(20_000), extreme()] {
            assert_eq!(decode(&encode(&image), &empty()), Ok(image));
        }
    }

    #[test]
    fn a_full_light_image_takes_less_than_ten_bytes_a_sum() {
        let image = splatted(200_000);
        let bytes = encode(&image).len() as f64 / (image.blocks().count() * BLOCK_VALUES) as f64;
        assert!(bytes < 10.0, "{bytes}");
    }

    #[test]
    fn every_truncation_and_extension_is_an_error() {
        for image in [empty(), splatted(50), extreme()] {
            let encoded = encode(&image);
            for n in 0..encoded.len() {
                assert!(decode(&encoded[..n], &empty()).is_err(), "{n} bytes");
            }
            assert!(decode(&[&encoded[..], &[0]].concat(), &empty()).is_err());
        }
    }

    #[test]
    fn images_of_another_job_are_errors_that_say_so() {
        let encoded = encode(&splatted(50));
        let say = |other: LightImage| decode(&encoded, &other).unwrap_err().to_string();
        let narrow = TileGrid { width: 39, ..GRID };
        assert_eq!(say(LightImage::new(narrow, 2, 3.0)), "light image: the width is 40, expected 39");
        assert_eq!(say(LightImage::new(GRID, 1, 3.0)), "light image: the number of planes is 2, expected 1");
        assert_eq!(say(LightImage::new(GRID, 2, 4.0)), "light image: the quantum is -55, expected -54");
    }

    #[test]
    fn counts_blocks_and_sums_beyond_their_bounds_are_errors() {
        let encoded = encode(&extreme());
        let say = |at: usize, bytes: &[u8]| {
            let mut forged = encoded.to_vec();
            forged[at..at + bytes.len()].copy_from_slice(bytes);
            decode(&forged, &empty()).unwrap_err().to_string()
        };
        assert!(say(24, &u64::MAX.to_le_bytes()).contains("MAX_RESULT_COUNT"));
        assert!(say(48, &7u64.to_le_bytes()).contains("more mutations accepted"));
        assert!(say(HEADER_BYTES - 4, &u32::MAX.to_le_bytes()).contains("the image has 18"));
        assert!(say(HEADER_BYTES + 8, &4u32.to_le_bytes()).contains("out of order"));
        assert!(say(HEADER_BYTES + 16, &18u32.to_le_bytes()).contains("outside the image"));
        assert!(say(HEADER_BYTES + 4, &u32::MAX.to_le_bytes()).contains("early"));
        let block = HEADER_BYTES + 3 * ENTRY_BYTES;
        assert!(say(block, &[128]).contains("shifted"));
        assert!(say(block, &[1]).contains("wider"));
        assert!(say(block + BLOCK_HEADER_BYTES, &[0xff; 19]).contains("wider"));
    }

    /// Bytes changed at random, as an attacker would: an error, or an image of the job's size; never a panic.
    #[test]
    fn hostile_bytes_are_errors_or_harmless_images() {
        let valid = encode(&splatted(60));
        let mut s = Stream::new(8, Purpose::Test, 0, 0);
        let (mut good, mut bad) = (0, 0);
        for _ in 0..20_000 {
            let mut bytes = valid.to_vec();
            for _ in 0..=s.next_u64() % 3 {
                let at = (s.next_u64() % bytes.len() as u64) as usize;
                bytes[at] = s.next_u64() as u8;
            }
            match decode(&bytes, &empty()) {
                Ok(image) => {
                    assert!(image.memory_bytes() <= 18 * LightImage::block_bytes());
                    assert_eq!(image.clone().add(&empty()), Ok(()));
                    good += 1;
                }
                Err(_) => bad += 1,
            }
            let random: Vec<u8> = (0..s.next_u64() % 300).map(|_| s.next_u64() as u8).collect();
            assert!(decode(&random, &empty()).is_err());
            assert!(decode(&[&valid[..HEADER_BYTES], &random].concat(), &empty()).is_err());
        }
        assert!(good > 1_000 && bad > 1_000, "{good} {bad}: both ways must be walked");
    }
}

//! Photons as columns of bit-packed groups: the coding that batches and maps share.
//!
//! Each of the 9 columns of photons (3 coordinates as ordered integers, 4 bytes of power, 2 of the normal) or 14 of light
//! vertices (besides 2 halves of the direction, 2 shares in the weights, the length) is cut into groups of [`GROUP`] photons; a group is its least value, the bits its range needs, and the
//! differences at that width (frame of reference: Goldstein, Ramakrishnan and Shaft 1998). Neighbours in tree order share high
//! bits, flat walls and single-coloured lamps whole values. Exact, and fast both ways without an entropy coder.
//!
//! Layout: blocks of [`BLOCK`] photons, so that both ends work in parallel; before them a table with the length of each. A group
//! is at least one byte a column and base long, which bounds what a length can make a reader allocate. Damage on the way is found
//! by the digest that travels beside every payload (see `chunk`), not again here.

use crate::error::WireError;
use gatherlight_render::photon::LightVertices;
use rayon::prelude::*;
use std::ops::Range;

/// Photons in a group.
const GROUP: usize = 64;
/// Photons in a block.
const BLOCK: usize = 1 << 16;
/// Bytes of a block's entry in the table: its length, u32.
pub(super) const ENTRY_BYTES: usize = 4;
/// Bytes of each column's values; the last five only of light vertices.
const COLUMN_BYTES: [usize; 14] = [4, 4, 4, 1, 1, 1, 1, 1, 1, 2, 2, 4, 4, 1];

fn columns(vertices: bool) -> &'static [usize] {
    if vertices { &COLUMN_BYTES } else { &COLUMN_BYTES[..9] }
}

/// Photons that can be encoded.
pub(super) trait Photons: Sync {
    fn len(&self) -> usize;
    fn vertices(&self) -> Option<&LightVertices>;
    /// Values of column `c` for photons `first` … into `out`, all of which exist.
    fn read(&self, c: usize, first: usize, out: &mut [u32]);
}

/// Decoded photons, structure of arrays.
#[derive(Debug, Default)]
pub(super) struct Arrays {
    pub(super) coordinates: [Vec<f32>; 3],
    pub(super) powers: Vec<u32>,
    pub(super) normals: Vec<u16>,
    pub(super) vertices: Option<LightVertices>,
}

/// Bits that order as finite floats do, so that near values are near integers.
#[inline(always)]
pub(super) fn ordered(v: f32) -> u32 {
    let bits = v.to_bits();
    bits ^ ((bits as i32 >> 31) as u32 | 0x8000_0000)
}

/// The inverse of [`ordered`].
#[inline(always)]
fn unordered(bits: u32) -> f32 {
    f32::from_bits(bits ^ (!(bits as i32 >> 31) as u32 | 0x8000_0000))
}

/// Column `c` ≥ 3 of photon `i` with the given packed fields.
#[inline(always)]
pub(super) fn packed_column(c: usize, i: usize, powers: &[u32], normals: &[u16], v: Option<&LightVertices>) -> u32 {
    let vertex = |get: &dyn Fn(&LightVertices) -> u32| v.map_or(0, get);
    match c {
        3..=6 => powers[i] >> (8 * (c - 3)) & 0xff,
        7 | 8 => u32::from(normals[i]) >> (8 * (c - 7)) & 0xff,
        9 | 10 => vertex(&|v| v.directions[i] >> (16 * (c - 9)) & 0xffff),
        // Bits of floats ≥ 0 order as the floats do.
        11 | 12 => vertex(&|v| v.shares[i][c - 11].to_bits()),
        _ => vertex(&|v| u32::from(v.lengths[i])),
    }
}

/// Appends table and blocks to `out`, which already holds the header.
pub(super) fn encode(photons: &impl Photons, out: &mut Vec<u8>) {
    let n = photons.len();
    let blocks: Vec<Vec<u8>> = (0..n.div_ceil(BLOCK))
        .into_par_iter()
        .map(|b| {
            let mut bytes = Vec::new();
            let end = n.min((b + 1) * BLOCK);
            for first in (b * BLOCK..end).step_by(GROUP) {
                encode_group(photons, first, end.min(first + GROUP), &mut bytes);
            }
            bytes
        })
        .collect();
    out.reserve_exact(blocks.iter().map(|b| b.len() + ENTRY_BYTES).sum());
    for block in &blocks {
        out.extend_from_slice(&(block.len() as u32).to_le_bytes());
    }
    for block in blocks {
        out.extend_from_slice(&block);
    }
}

fn encode_group(photons: &impl Photons, first: usize, end: usize, out: &mut Vec<u8>) {
    let mut values = [0u32; GROUP];
    let values = &mut values[..end - first];
    for (c, &bytes) in columns(photons.vertices().is_some()).iter().enumerate() {
        photons.read(c, first, values);
        let (least, greatest) = values.iter().fold((u32::MAX, 0), |(a, b), &v| (a.min(v), b.max(v)));
        let width = 32 - (greatest - least).leading_zeros();
        out.extend_from_slice(&least.to_le_bytes()[..bytes]);
        out.push(width as u8);
        let (mut pending, mut filled) = (0u64, 0);
        for &v in values.iter() {
            pending |= u64::from(v - least) << filled;
            filled += width;
            if filled >= 32 {
                out.extend_from_slice(&(pending as u32).to_le_bytes());
                pending >>= 32;
                filled -= 32;
            }
        }
        out.extend_from_slice(&pending.to_le_bytes()[..filled.div_ceil(8) as usize]);
    }
}

/// Reads what [`encode`] wrote: `all` is the whole payload, whose first `header` bytes are already understood.
pub(super) fn decode(
    what: &'static str,
    all: &[u8],
    header: usize,
    count: u64,
    vertices: bool,
) -> Result<Arrays, WireError> {
    let damaged = |message: String| WireError::payload(what, message);
    // Every group holds at least its bases and widths.
    let group_bytes = columns(vertices).iter().map(|b| b + 1).sum::<usize>() as u64;
    if count.div_ceil(GROUP as u64).saturating_mul(group_bytes) > all.len() as u64 {
        return Err(damaged(format!("announces {count} photons in {} bytes", all.len())));
    }
    let n = count as usize;
    let table_end = header + n.div_ceil(BLOCK) * ENTRY_BYTES;
    let (Some(table), Some(mut rest)) = (all.get(header..table_end), all.get(table_end..)) else {
        return Err(damaged("ends within its table".into()));
    };
    let mut blocks = Vec::with_capacity(n.div_ceil(BLOCK));
    for entry in table.as_chunks::<ENTRY_BYTES>().0 {
        let length = u32::from_le_bytes(*entry) as usize;
        let Some((block, tail)) = rest.split_at_checked(length) else {
            return Err(damaged(format!("ends {} bytes early", length - rest.len())));
        };
        blocks.push(block);
        rest = tail;
    }
    if !rest.is_empty() {
        return Err(damaged(format!("{} bytes follow the last photon", rest.len())));
    }
    decode_blocks(n, vertices, &blocks).map_err(|m| damaged(m.into()))
}

/// Where one block's photons go.
struct Target<'a> {
    coordinates: [&'a mut [f32]; 3],
    powers: &'a mut [u32],
    normals: &'a mut [u16],
    vertices: Option<VertexTarget<'a>>,
}

/// The part of a [`Target`] that only light vertices have.
struct VertexTarget<'a> {
    directions: &'a mut [u32],
    shares: &'a mut [[f32; 2]],
    lengths: &'a mut [u8],
}

fn decode_blocks(n: usize, vertices: bool, blocks: &[&[u8]]) -> Result<Arrays, &'static str> {
    let mut arrays = Arrays {
        coordinates: [vec![0.0; n], vec![0.0; n], vec![0.0; n]],
        powers: vec![0; n],
        normals: vec![0; n],
        vertices: vertices.then(|| LightVertices {
            directions: vec![0; n],
            shares: vec![[0.0; 2]; n],
            lengths: vec![0; n],
        }),
    };
    let [x, y, z] = &mut arrays.coordinates;
    let (mut x, mut y, mut z) = (x.chunks_mut(BLOCK), y.chunks_mut(BLOCK), z.chunks_mut(BLOCK));
    let (mut powers, mut normals) = (arrays.powers.chunks_mut(BLOCK), arrays.normals.chunks_mut(BLOCK));
    let mut vertices = arrays
        .vertices
        .as_mut()
        .map(|v| v.directions.chunks_mut(BLOCK).zip(v.shares.chunks_mut(BLOCK)).zip(v.lengths.chunks_mut(BLOCK)));
    let mut work = Vec::with_capacity(blocks.len());
    for &block in blocks {
        let (Some(x), Some(y), Some(z), Some(powers), Some(normals)) =
            (x.next(), y.next(), z.next(), powers.next(), normals.next())
        else {
            return Err("has more blocks than photons");
        };
        let vertices = vertices.as_mut().and_then(Iterator::next);
        let vertices = vertices.map(|((directions, shares), lengths)| VertexTarget { directions, shares, lengths });
        work.push((block, Target { coordinates: [x, y, z], powers, normals, vertices }));
    }
    work.into_par_iter().try_for_each(|(block, mut target)| decode_block(block, &mut target))?;
    Ok(arrays)
}

fn decode_block(mut bytes: &[u8], target: &mut Target<'_>) -> Result<(), &'static str> {
    let n = target.powers.len();
    let columns = columns(target.vertices.is_some());
    let mut values = [0u32; GROUP];
    for first in (0..n).step_by(GROUP) {
        let count = GROUP.min(n - first);
        for (c, &width) in columns.iter().enumerate() {
            bytes = decode_column(bytes, width, &mut values[..count])?;
            target.store(c, first, &values[..count])?;
        }
    }
    if bytes.is_empty() { Ok(()) } else { Err("a block is longer than its photons") }
}

/// Decodes one column of a group into `values`; returns what follows it.
fn decode_column<'a>(bytes: &'a [u8], base_bytes: usize, values: &mut [u32]) -> Result<&'a [u8], &'static str> {
    const SHORT: &str = "a block is shorter than its photons";
    let (head, rest) = bytes.split_at_checked(base_bytes + 1).ok_or(SHORT)?;
    let mut base = [0; 4];
    base[..base_bytes].copy_from_slice(&head[..base_bytes]);
    let base = u32::from_le_bytes(base);
    let width = usize::from(head[base_bytes]);
    if width > 8 * base_bytes {
        return Err("a group is wider than its column");
    }
    let (packed, rest) = rest.split_at_checked((values.len() * width).div_ceil(8)).ok_or(SHORT)?;
    // Padded, so that each value loads as a whole word.
    let mut words = [0u8; GROUP * 4 + 8];
    words[..packed.len()].copy_from_slice(packed);
    let mask = (1u64 << width) - 1;
    let mut greatest = 0;
    for (i, value) in values.iter_mut().enumerate() {
        let bit = i * width;
        let word = words[bit / 8..].first_chunk::<8>().map_or(0, |w| u64::from_le_bytes(*w));
        let sum = u64::from(base) + (word >> (bit % 8) & mask);
        greatest = sum.max(greatest);
        *value = sum as u32;
    }
    if greatest >> (8 * base_bytes) != 0 {
        return Err("a value exceeds its column");
    }
    Ok(rest)
}

impl Target<'_> {
    /// Puts the values of column `c` of photons from `first` on in their place.
    fn store(&mut self, c: usize, first: usize, values: &[u32]) -> Result<(), &'static str> {
        let range = first..first + values.len();
        match c {
            0..=2 => {
                let mut finite = true;
                for (to, &v) in self.coordinates[c][range].iter_mut().zip(values) {
                    *to = unordered(v);
                    finite &= to.is_finite();
                }
                return if finite { Ok(()) } else { Err("a position is not finite") };
            }
            3..=6 => self.powers[range].iter_mut().zip(values).for_each(|(to, v)| *to |= v << (8 * (c - 3))),
            7 | 8 => self.normals[range].iter_mut().zip(values).for_each(|(to, v)| *to |= (v << (8 * (c - 7))) as u16),
            _ => {
                if let Some(vertices) = &mut self.vertices {
                    return vertices.store(c, range, values);
                }
            }
        }
        Ok(())
    }
}

impl VertexTarget<'_> {
    fn store(&mut self, c: usize, range: Range<usize>, values: &[u32]) -> Result<(), &'static str> {
        match c {
            9 | 10 => self.directions[range].iter_mut().zip(values).for_each(|(to, v)| *to |= v << (16 * (c - 9))),
            11 | 12 => {
                let mut sound = true;
                for (to, &v) in self.shares[range].iter_mut().zip(values) {
                    let share = f32::from_bits(v);
                    sound &= share.is_finite() && share >= 0.0;
                    to[c - 11] = share;
                }
                return if sound { Ok(()) } else { Err("a share in the weights is negative or not finite") };
            }
            _ => self.lengths[range].iter_mut().zip(values).for_each(|(to, &v)| *to = v as u8),
        }
        Ok(())
    }
}

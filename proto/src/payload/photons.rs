//! Photon batches ↔ bytes.
//!
//! Layout, little-endian: `GLPB`, version u32, flags u32 (1: light vertices, with directions), first path u64, end path u64, photons u64, photons left
//! out because they were not finite u64; then
//! the photons (see `columns`). Order is kept.

use super::columns::{self, Photons, ordered, packed_column};
use super::header::Reader;
use crate::error::WireError;
use crate::limits::{MAX_BATCH_PHOTONS, MAX_RESULT_COUNT};
use bytes::Bytes;
use gatherlight_render::photon::{EmissionRange, LightVertices, PhotonBatch};

const MAGIC: [u8; 4] = *b"GLPB";
const VERSION: u32 = 2;
const HEADER_BYTES: usize = 44;
const DIRECTIONS: u32 = 1;
const WHAT: &str = "photon batch";

impl Photons for PhotonBatch {
    fn len(&self) -> usize {
        self.positions.len()
    }
    fn vertices(&self) -> Option<&LightVertices> {
        self.vertices.as_ref()
    }
    fn read(&self, c: usize, first: usize, out: &mut [u32]) {
        for (i, out) in (first..).zip(out) {
            *out = match c {
                0..=2 => ordered(self.positions[i][c]),
                _ => packed_column(c, i, &self.powers, &self.normals, self.vertices.as_ref()),
            };
        }
    }
}

/// Encodes a batch, in parallel on the current rayon pool. Its arrays must have equal lengths.
pub fn encode_batch(batch: &PhotonBatch) -> Bytes {
    let mut out = Vec::with_capacity(HEADER_BYTES);
    out.extend_from_slice(&MAGIC);
    out.extend_from_slice(&VERSION.to_le_bytes());
    out.extend_from_slice(&(if batch.vertices.is_some() { DIRECTIONS } else { 0 }).to_le_bytes());
    out.extend_from_slice(&batch.range.first.to_le_bytes());
    out.extend_from_slice(&batch.range.end.to_le_bytes());
    out.extend_from_slice(&(batch.len() as u64).to_le_bytes());
    out.extend_from_slice(&batch.non_finite.to_le_bytes());
    columns::encode(batch, &mut out);
    Bytes::from(out)
}

/// Decodes the batch of the paths `range`, of light vertices (which have directions) or photons as `directions` says.
///
/// # Errors
/// When the bytes are malformed, or are another batch than asked for, or hold more than [`MAX_BATCH_PHOTONS`]. Allocates at most
/// about 60 times the bytes given.
pub fn decode_batch(bytes: &[u8], range: EmissionRange, directions: bool) -> Result<PhotonBatch, WireError> {
    let reader = Reader::new(WHAT, bytes);
    reader.magic(MAGIC, VERSION)?;
    reader.expect("the flag word", u32::from_le_bytes(reader.array()?), if directions { DIRECTIONS } else { 0 })?;
    reader.expect("the first path", u64::from_le_bytes(reader.array()?), range.first)?;
    reader.expect("the end path", u64::from_le_bytes(reader.array()?), range.end)?;
    let count = u64::from_le_bytes(reader.array()?);
    WireError::check_limit("photons of a batch", count, MAX_BATCH_PHOTONS, "MAX_BATCH_PHOTONS")?;
    let non_finite = u64::from_le_bytes(reader.array()?);
    WireError::check_limit("photons that are not finite", non_finite, MAX_RESULT_COUNT, "MAX_RESULT_COUNT")?;
    let arrays = columns::decode(WHAT, bytes, HEADER_BYTES, count, directions)?;
    let [x, y, z] = &arrays.coordinates;
    let positions = x.iter().zip(y).zip(z).map(|((&x, &y), &z)| [x, y, z]).collect();
    let columns::Arrays { powers, normals, vertices, .. } = arrays;
    Ok(PhotonBatch { range, positions, powers, normals, vertices, non_finite })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::payload::fuzz;

    const RANGE: EmissionRange = EmissionRange { first: 1 << 33, end: (1 << 33) + 5000 };

    fn batch(n: usize, directions: bool) -> PhotonBatch {
        let a = fuzz::photons(n, directions);
        let positions = (0..n).map(|i| [a.coordinates[0][i], a.coordinates[1][i], a.coordinates[2][i]]).collect();
        PhotonBatch {
            range: RANGE,
            positions,
            powers: a.powers,
            normals: a.normals,
            vertices: a.vertices,
            non_finite: 5,
        }
    }

    #[test]
    fn round_trips_bit_for_bit() {
        for n in [0, 1, 63, 64, 65, 1000, 65_535, 65_536, 65_537, 140_000] {
            for directions in [false, true] {
                let b = batch(n, directions);
                let decoded = decode_batch(&encode_batch(&b), RANGE, directions).unwrap();
                let bits = |b: &PhotonBatch| b.positions.iter().map(|p| p.map(f32::to_bits)).collect::<Vec<_>>();
                assert_eq!(bits(&decoded), bits(&b));
                assert_eq!(decoded, b);
            }
        }
    }

    #[test]
    fn cut_and_made_up_bytes_are_errors_and_never_a_panic() {
        let b = batch(700, true);
        assert_eq!(decode_batch(&encode_batch(&b), RANGE, true), Ok(b.clone()));
        fuzz::damage(&encode_batch(&b), |bytes| decode_batch(bytes, RANGE, true).map(drop));
    }

    #[test]
    fn changed_bytes_are_errors_or_other_photons_and_never_a_panic() {
        let b = batch(700, true);
        fuzz::forge(&encode_batch(&b), HEADER_BYTES, |bytes| decode_batch(bytes, RANGE, true).map(drop));
    }

    #[test]
    fn another_batch_than_asked_for_is_an_error_that_says_so() {
        let bytes = encode_batch(&batch(10, false));
        let say = |range, directions| decode_batch(&bytes, range, directions).unwrap_err().to_string();
        let other = EmissionRange { first: 0, end: 5000 };
        assert_eq!(say(other, false), "photon batch: the first path is 8589934592, expected 0");
        assert_eq!(say(RANGE, true), "photon batch: the flag word is 0, expected 1");
        let mut huge = bytes.to_vec();
        huge[28..36].copy_from_slice(&u64::MAX.to_le_bytes());
        let message = decode_batch(&huge, RANGE, false).unwrap_err().to_string();
        assert!(message.contains("over the limit of 33554432 (MAX_BATCH_PHOTONS)"), "{message}");
        huge[28..36].copy_from_slice(&1_000_000u64.to_le_bytes());
        let message = decode_batch(&huge, RANGE, false).unwrap_err().to_string();
        assert!(message.contains("announces 1000000 photons in"), "{message}");
    }

    #[test]
    fn a_share_that_is_negative_or_not_finite_is_an_error() {
        for bad in [-1.0, f32::NAN, f32::INFINITY] {
            let mut b = batch(100, true);
            b.vertices.as_mut().unwrap().shares[70][1] = bad;
            let message = decode_batch(&encode_batch(&b), RANGE, true).unwrap_err().to_string();
            assert_eq!(message, "photon batch: a share in the weights is negative or not finite");
        }
    }

    #[test]
    fn a_position_that_is_not_finite_is_an_error() {
        let mut b = batch(100, false);
        b.positions[70][1] = f32::INFINITY;
        let message = decode_batch(&encode_batch(&b), RANGE, false).unwrap_err().to_string();
        assert_eq!(message, "photon batch: a position is not finite");
    }
}

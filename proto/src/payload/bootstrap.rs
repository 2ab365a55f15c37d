//! Luminances of bootstrap paths ↔ bytes: the result of a bootstrap lease, and the broadcast of all of them.
//!
//! Layout, little-endian: `GLBW`, version u32, first path u64, end path u64; then a float a path, the same NaN for all that are not
//! finite. The count follows from the range, which the receiver knows, so nothing a peer says decides an allocation.

use super::header::Reader;
use crate::error::WireError;
use crate::limits::MAX_BOOTSTRAP_PATHS;
use bytes::{BufMut, Bytes, BytesMut};
use gatherlight_render::photon::EmissionRange;

const MAGIC: [u8; 4] = *b"GLBW";
const VERSION: u32 = 2;
/// Of all values that are not finite the one that is sent.
const NOT_FINITE: f32 = f32::NAN;
const HEADER_BYTES: usize = 24;
const WHAT: &str = "bootstrap";

/// Encodes the luminances of the paths `range`, in order; one that is negative counts as 0, as it does in
/// [`gatherlight_render::integrator::Bootstrap`].
pub fn encode(range: EmissionRange, luminances: &[f32]) -> Bytes {
    let mut out = BytesMut::with_capacity(HEADER_BYTES + luminances.len() * 4);
    out.put_slice(&MAGIC);
    out.put_u32_le(VERSION);
    out.put_u64_le(range.first);
    out.put_u64_le(range.end);
    let sent = |l: f32| if !l.is_finite() { NOT_FINITE } else { l.max(0.0).abs() };
    luminances.iter().for_each(|&l| out.put_f32_le(sent(l)));
    out.freeze()
}

/// Decodes the luminances of the paths `range`.
///
/// # Errors
/// When they are those of other paths, are not exactly as many, or one is negative, infinite or another NaN than is sent.
pub fn decode(bytes: &[u8], range: EmissionRange) -> Result<Vec<f32>, WireError> {
    let reader = Reader::new(WHAT, bytes);
    reader.magic(MAGIC, VERSION)?;
    reader.expect("the first path", u64::from_le_bytes(reader.array()?), range.first)?;
    reader.expect("the end path", u64::from_le_bytes(reader.array()?), range.end)?;
    WireError::check_limit("paths of a bootstrap", range.len(), MAX_BOOTSTRAP_PATHS, "MAX_BOOTSTRAP_PATHS")?;
    let body = bytes.get(HEADER_BYTES..).unwrap_or_default();
    reader.expect("the length of its luminances in bytes", body.len() as u64, range.len() * 4)?;
    let luminances: Vec<f32> = body.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    let is_sent = |l: &f32| l.is_finite() && l.is_sign_positive() || l.to_bits() == NOT_FINITE.to_bits();
    if !luminances.iter().all(is_sent) {
        return Err(WireError::payload(WHAT, "holds a luminance that is negative or not finite"));
    }
    Ok(luminances)
}

#[cfg(test)]
mod tests {
    use super::*;

    const RANGE: EmissionRange = EmissionRange { first: 1 << 33, end: (1 << 33) + 5 };
    const GOOD: [f32; 5] = [0.0, 1.5, 1e-40, f32::MAX, 3.0];

    #[test]
    fn round_trips_bit_for_bit() {
        let bits = |l: &[f32]| l.iter().map(|l| l.to_bits()).collect::<Vec<_>>();
        assert_eq!(decode(&encode(RANGE, &GOOD), RANGE).map(|l| bits(&l)), Ok(bits(&GOOD)));
        let none = EmissionRange { first: 3, end: 3 };
        assert_eq!(decode(&encode(none, &[]), none), Ok(vec![]));
    }

    #[test]
    fn what_is_no_luminance_has_one_form_when_sent_and_is_refused_in_others() {
        let bad = [-f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, -0.0];
        let sent = encode(RANGE, &bad);
        let received: Vec<u32> = decode(&sent, RANGE).unwrap().iter().map(|l| l.to_bits()).collect();
        assert_eq!(received, [NOT_FINITE, NOT_FINITE, NOT_FINITE, 0.0, 0.0].map(f32::to_bits));
        for b in bad {
            let mut forged = sent.to_vec();
            forged[HEADER_BYTES + 8..HEADER_BYTES + 12].copy_from_slice(&b.to_le_bytes());
            assert!(decode(&forged, RANGE).is_err(), "{b}");
        }
    }

    #[test]
    fn every_truncation_and_extension_is_an_error() {
        let encoded = encode(RANGE, &GOOD);
        for n in 0..encoded.len() {
            assert!(decode(&encoded[..n], RANGE).is_err(), "{n} bytes");
        }
        assert!(decode(&[&encoded[..], &[0; 4]].concat(), RANGE).is_err());
    }

    #[test]
    fn other_paths_than_asked_for_are_errors() {
        let encoded = encode(RANGE, &GOOD);
        for (first, end) in [(0, 5), (RANGE.first, RANGE.end - 1), (RANGE.first - 1, RANGE.end), (0, u64::MAX)] {
            assert!(decode(&encoded, EmissionRange { first, end }).is_err());
        }
        let all = EmissionRange { first: 0, end: u64::MAX };
        let message = decode(&encode(all, &[]), all).unwrap_err().to_string();
        assert!(message.contains("MAX_BOOTSTRAP_PATHS"), "{message}");
    }
}

//! Test photons, and damage of every kind done to payloads.

use super::columns::{Arrays, ENTRY_BYTES};
use crate::error::WireError;
use gatherlight_render::math::{Purpose, Stream};
use gatherlight_render::photon::LightVertices;

/// Photons on floor and wall of a room with a dense spot, of three colours; or light `vertices` with random columns.
pub(super) fn photons(n: usize, vertices: bool) -> Arrays {
    let mut s = Stream::new(5, Purpose::Test, 0, n as u64);
    let mut a = Arrays { vertices: vertices.then(LightVertices::default), ..Arrays::default() };
    for i in 0..n {
        let [u, v] = s.next_2d().map(|c| 2.0 * c - 1.0);
        let (p, normal) = match i % 4 {
            0 | 1 => ([u, -0.9, v], 0x80ff),
            2 => ([-0.7, u, v], 0xff80),
            _ => ([u * 0.01, -0.9, v * 0.01 + 0.3], 0x80ff),
        };
        for (axis, c) in a.coordinates.iter_mut().zip(p) {
            axis.push(c);
        }
        a.powers.push([0x7f80_8080, 0x7d80_4020, 0x7c00_ff00][i % 3] ^ (s.next_u64() & 0x0003_0303) as u32);
        a.normals.push(normal);
        if let Some(v) = &mut a.vertices {
            v.directions.push(s.next_u64() as u32);
            v.shares.push([3.0 * s.next_f32(), s.next_f32() * s.next_f32()]);
            v.lengths.push(1 + (s.next_u64() % 5) as u8);
        }
    }
    a
}

/// Cuts and extends `valid`, and makes up bytes; `decode` must give an error.
pub(super) fn damage(valid: &[u8], decode: impl Fn(&[u8]) -> Result<(), WireError>) {
    assert!(decode(valid).is_ok());
    for n in 0..valid.len() {
        assert!(decode(&valid[..n]).is_err(), "cut to {n} bytes");
    }
    assert!(decode(&[valid, &[0]].concat()).is_err());
    let mut s = Stream::new(6, Purpose::Test, 0, 0);
    for _ in 0..4000 {
        let random: Vec<u8> = (0..s.next_u64() % 300).map(|_| s.next_u64() as u8).collect();
        assert!(decode(&random).is_err());
        let headed = [&valid[..60], &random].concat();
        assert!(decode(&headed).is_err());
    }
}

/// Changes `valid` at random, sometimes cuts its only block and makes its length right again, as an attacker would. `decode` must
/// come back, with an error or not.
pub(super) fn forge(valid: &[u8], header: usize, decode: impl Fn(&[u8]) -> Result<(), WireError>) {
    let block = header + ENTRY_BYTES;
    let mut s = Stream::new(7, Purpose::Test, 0, 0);
    let (mut good, mut bad) = (0, 0);
    for round in 0..4000 {
        let mut bytes = valid.to_vec();
        // Headers are short: every other round is for them.
        let first = if round % 2 == 0 { 0 } else { block };
        for _ in 0..=s.next_u64() % 3 {
            let at = first + (s.next_u64() % (bytes.len() - first) as u64) as usize;
            bytes[at] = s.next_u64() as u8;
        }
        if round % 4 == 0 {
            bytes.truncate(block + (s.next_u64() % (bytes.len() - block) as u64) as usize);
        }
        if round % 8 != 0 {
            let length = (bytes.len() - block) as u32;
            bytes[header..block].copy_from_slice(&length.to_le_bytes());
        }
        match decode(&bytes) {
            Ok(()) => good += 1,
            Err(_) => bad += 1,
        }
    }
    assert!(good > 100 && bad > 100, "{good} {bad}: both ways must be walked");
}

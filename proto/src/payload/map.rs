//! Photon maps ↔ bytes: the broadcast of the finished map.
//!
//! Layout, little-endian: `GLPM`, version u32, flags u32 (1: light vertices, with directions, 2: caustic), emitted count u64, photons u64; then
//! the photons in tree order (see `columns`). The receiver computes the tree's boxes anew, in linear time, and gets
//! the very tree that was sent.

use super::columns::{self, Photons, ordered, packed_column};
use super::header::Reader;
use crate::error::WireError;
use bytes::Bytes;
use gatherlight_render::photon::kdtree::MAX_TREE_PHOTONS;
use gatherlight_render::photon::map::{MapParts, PhotonMap};
use gatherlight_render::photon::{LightVertices, MapKind};

const MAGIC: [u8; 4] = *b"GLPM";
const VERSION: u32 = 2;
const HEADER_BYTES: usize = 28;
const DIRECTIONS: u32 = 1;
const CAUSTIC: u32 = 2;
const WHAT: &str = "photon map";

impl Photons for PhotonMap {
    fn len(&self) -> usize {
        self.stored_count()
    }
    fn vertices(&self) -> Option<&LightVertices> {
        PhotonMap::vertices(self)
    }
    fn read(&self, c: usize, first: usize, out: &mut [u32]) {
        if c < 3 {
            let values = &self.tree().coordinates(c)[first..first + out.len()];
            out.iter_mut().zip(values).for_each(|(out, &v)| *out = ordered(v));
            return;
        }
        let (powers, normals, vertices) = (self.packed_powers(), self.packed_normals(), PhotonMap::vertices(self));
        for (i, out) in (first..).zip(out) {
            *out = packed_column(c, i, powers, normals, vertices);
        }
    }
}

fn flags(kind: MapKind, directions: bool) -> u32 {
    (if directions { DIRECTIONS } else { 0 }) | (if kind == MapKind::Caustic { CAUSTIC } else { 0 })
}

/// Encodes a map, in parallel on the current rayon pool. Some 11 bytes a photon, 23 a light vertex.
pub fn encode_map(map: &PhotonMap) -> Bytes {
    let mut out = Vec::with_capacity(HEADER_BYTES);
    out.extend_from_slice(&MAGIC);
    out.extend_from_slice(&VERSION.to_le_bytes());
    out.extend_from_slice(&flags(map.kind(), PhotonMap::vertices(map).is_some()).to_le_bytes());
    out.extend_from_slice(&map.emitted_count().to_le_bytes());
    out.extend_from_slice(&(map.stored_count() as u64).to_le_bytes());
    columns::encode(map, &mut out);
    Bytes::from(out)
}

/// Decodes the map of `kind` and rebuilds its tree, in parallel on the current rayon pool.
///
/// # Errors
/// When the bytes are malformed, are another kind of map, or hold more than `max_photons`. Allocates at most about 60 times the
/// bytes given.
pub fn decode_map(bytes: &[u8], kind: MapKind, max_photons: u64) -> Result<PhotonMap, WireError> {
    let reader = Reader::new(WHAT, bytes);
    reader.magic(MAGIC, VERSION)?;
    let actual = u32::from_le_bytes(reader.array()?);
    let directions = actual & DIRECTIONS != 0;
    reader.expect("the flag word", actual, flags(kind, directions))?;
    let emitted_count = u64::from_le_bytes(reader.array()?);
    let count = u64::from_le_bytes(reader.array()?);
    WireError::check_limit("photons of a map", count, max_photons, "max_photons")?;
    WireError::check_limit("photons of a map", count, MAX_TREE_PHOTONS as u64, "MAX_TREE_PHOTONS")?;
    let columns::Arrays { coordinates, powers, normals, vertices } =
        columns::decode(WHAT, bytes, HEADER_BYTES, count, directions)?;
    let parts = MapParts { kind, emitted_count, coordinates, powers, normals, vertices };
    PhotonMap::from_parts(parts).map_err(|e| WireError::payload(WHAT, e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::payload::fuzz;
    use gatherlight_render::photon::{EmissionRange, PhotonBatch};

    const MAX: u64 = 1 << 20;

    fn map(n: usize, directions: bool) -> PhotonMap {
        let a = fuzz::photons(n, directions);
        let positions = (0..n).map(|i| [a.coordinates[0][i], a.coordinates[1][i], a.coordinates[2][i]]).collect();
        let range = EmissionRange { first: 0, end: 12_345 };
        let batch =
            PhotonBatch { range, positions, powers: a.powers, normals: a.normals, vertices: a.vertices, non_finite: 0 };
        PhotonMap::build(MapKind::Caustic, batch)
    }

    #[test]
    fn round_trips_with_the_same_tree() {
        for n in [0, 1, 64, 65, 3000, 70_000] {
            for directions in [false, true] {
                let m = map(n, directions);
                let again = decode_map(&encode_map(&m), MapKind::Caustic, MAX).unwrap();
                assert_eq!(again.tree(), m.tree());
                assert_eq!(again.digest(), m.digest());
                assert_eq!(encode_map(&again), encode_map(&m));
            }
        }
    }

    #[test]
    fn a_map_of_surface_photons_takes_at_most_15_bytes_a_photon_and_30_a_light_vertex() {
        for (directions, limit) in [(false, 15.0), (true, 30.0)] {
            let n = 200_000;
            let bytes = encode_map(&map(n, directions)).len() as f64 / n as f64;
            assert!(bytes <= limit, "{bytes}");
        }
    }

    #[test]
    fn cut_and_made_up_bytes_are_errors_and_never_a_panic() {
        fuzz::damage(&encode_map(&map(700, true)), |bytes| decode_map(bytes, MapKind::Caustic, MAX).map(drop));
    }

    #[test]
    fn changed_bytes_are_errors_or_harmless_maps_and_never_a_panic() {
        fuzz::forge(&encode_map(&map(700, true)), HEADER_BYTES, |bytes| {
            decode_map(bytes, MapKind::Caustic, MAX).map(|m| drop(m.tree().clone()))
        });
    }

    #[test]
    fn the_wrong_kind_and_too_many_photons_are_errors_that_say_so() {
        let bytes = encode_map(&map(1000, false));
        let say = |kind, max| decode_map(&bytes, kind, max).unwrap_err().to_string();
        assert_eq!(say(MapKind::Global, MAX), "photon map: the flag word is 2, expected 0");
        assert_eq!(say(MapKind::Caustic, 999), "photons of a map is 1000, over the limit of 999 (max_photons)");
    }
}

//! The photon map: merged photons in tree order, as it is built once, broadcast, and searched by every worker.

use super::estimate::choose_max_radius;
use super::grid::HashGrid;
use super::kdtree::{KdTree, MAX_TREE_PHOTONS};
use super::pack::{decode_direction, decode_normal, decode_rgbe};
use super::precomputed::PrecomputedIrradiance;
use super::query::{Neighbour, PhotonSearch};
use super::{EmissionRange, LightVertices, MapKind, PhotonBatch};
use crate::math::Rgb;
use glam::Vec3;
use rayon::prelude::*;
use std::sync::{Arc, OnceLock};

/// The maps a gather pass reads.
#[derive(Clone, Default, Debug)]
pub struct PhotonMaps {
    /// All light on diffuse surfaces.
    pub global: Option<Arc<PhotonMap>>,
    /// Focused light.
    pub caustic: Option<Arc<PhotonMap>>,
}

impl PhotonMaps {
    /// Puts a map in its place.
    pub fn insert(&mut self, map: Arc<PhotonMap>) {
        match map.kind {
            MapKind::Global => self.global = Some(map),
            MapKind::Caustic => self.caustic = Some(map),
        }
    }
}

/// Photons of one kind in tree order.
#[derive(Debug)]
pub struct PhotonMap {
    kind: MapKind,
    emitted_count: u64,
    tree: KdTree,
    powers: Vec<u32>,
    normals: Vec<u16>,
    vertices: Option<LightVertices>,
    /// For final gather.
    precomputed: OnceLock<PrecomputedIrradiance>,
    /// For fixed-radius estimates, with the index in tree order of each of its photons.
    grid: OnceLock<(HashGrid, Vec<u32>)>,
    /// [`choose_max_radius`] for the k it was first asked for.
    default_max_radius: OnceLock<(u32, f32)>,
}

/// A photon map as it travels: arrays in tree order, one entry a photon.
#[derive(Clone, Debug, PartialEq)]
pub struct MapParts {
    /// Which map.
    pub kind: MapKind,
    /// Emitted paths, the divisor of every estimate.
    pub emitted_count: u64,
    /// Coordinates by axis, scene space.
    pub coordinates: [Vec<f32>; 3],
    /// Undivided power, RGBE.
    pub powers: Vec<u32>,
    /// Normals, octahedral 2 × 8 bits.
    pub normals: Vec<u16>,
    /// Of light vertices, what they carry besides.
    pub vertices: Option<LightVertices>,
}

/// Why parts make no map.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MapError {
    /// The arrays differ in length.
    #[error("{} map: {array} has {actual} entries for {expected} photons", .kind.name())]
    Length {
        /// The map.
        kind: MapKind,
        /// The array.
        array: &'static str,
        /// Its length.
        actual: usize,
        /// The number of photons.
        expected: usize,
    },
    /// More photons than a tree can index.
    #[error("{} map: {actual} photons exceed the limit of {MAX_TREE_PHOTONS}; emit fewer photons", .kind.name())]
    TooMany {
        /// The map.
        kind: MapKind,
        /// Number of photons.
        actual: usize,
    },
    /// A position is NaN or infinite.
    #[error("{} map: the position of photon {index} is not finite", .kind.name())]
    NotFinite {
        /// The map.
        kind: MapKind,
        /// The first such photon.
        index: usize,
    },
}

impl PhotonMap {
    /// Builds the map over merged photons; `merged.range` holds all emitted paths. The order of the photons within the
    /// result is a function of the batch alone.
    ///
    /// # Panics
    /// When the batch's arrays differ in length, which [`super::merge`] rules out, or with more than 2³² − 1 photons.
    pub fn build(kind: MapKind, merged: PhotonBatch) -> PhotonMap {
        let PhotonBatch { range, positions, powers, normals, vertices, .. } = merged;
        let (tree, order) = KdTree::build(positions);
        PhotonMap {
            kind,
            emitted_count: range.len(),
            tree,
            powers: permute(powers, &order),
            normals: permute(normals, &order),
            vertices: vertices.map(|v| LightVertices {
                directions: permute(v.directions, &order),
                shares: permute(v.shares, &order),
                lengths: permute(v.lengths, &order),
            }),
            precomputed: OnceLock::new(),
            grid: OnceLock::new(),
            default_max_radius: OnceLock::new(),
        }
    }

    /// A map without photons.
    pub fn empty(kind: MapKind, emitted_count: u64) -> PhotonMap {
        Self::build(kind, PhotonBatch::new(EmissionRange { first: 0, end: emitted_count }, false))
    }

    /// The map over photons that are in tree order already: equals the map the parts came from. Linear time for any input;
    /// parts in another order make a valid but slower map.
    ///
    /// # Errors
    /// When lengths differ, or a position is not finite.
    pub fn from_parts(parts: MapParts) -> Result<PhotonMap, MapError> {
        let MapParts { kind, emitted_count, coordinates, powers, normals, vertices } = parts;
        let expected = coordinates[0].len();
        if expected > MAX_TREE_PHOTONS {
            return Err(MapError::TooMany { kind, actual: expected });
        }
        let lengths = [
            ("y", coordinates[1].len()),
            ("z", coordinates[2].len()),
            ("power", powers.len()),
            ("normal", normals.len()),
            ("direction", vertices.as_ref().map_or(expected, |v| v.directions.len())),
            ("share", vertices.as_ref().map_or(expected, |v| v.shares.len())),
            ("length", vertices.as_ref().map_or(expected, |v| v.lengths.len())),
        ];
        if let Some(&(array, actual)) = lengths.iter().find(|(_, n)| *n != expected) {
            return Err(MapError::Length { kind, array, actual, expected });
        }
        let bad = coordinates.iter().filter_map(|c| c.iter().position(|v| !v.is_finite())).min();
        if let Some(index) = bad {
            return Err(MapError::NotFinite { kind, index });
        }
        let tree = KdTree::from_tree_order(coordinates);
        Ok(PhotonMap {
            kind,
            emitted_count,
            tree,
            powers,
            normals,
            vertices,
            precomputed: OnceLock::new(),
            grid: OnceLock::new(),
            default_max_radius: OnceLock::new(),
        })
    }

    /// Takes the map apart for the wire.
    pub fn into_parts(self) -> MapParts {
        MapParts {
            kind: self.kind,
            emitted_count: self.emitted_count,
            coordinates: self.tree.into_coordinates(),
            powers: self.powers,
            normals: self.normals,
            vertices: self.vertices,
        }
    }

    /// Which map this is.
    pub fn kind(&self) -> MapKind {
        self.kind
    }
    /// The divisor of every estimate.
    pub fn emitted_count(&self) -> u64 {
        self.emitted_count
    }
    /// Number of photons.
    pub fn stored_count(&self) -> usize {
        self.tree.len()
    }
    /// No photon is stored.
    pub fn is_empty(&self) -> bool {
        self.tree.is_empty()
    }
    /// What light vertices carry besides, in tree order; `None` in a map of photons.
    pub fn vertices(&self) -> Option<&LightVertices> {
        self.vertices.as_ref()
    }
    /// The search structure.
    pub fn tree(&self) -> &KdTree {
        &self.tree
    }
    /// Position of photon `index` < stored_count, scene space.
    #[inline]
    pub fn position(&self, index: u32) -> Vec3 {
        Vec3::from_array(self.tree.position(index))
    }
    /// Undivided power of photon `index`.
    #[inline]
    pub fn power(&self, index: u32) -> Rgb {
        decode_rgbe(self.powers[index as usize])
    }
    /// Unit normal of the surface at photon `index`, on the side the light came from; at a light vertex of its front.
    #[inline]
    pub fn normal(&self, index: u32) -> Vec3 {
        decode_normal(self.normals[index as usize])
    }
    /// Unit direction from photon `index` towards where its light came from, in a map of light vertices.
    #[inline]
    pub fn direction(&self, index: u32) -> Option<Vec3> {
        self.vertices.as_ref().map(|v| decode_direction(v.directions[index as usize]))
    }
    /// The packed powers, in tree order.
    pub fn packed_powers(&self) -> &[u32] {
        &self.powers
    }
    /// The packed normals, in tree order.
    pub fn packed_normals(&self) -> &[u16] {
        &self.normals
    }
    /// [`choose_max_radius`], remembered for the k it is first asked for.
    pub fn default_max_radius(&self, k: u32) -> f32 {
        let &(known, radius) = self.default_max_radius.get_or_init(|| (k, choose_max_radius(self, k)));
        if known == k { radius } else { choose_max_radius(self, k) }
    }

    /// Memory the map holds, its tree and caches included.
    pub fn memory_bytes(&self) -> u64 {
        let cache = self.precomputed.get().map_or(0, PrecomputedIrradiance::memory_bytes);
        let grid = self.grid.get().map_or(0, |(grid, order)| grid.memory_bytes() + 4 * order.len() as u64);
        Self::memory_bytes_for(self.stored_count(), self.vertices.is_some()) + cache + grid
    }
    /// Memory of a map of `count` photons, without the precomputed irradiance ([`PrecomputedIrradiance::memory_bytes_for`]) and
    /// the hash grid (18 bytes a photon).
    pub fn memory_bytes_for(count: usize, vertices: bool) -> u64 {
        let payload = size_of::<u32>() + size_of::<u16>() + if vertices { 4 + 8 + 1 } else { 0 };
        KdTree::memory_bytes_for(count) + (count * payload) as u64
    }

    /// BLAKE3 digest of all that influences an estimate: kind, emitted count and photons.
    pub fn digest(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        hasher.update(b"gatherlight photon map 1");
        hasher.update(&[self.kind as u8, u8::from(self.vertices.is_some())]);
        hasher.update(&self.emitted_count.to_le_bytes());
        hasher.update(&(self.stored_count() as u64).to_le_bytes());
        for axis in 0..3 {
            hash_words(&mut hasher, self.tree.coordinates(axis), |v| v.to_le_bytes());
        }
        hash_words(&mut hasher, &self.powers, |v| v.to_le_bytes());
        hash_words(&mut hasher, &self.normals, |v| v.to_le_bytes());
        if let Some(v) = &self.vertices {
            hash_words(&mut hasher, &v.directions, |v| v.to_le_bytes());
            hash_words(&mut hasher, v.shares.as_flattened(), |v| v.to_le_bytes());
            hasher.update(&v.lengths);
        }
        *hasher.finalize().as_bytes()
    }

    /// Turns estimates on this map into fixed-radius ones, searched in a spatial hash grid made for `radius`.
    ///
    /// [`super::estimate::irradiance`] then counts all photons within the largest radius, whatever k.
    pub fn enable_hash_grid(&self, radius: f32) {
        self.grid.get_or_init(|| {
            let positions: Vec<[f32; 3]> = (0..self.stored_count()).map(|i| self.tree.position(i as u32)).collect();
            HashGrid::build(&positions, radius)
        });
    }
    /// Whether estimates are fixed-radius ones.
    pub fn has_hash_grid(&self) -> bool {
        self.grid.get().is_some()
    }
    /// Calls `visit` for each photon with squared distance < `radius_squared` from `point`, by the grid if there is one.
    #[inline(always)]
    pub(super) fn for_each_within(&self, point: Vec3, radius_squared: f32, mut visit: impl FnMut(Neighbour)) {
        match self.grid.get() {
            None => self.tree.for_each_within(point.to_array(), radius_squared, visit),
            Some((grid, order)) => grid.for_each_within(point.to_array(), radius_squared, |n| {
                visit(Neighbour { index: order[n.index as usize], ..n });
            }),
        }
    }

    /// What final gather reads at its hits; made when first asked for, on the calling thread. One map is asked for one k only.
    pub fn precomputed(&self, k: u32) -> &PrecomputedIrradiance {
        self.precomputed.get_or_init(|| PrecomputedIrradiance::new(self, k))
    }
}

fn permute<T: Copy + Send + Sync>(from: Vec<T>, order: &[u32]) -> Vec<T> {
    assert_eq!(from.len(), order.len(), "photon arrays differ in length");
    order.par_iter().with_min_len(1 << 14).map(|&i| from[i as usize]).collect()
}

fn hash_words<T: Copy, const N: usize>(hasher: &mut blake3::Hasher, words: &[T], bytes: impl Fn(T) -> [u8; N]) {
    const BLOCK: usize = 4096;
    let mut block = Vec::with_capacity(BLOCK * N);
    for chunk in words.chunks(BLOCK) {
        block.clear();
        chunk.iter().for_each(|&w| block.extend_from_slice(&bytes(w)));
        hasher.update(&block);
    }
}

#[cfg(test)]
mod tests;

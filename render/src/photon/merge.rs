//! The gather collective's reduction: photon batches in any order of arrival become one batch in path order.
//!
//! The result is a function of the photons alone: it is the same for every partition of the paths, every order of arrival
//! and every number of workers. A path that is missing or there twice is an error, never a darker or brighter image.

use super::{EmissionRange, LightVertices, MapKind, PhotonBatch};
use std::collections::BTreeMap;

/// Why batches do not make one map. Ranges are of photon paths, [first, end).
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MergeError {
    /// Paths that no batch covers.
    #[error("{} map: no batch covers photon paths {missing}", .kind.name())]
    Gap {
        /// The map.
        kind: MapKind,
        /// The first run of missing paths.
        missing: EmissionRange,
    },
    /// The same batch twice.
    #[error("{} map: photon paths {range} arrived twice", .kind.name())]
    Duplicate {
        /// The map.
        kind: MapKind,
        /// The repeated range.
        range: EmissionRange,
    },
    /// Two batches share some paths.
    #[error("{} map: photon paths {second} overlap {first}, which arrived before", .kind.name())]
    Overlap {
        /// The map.
        kind: MapKind,
        /// The range that was there.
        first: EmissionRange,
        /// The range that came after.
        second: EmissionRange,
    },
    /// A batch reaches beyond the job's paths.
    #[error("{} map: photon paths {range} are outside the job's {total}", .kind.name())]
    Outside {
        /// The map.
        kind: MapKind,
        /// The batch's range.
        range: EmissionRange,
        /// The job's range.
        total: EmissionRange,
    },
    /// A batch contradicts itself or the others.
    #[error("{} map: the batch of photon paths {range} is malformed: {message}", .kind.name())]
    Malformed {
        /// The map.
        kind: MapKind,
        /// The batch's range.
        range: EmissionRange,
        /// What is wrong.
        message: &'static str,
    },
}

/// Joins `batches`, which must cover `total` without gap or overlap, into one batch in path order.
///
/// # Errors
/// Gaps, overlaps, duplicates, ranges outside `total` and malformed batches, each naming its range.
pub fn merge(kind: MapKind, total: EmissionRange, batches: Vec<PhotonBatch>) -> Result<PhotonBatch, MergeError> {
    let mut merger = Merger::new(kind, total);
    for batch in batches {
        merger.insert(batch)?;
    }
    merger.finish()
}

/// Takes batches as they arrive and joins them in path order at the end.
///
/// Photons wait in large blocks of memory and not in the arrays they came in: those are freed at once, so that the next
/// batch is decoded into the same memory, and a block goes back to the system as soon as it is copied. Arrays of all
/// sizes would stay behind in the allocator, as holes too small for the tree's.
#[derive(Debug)]
pub struct Merger {
    kind: MapKind,
    total: EmissionRange,
    /// By first path; disjoint, none empty.
    runs: BTreeMap<u64, Run>,
    blocks: Vec<Block>,
    vertices: Option<bool>,
    covered: u64,
    stored: usize,
}

impl Merger {
    /// A merger for the photon paths of `total`.
    pub fn new(kind: MapKind, total: EmissionRange) -> Self {
        Merger { kind, total, runs: BTreeMap::new(), blocks: Vec::new(), vertices: None, covered: 0, stored: 0 }
    }
    /// Paths covered so far.
    pub fn covered_count(&self) -> u64 {
        self.covered
    }
    /// Photons held so far.
    pub fn stored_count(&self) -> usize {
        self.stored
    }
    /// All paths are covered.
    pub fn is_complete(&self) -> bool {
        self.covered == self.total.len()
    }

    /// Takes a batch. After an error the merger is as it was before.
    ///
    /// # Errors
    /// When the batch overlaps an earlier one, leaves the job's range or is malformed.
    pub fn insert(&mut self, batch: PhotonBatch) -> Result<(), MergeError> {
        let (kind, range) = (self.kind, batch.range);
        if range.first > range.end || range.first < self.total.first || range.end > self.total.end {
            return Err(MergeError::Outside { kind, range, total: self.total });
        }
        if let Some(message) = self.malformed(&batch) {
            return Err(MergeError::Malformed { kind, range, message });
        }
        if range.is_empty() {
            return Ok(());
        }
        // Held ranges are disjoint, so only the last one that begins before `range.end` can overlap.
        if let Some(other) = self.runs.range(..range.end).next_back().map(|(_, r)| r.range)
            && other.end > range.first
        {
            return Err(if other == range {
                MergeError::Duplicate { kind, range }
            } else {
                MergeError::Overlap { kind, first: other, second: range }
            });
        }
        self.vertices = Some(batch.vertices.is_some());
        self.covered += range.len();
        self.stored += batch.len();
        let run = append(&mut self.blocks, &batch);
        self.runs.insert(range.first, run);
        Ok(())
    }

    fn malformed(&self, batch: &PhotonBatch) -> Option<&'static str> {
        let n = batch.len();
        let vertices = batch.vertices.as_ref();
        if batch.powers.len() != n || batch.normals.len() != n || vertices.is_some_and(|v| !v.have_length(n)) {
            return Some("its arrays differ in length");
        }
        if batch.range.is_empty() && n > 0 {
            return Some("it has photons but no paths");
        }
        if !batch.range.is_empty() && self.vertices.is_some_and(|v| v != vertices.is_some()) {
            return Some("it holds photons and the others light vertices, or the other way round");
        }
        None
    }

    /// The merged batch; each block is freed as soon as it is copied.
    ///
    /// # Errors
    /// When paths are missing.
    pub fn finish(self) -> Result<PhotonBatch, MergeError> {
        let mut next = self.total.first;
        for range in self.runs.values().map(|r| r.range) {
            if range.first != next {
                let missing = EmissionRange { first: next, end: range.first };
                return Err(MergeError::Gap { kind: self.kind, missing });
            }
            next = range.end;
        }
        if next != self.total.end {
            let missing = EmissionRange { first: next, end: self.total.end };
            return Err(MergeError::Gap { kind: self.kind, missing });
        }
        let merged = PhotonBatch::new(self.total, self.vertices.unwrap_or(false));
        Ok(concatenate(merged, self.stored, self.runs, self.blocks))
    }
}

/// Capacity of a block: above 32 MiB, the most that glibc keeps for itself when it is freed; what is not written to takes
/// no memory.
const BLOCK_BYTES: usize = 48 << 20;

/// Photons of some batches in order of arrival: of each batch all positions, then powers, normals and what light
/// vertices carry.
#[derive(Debug)]
struct Block {
    bytes: Vec<u8>,
    /// Runs that have not been copied out yet.
    runs: usize,
}

/// Where the photons of a batch are.
#[derive(Clone, Copy, Debug)]
struct Run {
    range: EmissionRange,
    block: usize,
    /// Of the run's first byte in its block.
    offset: usize,
    photons: usize,
}

/// Copies a batch to the end of the last block, or of a new one where it does not fit.
fn append(blocks: &mut Vec<Block>, batch: &PhotonBatch) -> Run {
    let none = LightVertices::default();
    let vertices = batch.vertices.as_ref().unwrap_or(&none);
    let parts: [&[u8]; 6] = [
        bytemuck::cast_slice(&batch.positions),
        bytemuck::cast_slice(&batch.powers),
        bytemuck::cast_slice(&batch.normals),
        bytemuck::cast_slice(&vertices.directions),
        bytemuck::cast_slice(&vertices.shares),
        &vertices.lengths,
    ];
    let size = parts.iter().map(|p| p.len()).sum::<usize>();
    if blocks.last().is_none_or(|b| b.bytes.capacity() - b.bytes.len() < size) {
        blocks.push(Block { bytes: Vec::with_capacity(size.max(BLOCK_BYTES)), runs: 0 });
    }
    let index = blocks.len() - 1;
    let block = &mut blocks[index];
    let offset = block.bytes.len();
    parts.iter().for_each(|part| block.bytes.extend_from_slice(part));
    block.runs += 1;
    Run { range: batch.range, block: index, offset, photons: batch.len() }
}

/// Fills the empty `merged` with the photons of all `runs`, `stored` in sum.
fn concatenate(
    mut merged: PhotonBatch,
    stored: usize,
    runs: BTreeMap<u64, Run>,
    mut blocks: Vec<Block>,
) -> PhotonBatch {
    merged.positions.reserve_exact(stored);
    merged.powers.reserve_exact(stored);
    merged.normals.reserve_exact(stored);
    if let Some(v) = &mut merged.vertices {
        v.reserve_exact(stored);
    }
    for run in runs.into_values() {
        let block = &mut blocks[run.block];
        let mut rest = &block.bytes[run.offset..];
        rest = take(rest, run.photons, &mut merged.positions);
        rest = take(rest, run.photons, &mut merged.powers);
        rest = take(rest, run.photons, &mut merged.normals);
        if let Some(v) = &mut merged.vertices {
            rest = take(rest, run.photons, &mut v.directions);
            rest = take(rest, run.photons, &mut v.shares);
            take(rest, run.photons, &mut v.lengths);
        }
        block.runs -= 1;
        if block.runs == 0 {
            block.bytes = Vec::new();
        }
    }
    merged
}

/// Appends the first `count` values in `bytes` to `to`, and returns the bytes after them.
fn take<'a, T: bytemuck::Pod>(bytes: &'a [u8], count: usize, to: &mut Vec<T>) -> &'a [u8] {
    let (these, rest) = bytes.split_at(count * size_of::<T>());
    to.extend(these.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned::<T>));
    rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{Purpose, Stream};

    fn range(first: u64, end: u64) -> EmissionRange {
        EmissionRange { first, end }
    }

    /// Path `i` stores i mod 3 photons that carry its number.
    fn batch(r: EmissionRange) -> PhotonBatch {
        let mut b = PhotonBatch::new(r, true);
        for path in r.first..r.end {
            for bounce in 0..path % 3 {
                b.positions.push([path as f32, bounce as f32, 0.0]);
                b.powers.push(path as u32);
                b.normals.push(bounce as u16);
                let v = b.vertices.as_mut().unwrap();
                v.directions.push(!path as u32);
                v.shares.push([path as f32, bounce as f32]);
                v.lengths.push(bounce as u8);
            }
        }
        b
    }

    #[test]
    fn any_partition_in_any_order_gives_the_same_batch() {
        let total = range(0, 1000);
        let whole = batch(total);
        let mut s = Stream::new(1, Purpose::Test, 0, 0);
        for _ in 0..200 {
            let mut cuts: Vec<u64> = (0..s.next_u64() % 20).map(|_| s.next_u64() % 1001).collect();
            cuts.extend([0, 1000]);
            cuts.sort_unstable();
            let mut parts: Vec<_> = cuts.windows(2).map(|w| batch(range(w[0], w[1]))).collect();
            for i in (1..parts.len()).rev() {
                parts.swap(i, (s.next_u64() % (i as u64 + 1)) as usize);
            }
            assert_eq!(merge(MapKind::Global, total, parts).unwrap(), whole);
        }
    }

    /// More photons than a block holds, in batches that arrive last first: blocks are left half full and copied backwards.
    #[test]
    fn photons_of_several_blocks_are_merged_in_path_order() {
        let total = range(0, 3);
        let count = BLOCK_BYTES / 18 / 5 * 3;
        let part = |path: u64| {
            let mut b = PhotonBatch::new(range(path, path + 1), false);
            b.positions = (0..count).map(|i| [path as f32, i as f32, -1.0]).collect();
            b.powers = (0..count).map(|i| path as u32 * 100 + i as u32).collect();
            b.normals = (0..count).map(|i| (i as u16) ^ (path as u16)).collect();
            b
        };
        let merged = merge(MapKind::Global, total, vec![part(2), part(1), part(0)]).unwrap();
        let chained = |of: fn(PhotonBatch) -> Vec<u32>| (0..3).flat_map(|p| of(part(p))).collect::<Vec<_>>();
        assert!(merged.powers == chained(|b| b.powers));
        assert!((0..3).all(|p| merged.positions[p * count..][..count] == part(p as u64).positions));
        assert!((0..3).all(|p| merged.normals[p * count..][..count] == part(p as u64).normals));
    }

    #[test]
    fn errors_name_the_ranges() {
        let kind = MapKind::Caustic;
        let say = |total, parts: &[(u64, u64)]| {
            let parts = parts.iter().map(|&(a, b)| batch(range(a, b))).collect();
            merge(kind, total, parts).unwrap_err().to_string()
        };
        let total = range(0, 100);
        assert_eq!(say(total, &[(50, 100), (0, 40)]), "caustic map: no batch covers photon paths [40, 50)");
        assert_eq!(say(total, &[(10, 100)]), "caustic map: no batch covers photon paths [0, 10)");
        assert_eq!(say(total, &[(0, 90)]), "caustic map: no batch covers photon paths [90, 100)");
        assert_eq!(say(total, &[]), "caustic map: no batch covers photon paths [0, 100)");
        assert_eq!(say(total, &[(0, 60), (0, 60)]), "caustic map: photon paths [0, 60) arrived twice");
        let overlap = "caustic map: photon paths [50, 100) overlap [0, 60), which arrived before";
        assert_eq!(say(total, &[(0, 60), (50, 100)]), overlap);
        assert!(say(total, &[(50, 60), (0, 100)]).contains("overlap"));
        assert!(say(total, &[(0, 100), (50, 60)]).contains("overlap"));
        let outside = "caustic map: photon paths [0, 101) are outside the job's [0, 100)";
        assert_eq!(say(total, &[(0, 101)]), outside);
    }

    #[test]
    fn malformed_batches_are_refused() {
        let refuse = |b: PhotonBatch| {
            let mut m = Merger::new(MapKind::Global, range(0, 20));
            m.insert(batch(range(0, 5))).unwrap();
            m.insert(b).unwrap_err().to_string()
        };
        let mut b = batch(range(5, 9));
        b.powers.pop();
        assert!(refuse(b).contains("differ in length"));
        let mut b = batch(range(5, 9));
        b.vertices = None;
        assert!(refuse(b).contains("light vertices"));
        let mut b = batch(range(5, 9));
        b.vertices.as_mut().unwrap().lengths.pop();
        assert!(refuse(b).contains("differ in length"));
        let mut b = batch(range(5, 9));
        b.range = range(5, 5);
        assert!(refuse(b).contains("no paths"));
        let mut b = batch(range(5, 9));
        b.range = range(9, 5);
        assert!(refuse(b).contains("outside"));
    }

    #[test]
    fn nothing_to_merge_is_an_empty_batch() {
        assert!(merge(MapKind::Global, range(0, 0), vec![]).unwrap().is_empty());
    }
}

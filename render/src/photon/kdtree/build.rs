//! Building the tree: recursive halving by quickselect, then boxes from the leaves up.

use super::{KdTree, LEAF_PHOTONS, MAX_TREE_PHOTONS, WideNode};
use rayon::prelude::*;

/// How much work is worth a thread of its own; of no influence on the result.
#[derive(Clone, Copy)]
struct Grain {
    /// Nodes with fewer photons are built by one thread.
    photons: usize,
    /// Least number of nodes whose boxes a thread computes.
    nodes: usize,
}

impl Grain {
    const PARALLEL: Grain = Grain { photons: 1 << 15, nodes: 1 << 11 };
    /// All on the calling thread, which meanwhile takes up no other work of its pool.
    const ONE_THREAD: Grain = Grain { photons: usize::MAX, nodes: usize::MAX };
}

/// A photon while sorting: coordinates and canonical index, 16 bytes.
type Record = [u32; 4];

/// Binary levels below the root for `len` photons: the fewest with leaves of at most [`LEAF_PHOTONS`].
pub(super) fn levels_for(len: usize) -> u32 {
    len.div_ceil(LEAF_PHOTONS).next_power_of_two().trailing_zeros()
}

/// Nodes before those of binary level `level` in a tree of `levels`: 1 + 4 + 16 … or, with a root of two, 1 + 2 + 8 ….
#[inline(always)]
pub(super) fn base(levels: u32, level: u32) -> usize {
    match (level, levels % 2) {
        (0, _) => 0,
        (_, 0) => ((1 << level) - 1) / 3,
        _ => ((1 << level) + 1) / 3,
    }
}

/// Number of wide nodes of a tree of `levels`.
pub(super) fn node_count(levels: u32) -> usize {
    if levels == 0 { 0 } else { base(levels, levels) }
}

impl KdTree {
    /// Builds the tree, in parallel on the current rayon pool, and says where each photon went: entry i of the second
    /// result is the index in `positions` of the photon that is now i-th.
    ///
    /// # Panics
    /// With more than [`MAX_TREE_PHOTONS`].
    pub fn build(positions: Vec<[f32; 3]>) -> (KdTree, Vec<u32>) {
        Self::build_by(positions, Grain::PARALLEL)
    }

    /// [`KdTree::build`] on the calling thread alone: for what is built under a lock, where a thread that waited for others
    /// could take up work that waits for the lock.
    pub(in crate::photon) fn build_on_one_thread(positions: Vec<[f32; 3]>) -> (KdTree, Vec<u32>) {
        Self::build_by(positions, Grain::ONE_THREAD)
    }

    fn build_by(positions: Vec<[f32; 3]>, grain: Grain) -> (KdTree, Vec<u32>) {
        let len = positions.len();
        assert!(len <= MAX_TREE_PHOTONS, "{len} photons: a tree holds at most {MAX_TREE_PHOTONS}");
        let mut records: Vec<Record> = positions
            .par_iter()
            .with_min_len(grain.photons)
            .enumerate()
            .map(|(i, p)| [ordered(p[0]), ordered(p[1]), ordered(p[2]), i as u32])
            .collect();
        drop(positions);
        let levels = levels_for(len);
        split(&mut records, 0, 0, levels, len as u64, grain);
        let coordinates = [0, 1, 2].map(|a| {
            let mut c = Vec::with_capacity(len + LEAF_PHOTONS);
            c.par_extend(records.par_iter().with_min_len(grain.photons).map(|r| unordered(r[a])));
            c.resize(len + LEAF_PHOTONS, 0.0);
            c
        });
        let order = records.par_iter().with_min_len(grain.photons).map(|r| r[3]).collect();
        drop(records);
        (Self::with_boxes(len, coordinates, grain), order)
    }

    /// The tree over photons that are already in tree order (`coordinates` by axis, of equal length), in linear time.
    ///
    /// For coordinates of a built tree the result equals it. Any other order gives a valid but slower tree.
    ///
    /// # Panics
    /// With more than [`MAX_TREE_PHOTONS`], or when lengths differ.
    pub fn from_tree_order(mut coordinates: [Vec<f32>; 3]) -> KdTree {
        let len = coordinates[0].len();
        assert!(len <= MAX_TREE_PHOTONS, "{len} photons: a tree holds at most {MAX_TREE_PHOTONS}");
        assert!(coordinates.iter().all(|c| c.len() == len), "coordinates differ in length");
        for c in &mut coordinates {
            c.reserve_exact(LEAF_PHOTONS);
            c.resize(len + LEAF_PHOTONS, 0.0);
        }
        Self::with_boxes(len, coordinates, Grain::PARALLEL)
    }

    fn with_boxes(len: usize, coordinates: [Vec<f32>; 3], grain: Grain) -> KdTree {
        let levels = levels_for(len);
        let mut tree = KdTree { len, levels, coordinates, nodes: Vec::new() };
        if levels == 0 {
            return tree;
        }
        let mut nodes = vec![WideNode::EMPTY; node_count(levels)];
        let lowest = levels.saturating_sub(2);
        nodes[base(levels, lowest)..].par_iter_mut().with_min_len(grain.nodes).enumerate().for_each(|(j, node)| {
            let children = if levels == 1 { 2 } else { 4 };
            for c in 0..children {
                let leaf = (j * children + c) as u32;
                let range = tree.first_photon(levels, leaf)..tree.first_photon(levels, leaf + 1);
                for axis in 0..3 {
                    (node.lo[axis][c], node.hi[axis][c]) = extent(&tree.coordinates[axis][range.clone()]);
                }
            }
        });
        let mut level = lowest;
        while level > 0 {
            let parent = level.saturating_sub(2);
            let (above, below) = nodes.split_at_mut(base(levels, level));
            let width = if level == 1 { 2 } else { 4 };
            let parents = &mut above[base(levels, parent)..];
            parents.par_iter_mut().with_min_len(grain.nodes).enumerate().for_each(|(j, node)| {
                for c in 0..width {
                    let child = &below[j * width + c];
                    for axis in 0..3 {
                        node.lo[axis][c] = child.lo[axis].iter().copied().fold(f32::INFINITY, smaller);
                        node.hi[axis][c] = child.hi[axis].iter().copied().fold(f32::NEG_INFINITY, larger);
                    }
                }
            });
            level = parent;
        }
        tree.nodes = nodes;
        tree
    }
}

#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if b < a { b } else { a }
}
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if b > a { b } else { a }
}

/// Least and greatest value; NaN is left out.
#[inline(always)]
fn extent(values: &[f32]) -> (f32, f32) {
    values.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(lo, hi), &v| (smaller(lo, v), larger(hi, v)))
}

/// Bits that order as the floats do (−0 before +0, NaN at the ends).
#[inline(always)]
fn ordered(v: f32) -> u32 {
    let bits = v.to_bits();
    bits ^ ((bits as i32 >> 31) as u32 | 0x8000_0000)
}

/// The inverse of [`ordered`].
#[inline(always)]
fn unordered(bits: u32) -> f32 {
    f32::from_bits(bits ^ (!(bits as i32 >> 31) as u32 | 0x8000_0000))
}

/// The axis along which the records extend farthest; the first among equals.
fn widest_axis(records: &[Record]) -> usize {
    let (mut lo, mut hi) = ([u32::MAX; 3], [0u32; 3]);
    for r in records {
        for a in 0..3 {
            lo[a] = lo[a].min(r[a]);
            hi[a] = hi[a].max(r[a]);
        }
    }
    let extent = [0, 1, 2].map(|a| unordered(hi[a]) - unordered(lo[a]));
    let mut axis = 0;
    for a in 1..3 {
        if extent[a] > extent[axis] {
            axis = a;
        }
    }
    axis
}

/// Orders `records` (node `index` of binary level `level`) so that each node of each level below holds its range.
fn split(records: &mut [Record], index: u64, level: u32, levels: u32, len: u64, grain: Grain) {
    if level == levels {
        return;
    }
    let first = (index * len) >> level;
    let middle = ((((2 * index + 1) * len) >> (level + 1)) - first) as usize;
    let axis = widest_axis(records);
    if middle < records.len() {
        records.select_nth_unstable_by_key(middle, |r| u64::from(r[axis]) << 32 | u64::from(r[3]));
    }
    let (left, right) = records.split_at_mut(middle);
    let go_left = |r: &mut [Record]| split(r, 2 * index, level + 1, levels, len, grain);
    let go_right = |r: &mut [Record]| split(r, 2 * index + 1, level + 1, levels, len, grain);
    if left.len() + right.len() >= grain.photons {
        rayon::join(|| go_left(left), || go_right(right));
    } else {
        go_left(left);
        go_right(right);
    }
}

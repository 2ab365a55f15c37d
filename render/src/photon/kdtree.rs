//! The photon k-d tree: balanced, implicit, four children a node, built and searched in cache order.
//!
//! Photons are stored in tree order, so that node j of binary level l holds photons [(j·n) >> l, ((j+1)·n) >> l): ranges
//! need no storage, and a tree is rebuilt from photons in tree order by computing boxes alone. A node keeps the tight boxes
//! of its four children (two binary levels) as structure of arrays, so that one pass of four lanes tests them all. Leaves
//! hold at most [`LEAF_PHOTONS`].
//!
//! Which photons lie in which leaf is a function of the positions and their canonical order alone: each split halves by
//! (coordinate, index), and no two photons compare equal.

mod build;

use super::query::{BoundedHeap, key};
use super::query::{
    Buffered, Collector, Nearest, Neighbour, NeighbourBuffer, PhotonSearch, Within, bound_of, from_key,
};

/// Most photons in a leaf.
pub const LEAF_PHOTONS: usize = 16;
/// Most photons in a tree: indices are 32 bits, and one value is spare.
pub const MAX_TREE_PHOTONS: usize = u32::MAX as usize;
/// Up to this k the max-heap is used, above it the buffer; the results are the same set. At 10⁷ photons the heap is 12 %
/// faster at k = 50, the buffer 14 % at 200 and 40 % at 500.
const HEAP_MAX_K: usize = 100;
/// Four-way levels of a tree of [`MAX_TREE_PHOTONS`]: ⌈log₂(2³² / 16) / 2⌉, rounded up.
const MAX_WIDE_LEVELS: usize = 16;
/// Each level leaves at most three siblings behind.
const STACK: usize = 3 * MAX_WIDE_LEVELS + 4;

/// The tight boxes of four children; an absent child is the empty box (lo = ∞, hi = −∞).
#[derive(Clone, Copy, Debug, PartialEq)]
struct WideNode {
    lo: [[f32; 4]; 3],
    hi: [[f32; 4]; 3],
}

impl WideNode {
    const EMPTY: WideNode = WideNode { lo: [[f32::INFINITY; 4]; 3], hi: [[f32::NEG_INFINITY; 4]; 3] };

    /// Squared distance from `q` to each child's box; never more than the computed distance to a photon inside, because
    /// subtraction, multiplication and addition round monotonically and are done in the same order.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // Lanes side by side: the form that vectorises.
    fn distances_squared(&self, q: [f32; 3]) -> [f32; 4] {
        let mut d = [[0.0f32; 4]; 3];
        for axis in 0..3 {
            for c in 0..4 {
                let below = self.lo[axis][c] - q[axis];
                let above = q[axis] - self.hi[axis][c];
                let outside = if below > above { below } else { above };
                d[axis][c] = if outside > 0.0 { outside } else { 0.0 };
            }
        }
        let mut sum = [0.0f32; 4];
        for c in 0..4 {
            sum[c] = d[0][c] * d[0][c] + d[1][c] * d[1][c] + d[2][c] * d[2][c];
        }
        sum
    }
}

/// A k-d tree that owns the photons' positions, in tree order.
#[derive(Clone, Debug, PartialEq)]
pub struct KdTree {
    len: usize,
    /// Binary levels below the root: 2^levels leaves.
    levels: u32,
    /// Coordinates in tree order, padded by [`LEAF_PHOTONS`] zeros so that leaves load whole.
    coordinates: [Vec<f32>; 3],
    /// Level after level; empty when the root is a leaf.
    nodes: Vec<WideNode>,
}

/// A node to visit: `key` is the distance to its box above its first photon's index.
#[derive(Clone, Copy, Default)]
struct Entry {
    key: u64,
    level: u32,
    index: u32,
}

impl KdTree {
    /// Number of photons.
    pub fn len(&self) -> usize {
        self.len
    }
    /// No photon.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }
    /// Position of photon `index` (< len) in tree order.
    #[inline]
    pub fn position(&self, index: u32) -> [f32; 3] {
        let i = index as usize;
        [self.coordinates[0][i], self.coordinates[1][i], self.coordinates[2][i]]
    }
    /// The coordinates along `axis` (0, 1, 2), in tree order.
    pub fn coordinates(&self, axis: usize) -> &[f32] {
        &self.coordinates[axis][..self.len]
    }
    /// The coordinates by axis, in tree order; see [`KdTree::from_tree_order`].
    pub fn into_coordinates(self) -> [Vec<f32>; 3] {
        let len = self.len;
        self.coordinates.map(|mut c| {
            c.truncate(len);
            c
        })
    }
    /// Memory of positions and boxes.
    pub fn memory_bytes(&self) -> u64 {
        Self::memory_bytes_for(self.len)
    }
    /// Memory of a tree of `len` photons.
    pub fn memory_bytes_for(len: usize) -> u64 {
        (3 * size_of::<f32>() * (len + LEAF_PHOTONS)
            + build::node_count(build::levels_for(len)) * size_of::<WideNode>()) as u64
    }
    /// Where the nodes of binary level `level` begin in `nodes`; levels have the parity of `self.levels`, besides 0.
    #[inline(always)]
    fn base(&self, level: u32) -> usize {
        build::base(self.levels, level)
    }
    /// First photon of node `index` of binary level `level`.
    #[inline(always)]
    fn first_photon(&self, level: u32, index: u32) -> usize {
        ((u64::from(index) * self.len as u64) >> level) as usize
    }

    /// The `k` nearest photons with squared distance < `radius_squared` that `accept` takes, into `buffer`; fewer when
    /// there are fewer. Photons that are not accepted neither count nor shrink the radius. Exact; ties go to the lower index.
    pub fn k_nearest(
        &self,
        point: [f32; 3],
        k: usize,
        radius_squared: f32,
        accept: impl Fn(u32) -> bool,
        buffer: &mut NeighbourBuffer,
    ) {
        if k <= HEAP_MAX_K {
            self.k_nearest_by_heap(point, k, radius_squared, accept, buffer);
        } else {
            self.k_nearest_by_buffer(point, k, radius_squared, accept, buffer);
        }
    }

    /// [`Self::k_nearest`] by a bounded max-heap, farthest on top.
    pub fn k_nearest_by_heap(
        &self,
        point: [f32; 3],
        k: usize,
        radius_squared: f32,
        accept: impl Fn(u32) -> bool,
        buffer: &mut NeighbourBuffer,
    ) {
        let mut collector: BoundedHeap<'_> = buffer.heap(k, bound_of(radius_squared));
        self.traverse(point, accept, &mut collector);
    }

    /// [`Self::k_nearest`] by buffering candidates and selecting.
    pub fn k_nearest_by_buffer(
        &self,
        point: [f32; 3],
        k: usize,
        radius_squared: f32,
        accept: impl Fn(u32) -> bool,
        buffer: &mut NeighbourBuffer,
    ) {
        let mut collector: Buffered<'_> = buffer.buffered(k, bound_of(radius_squared));
        self.traverse(point, accept, &mut collector);
        collector.finish();
    }

    /// Visits leaves, near ones first, and offers their photons. The order is a function of the tree and the point; the
    /// collector's bound only leaves nodes out.
    #[inline(always)]
    fn traverse(&self, q: [f32; 3], accept: impl Fn(u32) -> bool, collector: &mut impl Collector) {
        if !q.iter().all(|c| c.is_finite()) {
            return;
        }
        let mut stack = [Entry::default(); STACK];
        let mut depth = 0;
        let mut at = Entry::default();
        loop {
            if at.level == self.levels {
                self.leaf(at.index, q, &accept, collector);
            } else {
                depth = self.push_children(at, q, collector.bound(), &mut stack, depth);
            }
            loop {
                if depth == 0 {
                    return;
                }
                depth -= 1;
                at = stack[depth];
                if at.key < collector.bound() {
                    break;
                }
            }
        }
    }

    /// Pushes the children of `at` that may hold candidates below `bound`, nearest on top; returns the new depth.
    #[inline(always)]
    fn push_children(&self, at: Entry, q: [f32; 3], bound: u64, stack: &mut [Entry; STACK], depth: usize) -> usize {
        let node = &self.nodes[self.base(at.level) + at.index as usize];
        let distances = node.distances_squared(q);
        // The root of a tree with an odd number of levels has two children.
        let step = if at.level == 0 && self.levels % 2 == 1 { 1 } else { 2 };
        let level = at.level + step;
        let mut top = depth;
        for (c, &d) in distances.iter().enumerate() {
            let index = (at.index << step) + c as u32;
            let key = key(d, self.first_photon(level, index) as u32);
            if key < bound {
                let mut slot = top;
                while slot > depth && stack[slot - 1].key < key {
                    stack[slot] = stack[slot - 1];
                    slot -= 1;
                }
                stack[slot] = Entry { key, level, index };
                top += 1;
            }
        }
        top
    }

    /// Offers the photons of leaf `index` to the collector.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // Lanes side by side: the form that vectorises.
    fn leaf(&self, index: u32, q: [f32; 3], accept: &impl Fn(u32) -> bool, collector: &mut impl Collector) {
        let first = self.first_photon(self.levels, index);
        let count = self.first_photon(self.levels, index + 1) - first;
        let [Some(x), Some(y), Some(z)] = [0, 1, 2].map(|a| self.coordinates[a][first..].first_chunk::<LEAF_PHOTONS>())
        else {
            return;
        };
        let mut distances = [0.0f32; LEAF_PHOTONS];
        for i in 0..LEAF_PHOTONS {
            let (dx, dy, dz) = (x[i] - q[0], y[i] - q[1], z[i] - q[2]);
            distances[i] = dx * dx + dy * dy + dz * dz;
        }
        let bound = collector.bound();
        let mut near = [0u64; LEAF_PHOTONS];
        let mut found = 0;
        for i in 0..count.min(LEAF_PHOTONS) {
            let key = key(distances[i], (first + i) as u32);
            near[found % LEAF_PHOTONS] = key;
            found += usize::from(key < bound);
        }
        for &key in &near[..found] {
            if key < collector.bound() && accept(key as u32) {
                collector.take(key);
            }
        }
    }
}

impl PhotonSearch for KdTree {
    fn for_each_within(&self, point: [f32; 3], radius_squared: f32, visit: impl FnMut(Neighbour)) {
        self.traverse(point, |_| true, &mut Within { bound: bound_of(radius_squared), visit });
    }

    fn nearest(&self, point: [f32; 3], radius_squared: f32, accept: impl Fn(u32) -> bool) -> Option<Neighbour> {
        let bound = bound_of(radius_squared);
        let mut collector = Nearest { best: bound };
        self.traverse(point, accept, &mut collector);
        (collector.best < bound).then(|| from_key(collector.best))
    }
}

#[cfg(test)]
mod tests;

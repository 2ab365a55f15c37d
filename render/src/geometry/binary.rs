//! Binary trees over boxes: a parallel builder by the binned surface area heuristic (Wald 2007).
//!
//! It is O(n log n) and its depth is bounded for every input: where the heuristic cannot separate the boxes, or the
//! tree has grown deep, it splits at the median. Trees do not depend on the number of threads.

use super::bounds::Bounds;
use glam::Vec3A;

/// No tree is deeper than this (the root has depth 0).
pub(super) const MAX_DEPTH: usize = 64;
/// Beyond this depth only median splits are made; they add at most 32 levels for 2³² boxes.
const MAX_SAH_DEPTH: usize = MAX_DEPTH - 32;
/// Bins per axis.
const BINS: usize = 16;
/// Up to this many boxes every split along every axis is tried.
const SWEEP_MAX: usize = 8;
/// Subtrees smaller than this are built by one thread.
const PARALLEL_MIN: usize = 4096;

/// A node of a binary tree.
#[derive(Clone, Copy, Debug)]
pub(super) struct BinaryNode {
    /// Box around everything below.
    pub bounds: Bounds,
    /// Index of the first of two adjacent children, or of the item of a leaf.
    pub first: u32,
    /// Whether it is a leaf.
    pub leaf: bool,
}

/// A binary tree with one item in each leaf; node 0 is the root. Empty for no items.
#[derive(Clone, Debug, Default)]
pub(super) struct BinaryTree {
    /// 2n − 1 nodes for n items.
    pub nodes: Vec<BinaryNode>,
}

/// A box in vector registers.
#[derive(Clone, Copy)]
struct Box3 {
    min: Vec3A,
    max: Vec3A,
}

impl Box3 {
    const EMPTY: Box3 = Box3 { min: Vec3A::INFINITY, max: Vec3A::NEG_INFINITY };

    #[inline]
    fn union(self, other: Box3) -> Self {
        Box3 { min: self.min.min(other.min), max: self.max.max(other.max) }
    }
    #[inline]
    fn with(self, point: Vec3A) -> Self {
        Box3 { min: self.min.min(point), max: self.max.max(point) }
    }
    #[inline]
    fn extent(self) -> Vec3A {
        self.max - self.min
    }
    /// Half the surface area; not meant for empty boxes.
    #[inline]
    fn half_area(self) -> f32 {
        let e = self.extent();
        e.x * e.y + e.y * e.z + e.z * e.x
    }
    fn bounds(self) -> Bounds {
        Bounds { min: self.min.into(), max: self.max.into() }
    }
}

/// A box with the index of what it bounds.
#[derive(Clone, Copy)]
struct Item {
    bounds: Box3,
    index: u32,
}

impl Item {
    /// Twice the box's centre.
    #[inline]
    fn center2(&self) -> Vec3A {
        self.bounds.min + self.bounds.max
    }
}

/// Box around the doubled centres.
fn centers2(items: &[Item]) -> Box3 {
    items.iter().fold(Box3::EMPTY, |b, item| b.with(item.center2()))
}

impl BinaryTree {
    /// Builds a tree over finite boxes; leaf items are indices into `boxes`.
    pub(super) fn build(boxes: &[Bounds]) -> Self {
        if boxes.is_empty() {
            return BinaryTree::default();
        }
        let item =
            |(i, b): (usize, &Bounds)| Item { bounds: Box3 { min: b.min.into(), max: b.max.into() }, index: i as u32 };
        let mut items: Vec<Item> = boxes.iter().enumerate().map(item).collect();
        let blank = BinaryNode { bounds: Bounds::EMPTY, first: 0, leaf: true };
        let mut nodes = vec![blank; 2 * boxes.len() - 1];
        if let Some((root, below)) = nodes.split_first_mut() {
            subtree(&mut items, root, below, 1, 0);
        }
        BinaryTree { nodes }
    }

    /// Levels below the root on the longest path; zero if there is one node or none.
    #[cfg(test)]
    pub(super) fn depth(&self) -> usize {
        let mut deepest = 0;
        let mut stack = if self.nodes.is_empty() { vec![] } else { vec![(0u32, 0usize)] };
        while let Some((i, depth)) = stack.pop() {
            let node = &self.nodes[i as usize];
            deepest = deepest.max(depth);
            if !node.leaf {
                stack.extend([(node.first, depth + 1), (node.first + 1, depth + 1)]);
            }
        }
        deepest
    }

    /// Indices of all nodes, every parent before its children.
    pub(super) fn top_down(&self) -> Vec<u32> {
        let mut order = Vec::with_capacity(self.nodes.len());
        if !self.nodes.is_empty() {
            order.push(0);
        }
        let mut next = 0;
        while next < order.len() {
            let node = &self.nodes[order[next] as usize];
            if !node.leaf {
                order.extend([node.first, node.first + 1]);
            }
            next += 1;
        }
        order
    }
}

/// Builds the subtree over `items` at `root`; its 2n − 2 other nodes are `below`, which starts at index `base`.
fn subtree(items: &mut [Item], root: &mut BinaryNode, below: &mut [BinaryNode], base: u32, depth: usize) {
    let bounds = items.iter().fold(Box3::EMPTY, |b, i| b.union(i.bounds)).bounds();
    if items.len() == 1 {
        *root = BinaryNode { bounds, first: items[0].index, leaf: true };
        return;
    }
    *root = BinaryNode { bounds, first: base, leaf: false };
    let middle = match items.len() {
        _ if depth >= MAX_SAH_DEPTH => None,
        0..=2 => None,
        3..=SWEEP_MAX => split_by_sweep(items),
        _ => split_by_bins(items),
    };
    let middle = middle.unwrap_or_else(|| split_at_median(items));
    let (left, right) = items.split_at_mut(middle);
    let (children, below) = below.split_at_mut(2);
    let (below_left, below_right) = below.split_at_mut(2 * left.len() - 2);
    let (root_left, root_right) = children.split_at_mut(1);
    let base_right = base + 2 + below_left.len() as u32;
    let parallel = left.len() + right.len() >= PARALLEL_MIN;
    let mut build_left = || subtree(left, &mut root_left[0], below_left, base + 2, depth + 1);
    let mut build_right = || subtree(right, &mut root_right[0], below_right, base_right, depth + 1);
    if parallel {
        rayon::join(build_left, build_right);
    } else {
        build_left();
        build_right();
    }
}

/// Splits into halves of equal count along the axis in which the centres spread most.
fn split_at_median(items: &mut [Item]) -> usize {
    let axis = centers2(items).extent().max_position();
    let middle = items.len() / 2;
    items.select_nth_unstable_by(middle, |a, b| {
        a.center2()[axis].total_cmp(&b.center2()[axis]).then(a.index.cmp(&b.index))
    });
    middle
}

/// Sorts few items along each axis and splits where the surface area heuristic is least; `None` if no split has a
/// finite cost.
fn split_by_sweep(items: &mut [Item]) -> Option<usize> {
    let mut best = (f32::INFINITY, 0, 0);
    let mut right_cost = [0.0f32; SWEEP_MAX];
    for axis in 0..3 {
        sort_along(items, axis);
        let mut right = Box3::EMPTY;
        for i in (1..items.len()).rev() {
            right = right.union(items[i].bounds);
            right_cost[i] = right.half_area() * (items.len() - i) as f32;
        }
        let mut left = Box3::EMPTY;
        for i in 1..items.len() {
            left = left.union(items[i - 1].bounds);
            let cost = left.half_area() * i as f32 + right_cost[i];
            if cost < best.0 {
                best = (cost, axis, i);
            }
        }
    }
    let (cost, axis, middle) = best;
    sort_along(items, axis);
    cost.is_finite().then_some(middle)
}

/// Sorts by the centre along an axis, and by index where centres are equal.
fn sort_along(items: &mut [Item], axis: usize) {
    let key = |item: &Item| (item.center2()[axis], item.index);
    for i in 1..items.len() {
        let mut place = i;
        while place > 0 && key(&items[place]) < key(&items[place - 1]) {
            items.swap(place, place - 1);
            place -= 1;
        }
    }
}

/// Box and count of each bin of one axis.
type Bins = [(Box3, u32); BINS];

/// Maps centres to bins.
struct Binning {
    low: Vec3A,
    scale: Vec3A,
}

impl Binning {
    fn new(centers: Box3) -> Self {
        let extent = centers.extent();
        // An axis without spread gets scale 0: everything in bin 0, so that it is never chosen.
        let scale = |e: f32| {
            let s = BINS as f32 * (1.0 - 1e-6) / e;
            if s.is_finite() { s } else { 0.0 }
        };
        Binning { low: centers.min, scale: Vec3A::new(scale(extent.x), scale(extent.y), scale(extent.z)) }
    }
    #[inline]
    fn bins(&self, item: &Item) -> [usize; 3] {
        let b = (item.center2() - self.low) * self.scale;
        // The cast saturates; the minimum keeps the upper bound under rounding.
        [b.x, b.y, b.z].map(|x| (x as u32 as usize).min(BINS - 1))
    }
}

/// Partitions `items` at the cheapest of the binned splits and gives the size of the left part, or `None` if no split
/// separates them.
fn split_by_bins(items: &mut [Item]) -> Option<usize> {
    let binning = Binning::new(centers2(items));
    let mut bins: [Bins; 3] = [[(Box3::EMPTY, 0); BINS]; 3];
    for item in items.iter() {
        for (axis, bin) in binning.bins(item).into_iter().enumerate() {
            let slot = &mut bins[axis][bin];
            *slot = (slot.0.union(item.bounds), slot.1 + 1);
        }
    }
    let mut best = (f32::INFINITY, 0, 0);
    for (axis, bins) in bins.iter().enumerate() {
        let (cost, bin) = cheapest_split(bins);
        if cost < best.0 {
            best = (cost, axis, bin);
        }
    }
    let (cost, axis, bin) = best;
    if !cost.is_finite() {
        return None;
    }
    Some(partition(items, |item| binning.bins(item)[axis] < bin))
}

/// The cheapest split of one axis: its cost, and the first bin of the right side.
fn cheapest_split(bins: &Bins) -> (f32, usize) {
    let mut right_cost = [0.0f32; BINS];
    let mut right = (Box3::EMPTY, 0);
    for bin in (1..BINS).rev() {
        right = (right.0.union(bins[bin].0), right.1 + bins[bin].1);
        right_cost[bin] = if right.1 == 0 { f32::INFINITY } else { right.0.half_area() * right.1 as f32 };
    }
    let mut best = (f32::INFINITY, 0);
    let mut left = (Box3::EMPTY, 0);
    for bin in 1..BINS {
        left = (left.0.union(bins[bin - 1].0), left.1 + bins[bin - 1].1);
        if left.1 > 0 {
            let cost = left.0.half_area() * left.1 as f32 + right_cost[bin];
            if cost < best.0 {
                best = (cost, bin);
            }
        }
    }
    best
}

/// Moves the items that satisfy `left` to the front and counts them. The order is a function of the input order.
fn partition(items: &mut [Item], left: impl Fn(&Item) -> bool) -> usize {
    let (mut low, mut high) = (0, items.len());
    while low < high {
        if left(&items[low]) {
            low += 1;
        } else {
            high -= 1;
            items.swap(low, high);
        }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rng::{Purpose, Stream};
    use glam::Vec3;

    /// Asserts that every item is in one leaf, inside the boxes of all nodes above.
    fn check(tree: &BinaryTree, boxes: &[Bounds]) {
        let mut seen = vec![0; boxes.len()];
        for node in &tree.nodes {
            let inside = if node.leaf {
                seen[node.first as usize] += 1;
                boxes[node.first as usize]
            } else {
                let [a, b] = [0, 1].map(|i| tree.nodes[node.first as usize + i].bounds);
                a.union(b)
            };
            assert_eq!(node.bounds, inside);
        }
        assert!(seen.iter().all(|&n| n == 1));
        assert!(boxes.is_empty() || tree.nodes.len() == 2 * boxes.len() - 1);
    }

    fn boxes(count: usize, at: impl Fn(usize, &mut Stream) -> Vec3) -> Vec<Bounds> {
        let s = &mut Stream::new(1, Purpose::Test, 0, count as u64);
        (0..count).map(|i| at(i, s)).map(|p| Bounds { min: p, max: p + 0.1 }).collect()
    }

    #[test]
    fn trees_hold_every_box_at_bounded_depth() {
        type Place = fn(usize, &mut Stream) -> Vec3;
        let places: [Place; 5] = [
            |_, s| Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()),
            |_, _| Vec3::ONE,
            |i, _| Vec3::X * (i / 2) as f32 * 1e-7,
            // Ever closer together: splits at equal distances would peel off one box a level.
            |i, _| Vec3::X * 0.5f32.powi(i.min(140) as i32),
            |i, s| if i == 0 { Vec3::splat(1e12) } else { Vec3::splat(s.next_f32()) },
        ];
        for place in places {
            for count in [0, 1, 2, 3, 8, 9, 100, 9000] {
                let boxes = boxes(count, place);
                let tree = BinaryTree::build(&boxes);
                check(&tree, &boxes);
                assert!(tree.depth() <= MAX_DEPTH, "{count}: {}", tree.depth());
                check(&super::super::bvh::build(&boxes), &boxes);
            }
        }
    }
}

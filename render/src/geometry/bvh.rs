//! Binary trees improved by obvhs (the only file that names it).
//!
//! Trees are built by [`super::binary`], whose time and depth are bounded for every input, and then improved by
//! reinsertion (Meister and Bittner 2017), which moves subtrees to where they cost least. Its search is quadratic where
//! boxes lie on top of each other, and it may deepen the tree; such trees are left as they are.

use super::binary::{BinaryNode, BinaryTree, MAX_DEPTH};
use super::bounds::Bounds;
use glam::{Vec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;

/// Fraction of the nodes that the first of several passes tries to reinsert.
const REINSERTION_RATIO: f32 = 0.12;
/// Number of passes.
const PASSES: usize = 6;
/// The optimiser searches with 96 stack entries (twice this number), on which the way to a node takes one a level.
const SEARCH_STACK: usize = 48;
/// A node whose descendants' areas sum to more than this many times its own holds boxes on top of each other: a ray
/// through it meets as many.
const MAX_OVERLAP: f32 = 1000.0;
/// Smaller trees are not worth improving.
const MIN_NODES: usize = 16;

/// A binary tree over finite boxes.
pub(super) fn build(boxes: &[Bounds]) -> BinaryTree {
    let tree = BinaryTree::build(boxes);
    if tree.nodes.len() < MIN_NODES || overlap(&tree) > MAX_OVERLAP {
        return tree;
    }
    reinsert(&tree).unwrap_or(tree)
}

/// The largest ratio of the areas below a node to its own.
fn overlap(tree: &BinaryTree) -> f32 {
    let mut below = vec![0.0f32; tree.nodes.len()];
    let mut largest = 0.0f32;
    for &i in tree.top_down().iter().rev() {
        let node = &tree.nodes[i as usize];
        let area = node.bounds.half_area();
        if !node.leaf {
            let sum = below[node.first as usize] + below[node.first as usize + 1];
            below[i as usize] = sum;
            largest = largest.max(sum / area.max(f32::MIN_POSITIVE));
        }
        below[i as usize] += area;
    }
    largest
}

/// The tree after reinsertion, or `None` if it became too deep.
fn reinsert(tree: &BinaryTree) -> Option<BinaryTree> {
    let mut bvh = to_obvhs(tree);
    let mut optimizer = ReinsertionOptimizer::default();
    for pass in 0..PASSES {
        // Later passes look at fewer and larger nodes.
        optimizer.run(&mut bvh, REINSERTION_RATIO / (2 * pass + 1) as f32, Some(vec![1.0]));
        // A pass searches before it changes anything, so its stack holds if the tree's depth is checked in between.
        if bvh.depth(0) > MAX_DEPTH {
            return None;
        }
    }
    Some(from_obvhs(&bvh))
}

/// Nodes level by level, the order in which the optimiser looks for candidates.
fn to_obvhs(tree: &BinaryTree) -> Bvh2 {
    let mut next_child = 1;
    let node = |&i: &u32| {
        let node = &tree.nodes[i as usize];
        let aabb = Aabb { min: Vec3A::from(node.bounds.min), max: Vec3A::from(node.bounds.max) };
        if node.leaf {
            return Bvh2Node::new(aabb, 1, node.first);
        }
        next_child += 2;
        Bvh2Node::new(aabb, 0, next_child - 2)
    };
    let nodes: Vec<Bvh2Node> = tree.top_down().iter().map(node).collect();
    let items = nodes.len() as u32 / 2 + 1;
    Bvh2 { nodes, primitive_indices: (0..items).collect(), max_depth: SEARCH_STACK, ..Bvh2::default() }
}

fn from_obvhs(bvh: &Bvh2) -> BinaryTree {
    let node = |node: &Bvh2Node| {
        let (min, max) = (Vec3::from(node.aabb().min), Vec3::from(node.aabb().max));
        BinaryNode { bounds: Bounds { min, max }, first: node.first_index, leaf: node.is_leaf() }
    };
    BinaryTree { nodes: bvh.nodes.iter().map(node).collect() }
}

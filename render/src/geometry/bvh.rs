//! Binary trees improved by obvhs (the only file that names it).

use super::binary::BinaryTree;
use super::bounds::Bounds;

/// A binary tree over finite boxes.
pub(super) fn build(boxes: &[Bounds]) -> BinaryTree {
    BinaryTree::build(boxes)
}

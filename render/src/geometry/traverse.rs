//! Walking a wide tree along a ray.

use super::bounds::Bounds;
use super::simd::{Lanes, Simd};
use super::wide::{Child, WideNode, WideTree};
use glam::Vec3;

/// Stack entries kept without allocating: enough for 18 levels.
const STACK: usize = 128;

/// A ray prepared for box tests that never miss a box whose triangles [`super::triangle`] would find hit: origins are
/// moved outwards by the bound on the error of the sheared coordinates, reciprocals by their rounding (Woop, Benthin and
/// Wald 2013, appendix).
#[derive(Clone, Copy, Debug)]
pub(super) struct Slabs {
    /// Row of [`super::wide::WideNode::bounds`] that is met first, by axis.
    near_row: [usize; 3],
    /// Origin for near planes.
    near_origin: [f32; 3],
    /// Origin for far planes.
    far_origin: [f32; 3],
    /// Reciprocal of the direction for near planes.
    near_scale: [f32; 3],
    /// Reciprocal of the direction for far planes.
    far_scale: [f32; 3],
}

impl Slabs {
    /// For boxes within `bounds`. The direction is finite and not zero.
    #[inline(always)]
    pub(super) fn new(origin: Vec3, direction: Vec3, bounds: Bounds) -> Self {
        const UP: f32 = 1.0 + f32::EPSILON;
        const DOWN: f32 = 1.0 - f32::EPSILON;
        // Woop's bound is 5 half-units on |x| + |z|; 3 units hold it and the bound's own rounding.
        const ERROR: f32 = 3.0 * f32::EPSILON;
        let reach = (origin - bounds.min).abs().max((bounds.max - origin).abs());
        let error = (reach + Vec3::splat(reach.max_element())) * ERROR;
        // Adding zero turns −0 into +0, so that the reciprocal's sign is that of the chosen row.
        let reciprocal = 1.0 / (direction + Vec3::ZERO);
        let backward = direction.cmplt(Vec3::ZERO);
        let outward = Vec3::select(backward, -error, error);
        Slabs {
            near_row: [0, 1, 2].map(|axis| 2 * axis + usize::from(backward.test(axis))),
            near_origin: (origin + outward).to_array(),
            far_origin: (origin - outward).to_array(),
            near_scale: (reciprocal * (DOWN * DOWN)).to_array(),
            far_scale: (reciprocal * (UP * UP)).to_array(),
        }
    }

    /// Which children the ray meets at 0 ≤ t ≤ `t_max`, as bits, and where it enters each.
    #[inline(always)]
    fn meet<S: Simd>(&self, simd: S, node: &WideNode, t_max: f32) -> (u32, S::F8) {
        let splat = |value| S::F8::splat(simd, value);
        let mut near = splat(0.0);
        let mut far = splat(t_max);
        for axis in 0..3 {
            let row = self.near_row[axis];
            let low = S::F8::load(simd, &node.bounds[row]);
            let high = S::F8::load(simd, &node.bounds[row ^ 1]);
            // 0 × ∞ is not a number where the ray lies in a plane: min and max then keep their second operand.
            near = low.sub(splat(self.near_origin[axis])).mul(splat(self.near_scale[axis])).max(near);
            far = high.sub(splat(self.far_origin[axis])).mul(splat(self.far_scale[axis])).min(far);
        }
        (S::F8::bits(near.le(far)), near)
    }
}

/// A subtree to visit and where the ray enters it.
#[derive(Clone, Copy)]
struct Entry {
    near: f32,
    child: Child,
}

/// Visits the leaves that a ray meets, the nearer ones first. `leaf` gives the distance up to which hits still matter,
/// or `None` to stop.
#[inline(always)]
pub(super) fn walk<S: Simd>(simd: S, tree: &WideTree, slabs: &Slabs, t_max: f32, leaf: impl FnMut(u32) -> Option<f32>) {
    let blank = Entry { near: 0.0, child: Child::ROOT };
    if tree.stack_entries <= STACK {
        walk_with(simd, tree, slabs, t_max, leaf, &mut [blank; STACK]);
    } else {
        walk_with(simd, tree, slabs, t_max, leaf, &mut vec![blank; tree.stack_entries]);
    }
}

#[inline(always)]
fn walk_with<S: Simd>(
    simd: S,
    tree: &WideTree,
    slabs: &Slabs,
    mut t_max: f32,
    mut leaf: impl FnMut(u32) -> Option<f32>,
    stack: &mut [Entry],
) {
    let mut top = 0;
    let mut current = Child::ROOT;
    loop {
        if let Some(index) = current.leaf() {
            match leaf(index) {
                Some(t) => t_max = t,
                None => return,
            }
        } else {
            let node = &tree.nodes[current.node()];
            let (mut hits, near) = slabs.meet(simd, node, t_max);
            if hits != 0 {
                let first = hits.trailing_zeros() as usize & 7;
                hits &= hits - 1;
                if hits == 0 {
                    current = node.children[first];
                    continue;
                }
                let near = near.store();
                let base = top;
                stack[top] = Entry { near: near[first], child: node.children[first] };
                top += 1;
                while hits != 0 {
                    let next = hits.trailing_zeros() as usize & 7;
                    hits &= hits - 1;
                    // Insertion keeps this node's children sorted, the nearest on top.
                    let entry = Entry { near: near[next], child: node.children[next] };
                    let mut place = top;
                    while place > base && stack[place - 1].near < entry.near {
                        stack[place] = stack[place - 1];
                        place -= 1;
                    }
                    stack[place] = entry;
                    top += 1;
                }
                top -= 1;
                current = stack[top].child;
                continue;
            }
        }
        loop {
            if top == 0 {
                return;
            }
            top -= 1;
            if stack[top].near <= t_max {
                current = stack[top].child;
                break;
            }
        }
    }
}

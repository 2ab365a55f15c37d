//! Walking a wide tree along a ray.

use super::bounds::Bounds;
use super::simd::{Lanes, Simd};
use super::wide::{Child, WIDTH, WideNode, WideTree};
use glam::Vec3;

/// Stack entries kept without allocating: enough for 18 levels.
const STACK: usize = 128;

/// A ray prepared for box tests that never miss a box whose triangles [`super::triangle`] would find hit: origins are
/// moved outwards by the bound on the error of the sheared coordinates, reciprocals by their rounding (Woop, Benthin and
/// Wald 2013, appendix).
#[derive(Clone, Copy, Debug)]
pub(super) struct Slabs {
    /// By axis: 0 if the ray meets lower planes first, 1 if upper ones.
    near_side: [usize; 3],
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
            near_side: [backward.test(0).into(), backward.test(1).into(), backward.test(2).into()],
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
            let side = self.near_side[axis] & 1;
            let low = S::F8::load(simd, &node.bounds[axis][side]);
            let high = S::F8::load(simd, &node.bounds[axis][side ^ 1]);
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

/// What is done at leaves. The method must be `#[inline(always)]`, so that it is compiled for the same vectors.
pub(super) trait Visitor {
    /// Visits a leaf; gives the distance up to which hits still matter, or `None` to stop.
    fn visit<S: Simd>(&mut self, simd: S, leaf: u32) -> Option<f32>;
}

/// Visits the leaves that a ray meets up to `t_max`, the nearer ones first.
#[inline(always)]
pub(super) fn walk<S: Simd>(simd: S, tree: &WideTree, slabs: &Slabs, mut t_max: f32, visitor: &mut impl Visitor) {
    let blank = Entry { near: 0.0, child: Child::ROOT };
    let (mut small, mut large);
    let stack: &mut [Entry] = if tree.stack_entries <= STACK {
        small = [blank; STACK];
        &mut small
    } else {
        large = vec![blank; tree.stack_entries];
        &mut large
    };
    let mut top = 0;
    let mut current = Child::ROOT;
    loop {
        if let Some(index) = current.leaf() {
            match visitor.visit(simd, index) {
                Some(t) => t_max = t,
                None => return,
            }
        } else {
            let node = &tree.nodes[current.node()];
            let (hits, near) = slabs.meet(simd, node, t_max);
            if hits != 0 {
                (current, top) = descend::<S>(node, hits, near, stack, top);
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

/// The nearest of the children that were hit, after pushing the others with the nearest on top; and the new stack top.
#[inline(always)]
fn descend<S: Simd>(
    node: &WideNode,
    mut hits: u32,
    near: S::F8,
    stack: &mut [Entry],
    mut top: usize,
) -> (Child, usize) {
    let mut next = || {
        let slot = hits.trailing_zeros() as usize & (WIDTH - 1);
        hits &= hits - 1;
        (slot, hits == 0)
    };
    let (slot, last) = next();
    if last {
        return (node.children[slot], top);
    }
    let near = near.store();
    let base = top;
    let mut nearest = Entry { near: near[slot], child: node.children[slot] };
    loop {
        let (slot, last) = next();
        let mut entry = Entry { near: near[slot], child: node.children[slot] };
        if entry.near < nearest.near {
            std::mem::swap(&mut entry, &mut nearest);
        }
        // Insertion keeps the children of this node sorted.
        let mut place = top;
        while place > base && stack[place - 1].near < entry.near {
            stack[place] = stack[place - 1];
            place -= 1;
        }
        stack[place] = entry;
        top += 1;
        if last {
            return (nearest.child, top);
        }
    }
}

//! Trees with eight children a node, made from binary trees at least expected cost (Ylitie, Karras and Laine 2017, §4).

use super::binary::BinaryTree;
use super::bounds::Bounds;

/// Children of a node.
pub(super) const WIDTH: usize = 8;
/// Expected cost of testing a leaf, relative to a node.
const LEAF_COST: f32 = 1.0;
/// Marks a child that is a leaf.
const LEAF: u32 = 1 << 31;

/// Eight boxes and what they lead to.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(super) struct WideNode {
    /// `bounds[axis][0 for min, 1 for max][child]`. Empty columns are never hit.
    pub bounds: [[[f32; WIDTH]; 2]; 3],
    /// Child references.
    pub children: [Child; WIDTH],
}

/// Reference to a node or a leaf.
#[derive(Clone, Copy, Debug)]
pub(super) struct Child(u32);

impl Child {
    /// The root of every tree.
    pub(super) const ROOT: Child = Child(0);

    /// Index of the leaf, if it is one.
    #[inline(always)]
    pub(super) fn leaf(self) -> Option<u32> {
        (self.0 & LEAF != 0).then_some(self.0 & !LEAF)
    }
    /// Index of the node, if it is not a leaf.
    #[inline(always)]
    pub(super) fn node(self) -> usize {
        self.0 as usize
    }
}

/// A tree with eight children a node.
#[derive(Clone, Debug)]
pub(super) struct WideTree {
    /// Node 0 is the root; at least one.
    pub nodes: Vec<WideNode>,
    /// Box around everything.
    pub bounds: Bounds,
    /// Entries that a traversal's stack must hold.
    pub stack_entries: usize,
}

/// A wide tree, and the items of each of its leaves.
pub(super) struct Collapsed {
    /// The tree.
    pub tree: WideTree,
    /// Leaf i holds `items[starts[i]..starts[i + 1]]`.
    pub starts: Vec<u32>,
    /// Items in leaf order.
    pub items: Vec<u32>,
}

impl WideTree {
    /// Bytes held.
    pub(super) fn memory_bytes(&self) -> usize {
        self.nodes.len() * size_of::<WideNode>()
    }

    /// Collapses a binary tree, which is not empty, into wide nodes with at most `leaf_size` items a leaf.
    pub(super) fn collapse(binary: &BinaryTree, leaf_size: u32) -> Collapsed {
        let plan = Plan::new(binary, leaf_size);
        let tree = WideTree { nodes: Vec::new(), bounds: binary.nodes[0].bounds, stack_entries: 0 };
        let collapsed = Collapsed { tree, starts: vec![0], items: Vec::new() };
        let mut builder = Builder { binary, plan, collapsed };
        let mut roots = Children::default();
        match builder.plan.choices[0].inner {
            0 => roots.push(0),
            _ => builder.children(0, &mut roots),
        }
        builder.emit(&roots, 1);
        builder.collapsed
    }
}

/// How a binary subtree is best represented.
#[derive(Clone, Copy, Default)]
struct Choice {
    /// 0: as one leaf; else as a wide node, whose left half gets this many of its eight slots.
    inner: u8,
    /// Entry i: of i slots, how many the left half gets; 0: one slot fewer is as good.
    left: [u8; WIDTH],
}

/// The best choices for all subtrees.
struct Plan {
    choices: Vec<Choice>,
}

impl Plan {
    /// The dynamic programme of Ylitie et al., bottom-up: `costs[n][i]` is the least cost of subtree n in i slots.
    fn new(binary: &BinaryTree, leaf_size: u32) -> Self {
        let mut choices = vec![Choice::default(); binary.nodes.len()];
        let mut costs = vec![[0.0f32; WIDTH]; binary.nodes.len()];
        let mut counts = vec![1u32; binary.nodes.len()];
        for &index in binary.top_down().iter().rev() {
            let n = index as usize;
            let node = &binary.nodes[n];
            let area = node.bounds.half_area();
            if node.leaf {
                costs[n] = [area * LEAF_COST; WIDTH];
                continue;
            }
            let (l, r) = (node.first as usize, node.first as usize + 1);
            counts[n] = counts[l] + counts[r];
            let distribute = |slots: usize| {
                let cost = |k: usize| costs[l][k] + costs[r][slots - k];
                (2..slots).fold((cost(1), 1), |best, k| if cost(k) < best.0 { (cost(k), k) } else { best })
            };
            let (inner_cost, inner_left) = distribute(WIDTH);
            let mut cost = [0.0; WIDTH];
            cost[1] = inner_cost + area;
            choices[n].inner = inner_left as u8;
            if counts[n] <= leaf_size && area * LEAF_COST <= cost[1] {
                cost[1] = area * LEAF_COST;
                choices[n].inner = 0;
            }
            for slots in 2..WIDTH {
                let (split, left) = distribute(slots);
                let better = split < cost[slots - 1];
                cost[slots] = if better { split } else { cost[slots - 1] };
                choices[n].left[slots] = if better { left as u8 } else { 0 };
            }
            costs[n] = cost;
        }
        Plan { choices }
    }
}

/// Up to eight binary nodes.
#[derive(Default)]
struct Children {
    nodes: [u32; WIDTH],
    count: usize,
}

impl Children {
    fn push(&mut self, node: u32) {
        self.nodes[self.count] = node;
        self.count += 1;
    }
    fn as_slice(&self) -> &[u32] {
        &self.nodes[..self.count]
    }
}

struct Builder<'a> {
    binary: &'a BinaryTree,
    plan: Plan,
    collapsed: Collapsed,
}

impl Builder<'_> {
    /// The children of the wide node made from binary node `n`.
    fn children(&self, n: u32, out: &mut Children) {
        let left = self.plan.choices[n as usize].inner;
        let first = self.binary.nodes[n as usize].first;
        self.gather(first, left as usize, out);
        self.gather(first + 1, WIDTH - left as usize, out);
    }

    /// The nodes that represent `n` in `slots` slots.
    fn gather(&self, n: u32, mut slots: usize, out: &mut Children) {
        let node = &self.binary.nodes[n as usize];
        let choice = &self.plan.choices[n as usize];
        while slots > 1 && choice.left[slots] == 0 {
            slots -= 1;
        }
        if slots == 1 || node.leaf {
            return out.push(n);
        }
        let left = choice.left[slots] as usize;
        self.gather(node.first, left, out);
        self.gather(node.first + 1, slots - left, out);
    }

    /// Appends the wide node with these children, and all below; `level` counts from 1 at the root.
    fn emit(&mut self, children: &Children, level: usize) -> u32 {
        let index = self.collapsed.tree.nodes.len();
        let bounds = [[[f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]]; 3];
        self.collapsed.tree.nodes.push(WideNode { bounds, children: [Child(LEAF); WIDTH] });
        // Below a node, at most seven siblings wait a level.
        let entries = level * (WIDTH - 1) + 1;
        self.collapsed.tree.stack_entries = self.collapsed.tree.stack_entries.max(entries);
        for (slot, &n) in children.as_slice().iter().enumerate() {
            let child = if self.plan.choices[n as usize].inner == 0 {
                self.emit_leaf(n)
            } else {
                let mut below = Children::default();
                self.children(n, &mut below);
                Child(self.emit(&below, level + 1))
            };
            let node = &mut self.collapsed.tree.nodes[index];
            node.children[slot] = child;
            let bounds = self.binary.nodes[n as usize].bounds;
            for axis in 0..3 {
                node.bounds[axis][0][slot] = bounds.min[axis];
                node.bounds[axis][1][slot] = bounds.max[axis];
            }
        }
        index as u32
    }

    /// Appends a leaf with all items below `n`.
    fn emit_leaf(&mut self, n: u32) -> Child {
        let leaf = self.collapsed.starts.len() as u32 - 1;
        let mut stack = vec![n];
        while let Some(n) = stack.pop() {
            let node = &self.binary.nodes[n as usize];
            if node.leaf {
                self.collapsed.items.push(node.first);
            } else {
                stack.extend([node.first + 1, node.first]);
            }
        }
        self.collapsed.starts.push(self.collapsed.items.len() as u32);
        Child(leaf | LEAF)
    }
}

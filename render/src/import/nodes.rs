//! The node hierarchy of the selected scene, flattened to placements in double precision.

use super::document::{Document, Warnings};
use super::json::{Item, Result};
use glam::{DAffine3, DMat3, DQuat, DVec3};

/// Largest departure of a node matrix's last row from (0, 0, 0, 1), which some exporters round.
const AFFINE_TOLERANCE: f64 = 1e-6;

/// One node of the selected scene.
pub(super) struct Placement {
    /// Index of the node.
    pub(super) node: usize,
    /// Object to world.
    pub(super) to_world: DAffine3,
}

/// Nodes of the selected scene in depth-first file order. Subtrees scaled to nothing are left out (glTF §3.5.2).
///
/// # Errors
/// When any node of the file is its own ancestor or has two parents, or a transform is damaged.
pub(super) fn place(doc: &Document, warnings: &mut Warnings) -> Result<Vec<Placement>> {
    let parents = check_hierarchy(doc)?;
    let mut stack: Vec<(usize, DAffine3)> = Vec::new();
    for root in roots(doc, &parents)?.into_iter().rev() {
        stack.push((root, DAffine3::IDENTITY));
    }
    let mut placements = Vec::new();
    while let Some((node, parent)) = stack.pop() {
        let item = doc.item("nodes", node)?;
        let local = local_transform(&item)?;
        let to_world = parent * local;
        if !to_world.is_finite() {
            return Err(item.error("the transforms from the root down to here multiply to infinity"));
        }
        if local.matrix3 == DMat3::ZERO {
            warnings.add(format!(
                "{} is scaled to nothing and left out with all below it",
                doc.label("node", "nodes", node)
            ));
            continue;
        }
        placements.push(Placement { node, to_world });
        let children = children(doc, &item)?;
        stack.extend(children.into_iter().rev().map(|child| (child, to_world)));
    }
    Ok(placements)
}

fn children(doc: &Document, item: &Item) -> Result<Vec<usize>> {
    match item.get("children")? {
        Some(list) => list.elements()?.iter().map(|child| doc.index(child, "nodes")).collect(),
        None => Ok(Vec::new()),
    }
}

/// The parent of each node; checks that the nodes form trees.
fn check_hierarchy(doc: &Document) -> Result<Vec<Option<usize>>> {
    let count = doc.count("nodes");
    let mut parents: Vec<Option<usize>> = vec![None; count];
    for node in 0..count {
        let item = doc.item("nodes", node)?;
        for child in children(doc, &item)? {
            let Some(slot) = parents.get_mut(child) else { continue };
            if let Some(other) = slot.replace(node) {
                return Err(item.error(format!(
                    "nodes[{child}] is already a child of nodes[{other}]; a node may have one parent only (place its mesh by two nodes instead)"
                )));
            }
        }
    }
    // Walk up from each node; `seen[n]` is the start whose walk reached n, so that meeting one's own walk is a cycle.
    let mut seen = vec![usize::MAX; count];
    for start in 0..count {
        let mut at = Some(start);
        while let Some(node) = at {
            let Some(mark) = seen.get_mut(node).filter(|m| **m == usize::MAX || **m == start) else { break };
            if *mark == start {
                return Err(doc.item("nodes", node)?.error("the node is its own ancestor: children form a cycle"));
            }
            *mark = start;
            at = parents.get(node).copied().flatten();
        }
    }
    Ok(parents)
}

/// Root nodes of the selected scene; without scenes, all nodes that have no parent.
fn roots(doc: &Document, parents: &[Option<usize>]) -> Result<Vec<usize>> {
    let selected = doc.reference(doc.root(), "scene", "scenes")?;
    if doc.count("scenes") == 0 {
        return Ok((0..parents.len()).filter(|n| parents.get(*n).is_some_and(Option::is_none)).collect());
    }
    let scene = doc.item("scenes", selected.unwrap_or(0))?;
    let Some(list) = scene.get("nodes")? else { return Ok(Vec::new()) };
    let mut roots = Vec::new();
    let mut listed = vec![false; parents.len()];
    for item in list.elements()? {
        let node = doc.index(&item, "nodes")?;
        if let Some(parent) = parents.get(node).copied().flatten() {
            return Err(item.error(format!("nodes[{node}] is no root: it is a child of nodes[{parent}]")));
        }
        if let Some(slot) = listed.get_mut(node)
            && std::mem::replace(slot, true)
        {
            return Err(item.error(format!("nodes[{node}] is listed twice")));
        }
        roots.push(node);
    }
    Ok(roots)
}

/// A node's own transform: its matrix, or translation · rotation · scale.
fn local_transform(item: &Item) -> Result<DAffine3> {
    let translation = item.opt("translation", Item::numbers::<3>)?;
    let rotation = item.opt("rotation", Item::numbers::<4>)?;
    let scale = item.opt("scale", Item::numbers::<3>)?;
    let Some(matrix_item) = item.get("matrix")? else {
        let rotation = match rotation {
            None => DQuat::IDENTITY,
            Some(q) => unit_quaternion(q)
                .ok_or_else(|| item.error("its rotation is a quaternion of length zero or beyond all numbers"))?,
        };
        let scale = scale.map_or(DVec3::ONE, DVec3::from_array);
        return Ok(DAffine3::from_scale_rotation_translation(
            scale,
            rotation,
            translation.map_or(DVec3::ZERO, DVec3::from_array),
        ));
    };
    if translation.is_some() || rotation.is_some() || scale.is_some() {
        return Err(item.error("has a matrix and also translation, rotation or scale; only one form is allowed"));
    }
    let m = matrix_item.numbers::<16>()?;
    let last_row = [m[3], m[7], m[11], m[15] - 1.0];
    if last_row.iter().any(|v| v.abs() > AFFINE_TOLERANCE) {
        return Err(matrix_item.error("its last row must be 0 0 0 1: perspective in a node is not allowed"));
    }
    Ok(DAffine3::from_cols_array(&[m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10], m[12], m[13], m[14]]))
}

/// The quaternion (x, y, z, w) scaled to unit length; exact multiples of the axes stay exact.
fn unit_quaternion(q: [f64; 4]) -> Option<DQuat> {
    let largest = q.iter().fold(0.0f64, |a, v| a.max(v.abs()));
    let scaled = DQuat::from_array(q.map(|v| v / largest));
    let length_squared = scaled.length_squared();
    // Dividing a quaternion that is of unit length but for rounding would only change its last bits.
    let original = DQuat::from_array(q);
    if (original.length_squared() - 1.0).abs() < 1e-14 {
        return Some(original);
    }
    (largest > 0.0 && length_squared.is_finite()).then(|| scaled / length_squared.sqrt())
}

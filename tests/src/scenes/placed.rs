//! Scenes about placement.

use super::shapes::{Shape, Side};
use super::writer::Writer;
use serde_json::{Value, json};

/// Half a turn of a spiral of bricks, twelve levels deep in the node tree, and its mirror image: one mesh of two
/// primitives, placed by 2 · 12 · 8 nodes, half of them under a negative scale.
pub(super) fn instances() -> Vec<u8> {
    let mut w = Writer::new("instances", &["KHR_materials_emissive_strength", "KHR_materials_specular"]);
    let stone = w.lambert("stone", [0.55, 0.5, 0.45]);
    let brass = w.metal("brass", [0.9, 0.7, 0.35], 0.35);
    let floor = w.lambert("floor", [0.5, 0.55, 0.6]);
    let light = w.emitter("light", 12.0);
    w.object("floor", &Shape::side(Side::Top, [-4.0, -1.0, -4.0], [4.0, 0.0, 4.0]).plain(), floor);
    let brick = Shape::cuboid([0.7, 0.02, -0.12], [1.1, 0.16, 0.12]).plain();
    let knob = Shape::sphere([0.9, 0.2, 0.0], 0.05, 2);
    let mesh = w.mesh("brick", &[(&brick, stone), (&knob, brass)]);
    // Eight bricks in a ring, an eighth of a turn apart: quaternions of 0, π/4, … about y, from half-angle formulas.
    let ring: Vec<[f64; 2]> = (0..8).map(|i| half_turns(i, 8)).collect();
    let mut towers = Vec::new();
    for side in ["right", "left"] {
        let mut above: Option<usize> = None;
        for level in (0..12).rev() {
            let mut children: Vec<Value> = Vec::new();
            for [sin, cos] in &ring {
                children.push(json!(w.push("nodes", json!({ "mesh": mesh, "rotation": [0.0, *sin, 0.0, *cos] }))));
            }
            children.extend(above.map(|node| json!(node)));
            let [sin, cos] = half_turns(1, 32);
            above = Some(w.push(
                "nodes",
                json!({
                    "name": format!("{side} level {level}"),
                    "children": children,
                    "translation": [0.0, if level == 0 { 0.0 } else { 0.17 }, 0.0],
                    "rotation": [0.0, sin, 0.0, cos],
                    "scale": [0.97, 1.0, 0.97]
                }),
            ));
        }
        towers.extend(above);
    }
    w.root(json!({ "name": "right tower", "children": [towers[0]], "translation": [1.4, 0.0, 0.0] }));
    w.root(json!({ "name": "mirrored tower", "children": [towers[1]], "translation": [-1.4, 0.0, 0.0], "scale": [-1.0, 1.0, 1.0] }));
    let lamp = Shape::side(Side::Bottom, [-1.0, 4.0, -1.0], [1.0, 4.1, 1.0]).plain();
    w.object("lamp", &lamp, light);
    w.camera("camera", [0.0, 3.2, 7.6], [0.0, 0.9, 0.0], 40.0);
    w.glb()
}

/// Sine and cosine of half of `part` of `whole` turns, for a power of two `whole`, by halving the angle: no library's
/// sine is asked.
fn half_turns(part: u32, whole: u32) -> [f64; 2] {
    let (mut sin, mut cos) = (0.0f64, -1.0f64); // of π, half a full turn
    let mut divided = 1;
    while divided < whole {
        (sin, cos) = (((1.0 - cos) / 2.0).sqrt(), ((1.0 + cos) / 2.0).sqrt());
        divided *= 2;
    }
    let (mut s, mut c) = (0.0, 1.0);
    for _ in 0..part {
        (s, c) = (s * cos + c * sin, c * cos - s * sin);
    }
    [s, c]
}

/// Blocks on a table seen without perspective from above one corner, and by a second, perspective camera.
pub(super) fn orthographic() -> Vec<u8> {
    let mut w = Writer::new("orthographic", &["KHR_materials_emissive_strength", "KHR_materials_specular"]);
    let table = w.lambert("table", [0.7, 0.65, 0.6]);
    let light = w.emitter("light", 10.0);
    w.object("table", &Shape::side(Side::Top, [-2.0, -1.0, -2.0], [2.0, 0.0, 2.0]).plain(), table);
    let colors = [[0.7, 0.2, 0.2], [0.2, 0.6, 0.3], [0.2, 0.3, 0.7], [0.7, 0.6, 0.2]];
    for (i, color) in colors.into_iter().enumerate() {
        let name = format!("block {i}");
        let material = w.lambert(&name, color);
        let (x, z) = ([-0.6, 0.2][i % 2], [-0.6, 0.2][i / 2]);
        let height = 0.3 + 0.3 * i as f32;
        w.object(&name, &Shape::cuboid([x, 0.0, z], [x + 0.4, height, z + 0.4]).plain(), material);
    }
    w.object("lamp", &Shape::side(Side::Bottom, [-0.5, 3.0, 1.0], [0.5, 3.1, 2.0]).plain(), light);
    w.orthographic_camera("isometric", [4.0, 4.0, 4.0], [0.0, 0.4, 0.0], 1.6);
    w.camera("perspective", [3.0, 2.2, 3.6], [0.0, 0.4, 0.0], 36.0);
    w.glb()
}

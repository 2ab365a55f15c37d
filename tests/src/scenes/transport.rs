//! Scenes that are each hard for some way of computing light transport, and easy for another.
//!
//! All are closed rooms, so that no light is lost to the outside and every method has the same paths to find.

use super::shapes::{Shape, Side};
use super::writer::Writer;
use gatherlight_render::math::ops;
use glam::Vec3;
use serde_json::json;

const EMITTER: &[&str] = &["KHR_materials_emissive_strength", "KHR_materials_specular"];
const EMITTER_AND_GLASS: &[&str] = &[
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_volume",
];

/// The inside of a box; one material for each side, in the order of [`Side::ALL`].
fn room(w: &mut Writer, low: [f32; 3], high: [f32; 3], materials: [usize; 6]) {
    let names = ["left wall", "right wall", "floor", "ceiling", "back wall", "front wall"];
    for ((side, name), material) in Side::ALL.into_iter().zip(names).zip(materials) {
        w.object(name, &Shape::side(side, low, high).plain().turned(), material);
    }
}

/// A ring of gold with roughness 0.2 on a table in a closed room, lit by a small lamp from the side: the inner wall throws
/// a blurred cardioid. Its paths (light, glossy, diffuse) are found from both ends, by none of them well.
pub(super) fn rough_gold_ring() -> Vec<u8> {
    let mut w = Writer::new("rough-gold-ring", EMITTER);
    let table = w.lambert("table", [0.62, 0.6, 0.56]);
    let wall = w.lambert("wall", [0.3, 0.35, 0.45]);
    let gold = w.metal("gold", [0.95, 0.74, 0.35], 0.2);
    let light = w.emitter("light", 90.0);
    room(&mut w, [-1.4, 0.0, -1.4], [1.4, 2.0, 1.4], [wall, wall, table, wall, wall, wall]);
    // The cross-section of the band: bottom flank on the table left out.
    let (inner, outer, height) = (0.42, 0.47, 0.3);
    let flanks = [[[outer, 0.0], [outer, height]], [[outer, height], [inner, height]], [[inner, height], [inner, 0.0]]];
    w.object("ring", &Shape::ring(&flanks, 128), gold);
    let lamp = Shape::board(
        Vec3::new(-0.95, 1.15, -0.75),
        Vec3::new(0.6, 0.0, -0.8),
        Vec3::new(0.48, -0.8, 0.36),
        Vec3::new(0.08, 0.004, 0.08),
    );
    w.object("lamp", &lamp, light);
    w.wide_camera("camera", [0.15, 1.25, 1.25], [0.02, 0.08, 0.02], 42.0, 4.0 / 3.0);
    w.glb()
}

/// A room whose lamp stands in a tray under the ceiling, below the tray's rim: it lights a patch of the ceiling that the
/// camera does not see, and everything in the picture has its light at second hand or later.
pub(super) fn hidden_lamp() -> Vec<u8> {
    let mut w = Writer::new("hidden-lamp", EMITTER);
    let white = w.lambert("white", [0.75, 0.74, 0.7]);
    let red = w.lambert("red", [0.6, 0.16, 0.12]);
    let blue = w.lambert("blue", [0.15, 0.25, 0.55]);
    let wood = w.lambert("wood", [0.5, 0.36, 0.22]);
    let dark = w.lambert("dark", [0.2, 0.2, 0.2]);
    let light = w.emitter("light", 60.0);
    room(&mut w, [-1.5, 0.0, -2.0], [1.5, 2.0, 1.7], [red, blue, wood, white, white, white]);
    // Floor of the tray at 1.45, rim at 1.75; lamp of half side 0.15 at its bottom, so that the steepest ray over the
    // rim, across 0.55 and up 0.28, meets the ceiling 1.5 m away at the latest.
    let (center, half) = (-0.9, 0.4);
    let (low, high) = ([-half, 1.45, center - half], [half, 1.75, center + half]);
    let thickness = 0.02;
    for (x0, x1, z0, z1) in [
        (low[0] - thickness, low[0], low[2], high[2]),
        (high[0], high[0] + thickness, low[2], high[2]),
        (low[0] - thickness, high[0] + thickness, low[2] - thickness, low[2]),
        (low[0] - thickness, high[0] + thickness, high[2], high[2] + thickness),
    ] {
        w.object("rim", &Shape::cuboid([x0, low[1], z0], [x1, high[1], z1]).plain(), dark);
    }
    let bottom = Shape::cuboid(
        [low[0] - thickness, low[1] - thickness, low[2] - thickness],
        [high[0] + thickness, low[1], high[2] + thickness],
    );
    w.object("bottom of the tray", &bottom.plain(), dark);
    let lamp = Shape::cuboid([-0.15, low[1], center - 0.15], [0.15, low[1] + 0.02, center + 0.15]);
    w.object("lamp", &lamp.plain(), light);
    w.object("box", &Shape::cuboid([-0.95, 0.0, -1.5], [-0.35, 0.7, -0.9]).plain(), white);
    w.object("ball", &Shape::sphere([0.55, 0.35, -0.7], 0.35, 4), white);
    w.object("slab", &Shape::cuboid([0.1, 0.0, -1.9], [1.3, 0.9, -1.75]).plain(), red);
    w.wide_camera("camera", [0.0, 0.9, 1.65], [0.0, 0.82, -2.0], 35.0, 4.0 / 3.0);
    w.glb()
}

/// After Veach's thesis, chapter 11: a room that has only the light that comes through a door, open by two hands'
/// breadth, from the next room, whose lamp hangs where no straight line leads through the slit.
pub(super) fn door_ajar() -> Vec<u8> {
    let mut w = Writer::new("door-ajar", EMITTER);
    let wall = w.lambert("wall", [0.7, 0.68, 0.62]);
    let beyond = w.lambert("beyond", [0.75, 0.75, 0.75]);
    let parquet = w.lambert("parquet", [0.45, 0.3, 0.18]);
    let paint = w.lambert("paint", [0.35, 0.42, 0.4]);
    let table = w.lambert("table", [0.4, 0.36, 0.32]);
    let clay = w.lambert("clay", [0.65, 0.35, 0.22]);
    let enamel = w.coated("enamel", [0.12, 0.3, 0.55], 0.3);
    let steel = w.metal("steel", [0.8, 0.8, 0.82], 0.3);
    let light = w.emitter("light", 150.0);
    room(&mut w, [-1.6, 0.0, -2.2], [1.6, 2.5, 3.2], [wall, wall, parquet, wall, beyond, wall]);
    // The wall between the rooms, with its ends in the outer walls, and the doorway.
    let (left, right, height, half) = (-0.45f32, 0.45f32, 2.0f32, 0.06f32);
    for (name, low, high) in [
        ("wall left of the door", [-1.62, -0.02, -half], [left, 2.52, half]),
        ("wall right of the door", [right, -0.02, -half], [1.62, 2.52, half]),
        ("lintel", [left, height, -half], [right, 2.52, half]),
    ] {
        w.object(name, &Shape::cuboid(low, high).plain(), wall);
    }
    // Hinged on the left at the face of the wall; turned into this room by the angle whose half has the tangent 1/8.
    let door = Shape::cuboid([-0.01, 0.002, -0.02], [right - left, height, 0.02]).plain();
    let door = w.mesh("door", &[(&door, paint)]);
    let cos = 8.0 / 65f64.sqrt();
    w.root(json!({
        "name": "door", "mesh": door, "translation": [left, 0.0, half], "rotation": [0.0, -cos / 8.0, 0.0, cos]
    }));
    // On the far side of the wall above the door, facing away: it lights the next room only.
    let lamp = Shape::cuboid([-0.4, 2.1, -half - 0.02], [0.4, 2.4, -half]).plain();
    w.object("lamp", &lamp, light);
    w.object("table top", &Shape::cuboid([-0.75, 0.56, 0.85], [0.75, 0.6, 1.35]).plain(), table);
    for (x, z) in [(-0.7, 0.9), (0.66, 0.9), (-0.7, 1.26), (0.66, 1.26)] {
        w.object("leg", &Shape::cuboid([x, 0.0, z], [x + 0.04, 0.56, z + 0.04]).plain(), table);
    }
    for (name, x, material) in [("matt ball", -0.45, clay), ("coated ball", 0.02, enamel), ("steel ball", 0.48, steel)]
    {
        w.object(name, &Shape::sphere([x, 0.76, 1.1], 0.16, 3), material);
    }
    w.wide_camera("camera", [0.55, 1.35, 3.1], [0.0, 0.95, 0.0], 42.0, 4.0 / 3.0);
    w.glb()
}

/// A tiled pool lit by a small lamp through its rippled surface and looked at through it: nearly all paths of the picture
/// are specular, diffuse, specular, and no connection of vertices can make them.
pub(super) fn pool() -> Vec<u8> {
    let mut w = Writer::new("pool", EMITTER_AND_GLASS);
    let wall = w.lambert("wall", [0.42, 0.43, 0.42]);
    let pale = w.lambert("pale tile", [0.62, 0.74, 0.74]);
    let blue = w.lambert("blue tile", [0.12, 0.36, 0.5]);
    let red = w.lambert("red", [0.65, 0.15, 0.1]);
    let water = w.glass("water", 1.33);
    let housing = w.lambert("housing", [0.1, 0.1, 0.1]);
    let light = w.emitter("light", 1100.0);
    let (half, depth, top) = (1.0f32, 0.6f32, 1.6f32);
    for side in [Side::Left, Side::Right, Side::Back, Side::Front, Side::Top] {
        let sheet = Shape::side(side, [-half, -depth, -half], [half, top, half]).plain().turned();
        w.object("wall", &sheet, wall);
    }
    let tiles = 10;
    let mut shapes = [Shape::default(), Shape::default()];
    let edge = |i: usize| half * (2.0 * i as f32 / tiles as f32 - 1.0);
    for (i, j) in (0..tiles * tiles).map(|n| (n % tiles, n / tiles)) {
        let tile = Shape::side(Side::Top, [edge(i), -depth, edge(j)], [edge(i + 1), -depth, edge(j + 1)]);
        shapes[(i + j) % 2].join(&tile.plain());
    }
    w.object("pale tiles", &shapes[0], pale);
    w.object("blue tiles", &shapes[1], blue);
    w.object("ball", &Shape::sphere([-0.3, -0.42, 0.05], 0.18, 4), red);
    // Three waves of half a metre whose joint curvature focuses at about the depth; the edges lie behind the walls.
    let surface = Shape::sheet(half + 0.02, 64, |x, z| {
        let mut out = [0.0; 3];
        for (kx, kz, phase) in [(11.0f32, 7.0f32, 0.3f32), (-9.0, 9.5, 1.9), (2.5, -13.5, 4.0)] {
            let angle = kx * x + kz * z + phase;
            let (sin, cos) = (ops::sin(angle), ops::cos(angle));
            let wave = [sin, kx * cos, kz * cos].map(|v| 0.011 * v);
            out = std::array::from_fn(|i| out[i] + wave[i]);
        }
        out
    });
    w.object("surface of the water", &surface, water);
    // A lamp of 8 cm by 8 cm that shines downward only.
    let (low, high) = ([0.26, top - 0.06, -0.44], [0.34, top - 0.02, -0.36]);
    for side in Side::ALL {
        let material = if matches!(side, Side::Bottom) { light } else { housing };
        w.object("lamp", &Shape::side(side, low, high).plain(), material);
    }
    w.wide_camera("camera", [0.0, 1.3, 0.95], [0.0, -0.42, -0.12], 52.0, 4.0 / 3.0);
    w.glb()
}

/// After Veach's thesis, figure 9.2, in a closed room: four steel plates from nearly polished to brushed under four lamps of
/// equal power and different size, before a brushed wall that the plates reflect: glossy seen in glossy.
pub(super) fn glossy_plates() -> Vec<u8> {
    let mut w = Writer::new("glossy-plates", EMITTER);
    let wall = w.lambert("wall", [0.4, 0.42, 0.45]);
    let floor = w.coated("floor", [0.35, 0.33, 0.3], 0.35);
    let brushed = w.metal("brushed wall", [0.7, 0.6, 0.5], 0.4);
    room(&mut w, [-2.0, 0.0, -1.6], [2.0, 2.6, 3.6], [wall, wall, floor, wall, brushed, wall]);
    let eye = Vec3::new(0.0, 1.3, 3.4);
    let lamps = Vec3::new(0.0, 1.85, -0.7);
    for (i, roughness) in [0.1, 0.2, 0.3, 0.45].into_iter().enumerate() {
        let steel = w.metal(&format!("steel {roughness}"), [0.75, 0.76, 0.78], roughness);
        let [y, z] = [[1.0, -0.1], [0.7, 0.35], [0.42, 0.8], [0.2, 1.25]][i];
        let center = Vec3::new(0.0, y, z);
        // Tilted so that its middle mirrors the row of lamps to the eye.
        let normal = ((eye - center).normalize() + (lamps - center).normalize()).normalize();
        let plate = Shape::board(center, Vec3::X, normal, Vec3::new(1.25, 0.01, 0.17));
        w.object(&format!("plate {roughness}"), &plate, steel);
    }
    for (i, radius) in [0.025f32, 0.06, 0.13, 0.28].into_iter().enumerate() {
        let light = w.emitter(&format!("light {radius}"), f64::from(0.25 / (radius * radius)));
        let center = [-1.05 + 0.65 * i as f32 + 0.15 * (i / 3) as f32, lamps.y, lamps.z];
        let mut lamp = Shape::sphere(center, radius, 2);
        lamp.normals.clear();
        w.object(&format!("lamp {radius}"), &lamp, light);
    }
    let [x, y, z] = eye.to_array().map(f64::from);
    w.wide_camera("camera", [x, y, z], [0.0, 0.8, 0.0], 46.0, 4.0 / 3.0);
    w.glb()
}

//! Scenes about textures.

use super::png;
use super::shapes::{Shape, Side};
use super::writer::Writer;
use serde_json::{Value, json};

const REPEAT: u32 = 10_497;
const CLAMP: u32 = 33_071;
const MIRROR: u32 = 33_648;
const NEAREST: u32 = 9728;
const LINEAR: u32 = 9729;
/// Texels along each side of the images.
const SIZE: u32 = 64;

/// One panel for each thing a texture can do, in two rows before a lamp: wrap modes and filters of a base colour that
/// has no symmetry; a transformed one; a normal map; metallic and roughness maps; an emissive map; a leaf with an alpha
/// mask, seen from behind; vertex colours.
pub(super) fn textured() -> Vec<u8> {
    let mut w = Writer::new(
        "textured",
        &["KHR_materials_emissive_strength", "KHR_materials_specular", "KHR_texture_transform"],
    );
    let arrow = w.image("arrow", &png::encode(SIZE, SIZE, arrow));
    let tiles = w.image("tiles", &png::encode(4, 4, tiles));
    let bumps = w.image("bumps", &png::encode(SIZE, SIZE, bumps));
    let grades = w.image("grades", &png::encode(SIZE, SIZE, grades));
    let leaf = w.image("leaf", &png::encode(SIZE, SIZE, leaf));
    let repeat = w.texture(arrow, REPEAT, LINEAR);
    let clamp = w.texture(arrow, CLAMP, LINEAR);
    let mirror = w.texture(arrow, MIRROR, LINEAR);
    let nearest = w.texture(tiles, REPEAT, NEAREST);
    let linear = w.texture(tiles, REPEAT, LINEAR);
    let bumps = w.texture(bumps, REPEAT, LINEAR);
    let grades = w.texture(grades, CLAMP, LINEAR);
    let leaf = w.texture(leaf, CLAMP, LINEAR);

    let turned = json!({ "index": repeat, "extensions": { "KHR_texture_transform":
        { "offset": [0.5, 0.5], "rotation": 0.5, "scale": [0.75, 0.75] } } });
    let bumpy = json!({
        "name": "normal map",
        "pbrMetallicRoughness": { "baseColorFactor": [0.7, 0.7, 0.7, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.4 },
        "normalTexture": { "index": bumps }
    });
    let graded = json!({
        "name": "metallic-roughness map",
        "pbrMetallicRoughness": { "baseColorFactor": [0.9, 0.75, 0.4, 1.0], "metallicRoughnessTexture": { "index": grades } }
    });
    let glowing = json!({
        "name": "emissive map",
        "pbrMetallicRoughness": { "baseColorFactor": [0.02, 0.02, 0.02, 1.0], "metallicFactor": 0.0 },
        "emissiveFactor": [1.0, 1.0, 1.0],
        "emissiveTexture": { "index": nearest },
        "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 2.0 } }
    });
    let masked = json!({
        "name": "alpha mask",
        "doubleSided": true,
        "alphaMode": "MASK",
        "alphaCutoff": 0.5,
        "pbrMetallicRoughness": { "baseColorTexture": { "index": leaf }, "metallicFactor": 0.0 }
    });
    let panels: [(&str, Value, f32); 10] = [
        ("repeat", matt("repeat", json!({ "index": repeat })), 2.5),
        ("clamp", matt("clamp", json!({ "index": clamp })), 2.5),
        ("mirror", matt("mirror", json!({ "index": mirror })), 2.5),
        ("nearest", matt("nearest", json!({ "index": nearest })), 1.0),
        ("linear", matt("linear", json!({ "index": linear })), 1.0),
        ("transformed", matt("transformed", turned), 2.5),
        ("normal map", bumpy, 1.0),
        ("metallic-roughness map", graded, 1.0),
        ("emissive map", glowing, 1.0),
        ("alpha mask", masked, 1.0),
    ];
    for (i, (name, material, repeats)) in panels.into_iter().enumerate() {
        let material = w.material(material);
        let (x, y) = (-2.6 + 1.1 * (i % 5) as f32, if i < 5 { 1.4 } else { 0.2 });
        let mut panel = Shape::quad([[x, y, 0.0], [x + 1.0, y, 0.0], [x + 1.0, y + 1.0, 0.0], [x, y + 1.0, 0.0]]);
        if name == "alpha mask" {
            panel = panel.turned();
        }
        w.object(name, &panel.repeated(repeats), material);
    }
    surroundings(&mut w);
    w.glb()
}

/// Floor with vertex colours, wall, lamp and camera.
fn surroundings(w: &mut Writer) {
    let white = w.lambert("white", [1.0, 1.0, 1.0]);
    let gray = w.lambert("gray", [0.4, 0.4, 0.4]);
    let light = w.emitter("light", 10.0);
    let mut floor = Shape::side(Side::Top, [-4.0, -1.0, -1.0], [4.0, 0.0, 4.0]).plain();
    floor.colors = vec![[0.7, 0.3, 0.3, 1.0], [0.3, 0.7, 0.3, 1.0], [0.3, 0.3, 0.7, 1.0], [0.6, 0.6, 0.6, 1.0]];
    w.object("vertex colours", &floor, white);
    w.object("wall", &Shape::side(Side::Front, [-4.0, 0.0, -2.0], [4.0, 4.0, -1.0]).plain(), gray);
    w.object("lamp", &Shape::side(Side::Bottom, [-1.0, 4.0, 1.5], [1.0, 4.1, 3.5]).plain(), light);
    w.camera("camera", [0.1, 1.4, 8.0], [0.1, 1.3, 0.0], 40.0);
}

fn matt(name: &str, texture: Value) -> Value {
    json!({
        "name": name,
        "pbrMetallicRoughness": { "baseColorTexture": texture, "metallicFactor": 0.0 },
        "extensions": { "KHR_materials_specular": { "specularFactor": 0.0 } }
    })
}

/// A block with a label, as .gltf with its buffer and image in files beside it.
pub(super) fn labelled_box() -> (Vec<u8>, Vec<u8>, Vec<u8>) {
    let mut w = Writer::new("box", &["KHR_lights_punctual", "KHR_materials_specular"]);
    let image = w.push("images", json!({ "name": "label", "uri": "box.png" }));
    let texture = w.texture(image, CLAMP, LINEAR);
    let label = w.material(matt("label", json!({ "index": texture })));
    let white = w.lambert("white", [0.7, 0.7, 0.7]);
    w.object("box", &Shape::cuboid([-0.5, 0.0, -0.5], [0.5, 1.0, 0.5]), label);
    w.object("floor", &Shape::side(Side::Top, [-3.0, -1.0, -3.0], [3.0, 0.0, 3.0]).plain(), white);
    w.light("bulb", json!({ "type": "point", "intensity": 12.0 }), [1.5, 2.5, 2.0], [0.0, 0.0, 0.0]);
    w.camera("camera", [1.8, 1.7, 2.6], [0.0, 0.45, 0.0], 36.0);
    let (gltf, bin) = w.gltf("box.bin");
    (gltf, bin, png::encode(SIZE, SIZE, arrow))
}

/// An arrow up on a ground that goes from blue (left) to orange (right): no turn or mirroring leaves it as it is.
fn arrow(x: u32, y: u32) -> [u8; 4] {
    let shaft = (26..38).contains(&x) && (28..58).contains(&y);
    let head = (6..28).contains(&y) && x.abs_diff(32) <= y - 6;
    if shaft || head {
        return [245, 245, 240, 255];
    }
    let t = x * 255 / (SIZE - 1);
    [(40 + t * 180 / 255) as u8, (70 + t * 50 / 255) as u8, (200 - t * 170 / 255) as u8, 255]
}

/// Sixteen clearly different texels.
fn tiles(x: u32, y: u32) -> [u8; 4] {
    [(40 + 60 * x) as u8, (40 + 60 * y) as u8, if (x + y).is_multiple_of(2) { 40 } else { 200 }, 255]
}

/// Round bosses in relief, 16 of them: normals of spherical caps, (0, 0, 1) between.
fn bumps(x: u32, y: u32) -> [u8; 4] {
    let offset = |v: u32| ((v % 16) as f32 + 0.5 - 8.0) / 7.0;
    let (dx, dy) = (offset(x), -offset(y));
    let inside = dx * dx + dy * dy < 1.0;
    // A cap of half the sphere's radius: slopes up to 30°.
    let (nx, ny) = if inside { (0.5 * dx, 0.5 * dy) } else { (0.0, 0.0) };
    let nz = (1.0 - nx * nx - ny * ny).sqrt();
    let byte = |v: f32| ((v * 0.5 + 0.5) * 255.0).round() as u8;
    [byte(nx), byte(ny), byte(nz), 255]
}

/// Roughness (green) grows to the right, metallic (blue) is 0 in the lower half and 1 in the upper.
fn grades(x: u32, y: u32) -> [u8; 4] {
    [0, (x * 255 / (SIZE - 1)) as u8, if y < SIZE / 2 { 255 } else { 0 }, 255]
}

/// A leaf: where two circles overlap, with a vein, on nothing.
fn leaf(x: u32, y: u32) -> [u8; 4] {
    let (px, py) = (x as i32 - 32, y as i32 - 32);
    let circle = |cx: i32| (px - cx) * (px - cx) + py * py < 36 * 36;
    let alpha = if circle(-20) && circle(20) { 255 } else { 0 };
    if px == 0 { [140, 170, 60, alpha] } else { [40, 120, 30, alpha] }
}

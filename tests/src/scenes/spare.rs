//! Scenes that hold more than an image of them needs, and scenes drawn at random from parts that are needed or not.

use super::png;
use super::shapes::{Shape, Side};
use super::writer::Writer;
use gatherlight_render::import::SceneBundle;
use serde_json::{Value, json};

const EXTENSIONS: &[&str] = &[
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_volume",
];
const REPEAT: u32 = 10_497;
const LINEAR: u32 = 9729;

/// A scene, and what of it an image can do without.
pub struct Spare {
    /// Its name in tables.
    pub name: &'static str,
    /// The file.
    pub bundle: SceneBundle,
    /// Whether a cluster is sent less than the whole file.
    pub is_cut: bool,
}

/// The scenes; `size` is the number of texels along each side of their images.
pub fn scenes(size: u32) -> Vec<Spare> {
    let spare = |name: &'static str, glb: Vec<u8>, is_cut| {
        let bundle = SceneBundle { name: format!("{name}.glb"), root: glb.into(), externals: Vec::new() };
        Spare { name, bundle, is_cut }
    };
    vec![
        spare("diffuse only", diffuse(), true),
        spare("mirrors only", mirrors(size), true),
        spare("no light", no_light(size), true),
        spare("one of a hundred", hundred(size, 1), true),
        spare("unlit", unlit(size), true),
        spare("one small caustic", caustic(), false),
        spare("interior", interior(size), false),
        spare("cameras and animations", moving(size), true),
        spare("one in view of a hundred", hundred(size, 100), false),
    ]
}

fn writer(name: &str) -> Writer {
    Writer::new(name, EXTENSIONS)
}

/// A closed box from −1 to 1 and a lamp below its ceiling, with a camera inside.
fn room(w: &mut Writer, wall: usize) {
    let lamp = w.emitter("lamp", 8.0);
    let walls = Shape::cuboid([-1.0; 3], [1.0; 3]).plain().turned();
    w.object("walls", &walls, wall);
    w.object("lamp", &Shape::side(Side::Bottom, [-0.4, 0.9, -0.4], [0.4, 0.92, 0.4]).plain(), lamp);
    w.camera("inside", [0.0, 0.0, 0.95], [0.0, -0.2, -1.0], 70.0);
}

/// A picture with no two texels alike.
fn picture(w: &mut Writer, name: &str, size: u32, tint: u32) -> usize {
    let texel = |x: u32, y: u32| [(x * 37 + tint) as u8 | 1, (y * 53 + tint) as u8 | 1, (x * y + tint) as u8 | 1, 255];
    let image = w.image(name, &png::encode(size, size, texel));
    w.texture(image, REPEAT, LINEAR)
}

fn textured(w: &mut Writer, name: &str, texture: usize) -> usize {
    w.material(json!({
        "name": name,
        "pbrMetallicRoughness": { "baseColorTexture": { "index": texture }, "metallicFactor": 0.0 },
        "extensions": { "KHR_materials_specular": { "specularFactor": 0.0 } }
    }))
}

/// Matt walls and balls whose meshes come with coordinates, tangents and joints that nothing reads.
fn diffuse() -> Vec<u8> {
    let mut w = writer("diffuse only");
    let wall = w.lambert("wall", [0.7, 0.6, 0.5]);
    room(&mut w, wall);
    let ball = Shape::sphere([0.2, -0.6, -0.2], 0.4, 4);
    let mesh = w.mesh("ball", &[(&ball, wall)]);
    let n = ball.positions.len();
    w.attribute(mesh, "TEXCOORD_0", "VEC2", &vec![[0.5, 0.25]; n]);
    w.attribute(mesh, "TANGENT", "VEC4", &vec![[1.0, 0.0, 0.0, 1.0]; n]);
    w.attribute(mesh, "WEIGHTS_0", "VEC4", &vec![[1.0, 0.0, 0.0, 0.0]; n]);
    w.root(json!({ "name": "ball", "mesh": mesh }));
    w.glb()
}

/// Metal all over and a lamp: nothing holds photons. The metal comes with maps of what metal has none of.
fn mirrors(size: u32) -> Vec<u8> {
    let mut w = writer("mirrors only");
    let map = picture(&mut w, "specular map", size, 3);
    let mirror = w.material(json!({
        "name": "mirror",
        "pbrMetallicRoughness": { "baseColorFactor": [0.9, 0.8, 0.7, 1.0], "metallicFactor": 1.0, "roughnessFactor": 0.0 },
        "extensions": { "KHR_materials_specular": { "specularColorTexture": { "index": map }, "specularTexture": { "index": map } } }
    }));
    room(&mut w, mirror);
    w.object("panel", &Shape::side(Side::Front, [-0.5, -0.5, -0.9], [0.5, 0.5, -0.8]), mirror);
    w.glb()
}

/// A textured room without a lamp.
fn no_light(size: u32) -> Vec<u8> {
    let mut w = writer("no light");
    let map = picture(&mut w, "wallpaper", size, 5);
    let wall = textured(&mut w, "wall", map);
    w.object("walls", &Shape::cuboid([-1.0; 3], [1.0; 3]).turned(), wall);
    w.camera("inside", [0.0, 0.0, 0.95], [0.0, -0.2, -1.0], 70.0);
    w.glb()
}

/// A hundred panels, each with a picture of its own, of which the scene places the first `placed`. One is in view.
fn hundred(size: u32, placed: usize) -> Vec<u8> {
    let mut w = writer("one of a hundred");
    let wall = w.lambert("wall", [0.6, 0.6, 0.6]);
    room(&mut w, wall);
    for i in 0..100 {
        let map = picture(&mut w, &format!("picture {i}"), size, 7 * i);
        let material = textured(&mut w, &format!("panel {i}"), map);
        // The first before the camera, the others in rows on the wall behind it.
        let (x, y) = ((i % 10) as f32 * 0.18 - 0.9, (i / 10) as f32 * 0.18 - 0.9);
        let panel = match i {
            0 => Shape::side(Side::Front, [-0.5, -0.5, -0.9], [0.5, 0.5, -0.8]),
            _ => Shape::side(Side::Back, [x, y, 0.98], [x + 0.15, y + 0.15, 0.99]),
        };
        let mesh = w.mesh(&format!("panel {i}"), &[(&panel, material)]);
        let node = json!({ "name": format!("panel {i}"), "mesh": mesh });
        // A node that no scene lists is not shown.
        if (i as usize) < placed {
            w.root(node)
        } else {
            w.push("nodes", node)
        };
    }
    w.glb()
}

/// Black surfaces that only glow, with maps that would matter if they were lit.
fn unlit(size: u32) -> Vec<u8> {
    let mut w = writer("unlit");
    let glow = picture(&mut w, "glow", size, 11);
    let spare = picture(&mut w, "base", size, 13);
    let rough = picture(&mut w, "roughness", size, 17);
    let screen = w.material(json!({
        "name": "screen",
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.0, 0.0, 0.0, 1.0], "baseColorTexture": { "index": spare },
            "metallicRoughnessTexture": { "index": rough }, "metallicFactor": 0.0
        },
        "emissiveFactor": [1.0, 1.0, 1.0],
        "emissiveTexture": { "index": glow },
        "extensions": { "KHR_materials_specular": { "specularFactor": 0.0 } }
    }));
    w.object("screen", &Shape::side(Side::Front, [-1.0, -1.0, -1.1], [1.0, 1.0, -1.0]), screen);
    w.camera("before it", [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], 60.0);
    w.glb()
}

/// A matt room with one small ball of glass.
fn caustic() -> Vec<u8> {
    let mut w = writer("one small caustic");
    let wall = w.lambert("wall", [0.7, 0.7, 0.7]);
    let glass = w.glass("glass", 1.5);
    room(&mut w, wall);
    w.object("ball", &Shape::sphere([0.2, -0.7, -0.2], 0.15, 3), glass);
    w.glb()
}

/// A room with a lamp, and around it a landscape that is not seen.
fn interior(size: u32) -> Vec<u8> {
    let mut w = writer("interior");
    let wall = w.lambert("wall", [0.7, 0.6, 0.5]);
    room(&mut w, wall);
    let map = picture(&mut w, "grass", size, 19);
    let grass = textured(&mut w, "grass", map);
    w.object("ground", &Shape::side(Side::Top, [-9.0, -2.0, -9.0], [9.0, -1.5, 9.0]).repeated(9.0), grass);
    w.object("hill", &Shape::sphere([5.0, -2.0, 2.0], 2.0, 4), wall);
    w.glb()
}

/// Twelve cameras, a long animation of a node and a skin that is worn by nothing.
fn moving(size: u32) -> Vec<u8> {
    let mut w = writer("cameras and animations");
    let map = picture(&mut w, "wallpaper", size, 23);
    let wall = textured(&mut w, "wall", map);
    room(&mut w, wall);
    for i in 0..11 {
        w.camera(&format!("camera {i}"), [0.1, 0.08 * f64::from(i), 0.9], [0.0, 0.0, -1.0], 60.0);
    }
    let frames = 20_000;
    let times: Vec<[f32; 1]> = (0..frames).map(|i| [i as f32 / 30.0]).collect();
    let places: Vec<[f32; 3]> = (0..frames).map(|i| [i as f32 * 1e-4, 0.0, 0.0]).collect();
    let (input, output) = (w.floats("SCALAR", &times), w.floats("VEC3", &places));
    w.push(
        "animations",
        json!({
            "name": "swing",
            "samplers": [{ "input": input, "output": output }],
            "channels": [{ "sampler": 0, "target": { "node": 0, "path": "translation" } }]
        }),
    );
    w.push("skins", json!({ "name": "bones", "joints": [0] }));
    w.glb()
}

/// A random number generator for scenes: SplitMix64.
struct Draw(u64);

impl Draw {
    fn below(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % n
    }
    fn one_in(&mut self, n: u64) -> bool {
        self.below(n) == 0
    }
    fn pick<T: Copy>(&mut self, values: &[T]) -> T {
        values[self.below(values.len() as u64) as usize]
    }
}

/// A scene drawn by `seed`: a box of materials with textures read or not, mirrors, glass, holes, lamps or none, meshes that
/// are placed or not, one camera or several.
pub fn random(seed: u64) -> SceneBundle {
    let mut draw = Draw(seed);
    let mut w = Writer::new("random", &[EXTENSIONS, &["KHR_lights_punctual"]].concat());
    let maps: Vec<usize> = (0..4).map(|i| picture(&mut w, &format!("map {i}"), 4 + i, 29 * i + seed as u32)).collect();
    let materials: Vec<usize> = (0..8).map(|i| material(&mut w, &mut draw, i, &maps)).collect();
    let walls = Shape::cuboid([-1.0; 3], [1.0; 3]).turned();
    w.object("walls", &walls, materials[0]);
    for i in 0..draw.below(6) {
        let (x, z) = (draw.below(9) as f32 * 0.15 - 0.6, draw.below(9) as f32 * 0.15 - 0.7);
        let shape = match draw.below(3) {
            0 => Shape::sphere([x, -0.5, z], 0.25, 1),
            1 => Shape::cuboid([x - 0.2, -0.9, z - 0.2], [x + 0.2, -0.3, z + 0.2]),
            _ => Shape::side(Side::Front, [x - 0.3, -0.6, z], [x + 0.3, 0.4, z + 0.1]),
        };
        let parts = [(&shape, draw.pick(&materials))];
        let mesh = w.mesh(&format!("mesh {i}"), &parts);
        if draw.one_in(3) {
            w.attribute(mesh, "TANGENT", "VEC4", &vec![[0.0, 1.0, 0.0, 1.0]; shape.positions.len()]);
        }
        if draw.one_in(3) {
            w.attribute(mesh, "TEXCOORD_1", "VEC2", &vec![[0.3, 0.6]; shape.positions.len()]);
        }
        if !draw.one_in(3) {
            w.root(json!({ "mesh": mesh }));
        }
    }
    if !draw.one_in(4) {
        let lamp = w.emitter("lamp", 6.0);
        w.object("lamp", &Shape::side(Side::Bottom, [-0.4, 0.9, -0.4], [0.4, 0.92, 0.4]).plain(), lamp);
    }
    if draw.one_in(3) {
        let intensity = draw.pick(&[0.0, 2.0]);
        w.light("point", json!({ "type": "point", "intensity": intensity }), [0.3, 0.5, 0.4], [0.0, 0.0, 0.0]);
    }
    for i in 0..1 + draw.below(3) {
        w.camera(&format!("camera {i}"), [0.1 * i as f64, 0.1, 0.95], [0.0, -0.2, -1.0], 70.0);
    }
    SceneBundle { name: "random.glb".into(), root: w.glb().into(), externals: Vec::new() }
}

/// A material whose factors are often 0 or 1, where textures stop to matter.
fn material(w: &mut Writer, draw: &mut Draw, index: usize, maps: &[usize]) -> usize {
    let textures = |draw: &mut Draw, at: &mut Value, keys: &[&str]| {
        for key in keys {
            if draw.one_in(2) {
                at[key] = json!({ "index": draw.pick(maps), "texCoord": draw.below(2) });
            }
        }
    };
    let shade = draw.pick(&[0.0, 0.5, 0.8]);
    let mut pbr = json!({
        "baseColorFactor": [shade, 0.7 * shade, 0.9 * shade, draw.pick(&[1.0, 0.6])],
        "metallicFactor": draw.pick(&[0.0, 0.0, 0.5, 1.0]),
        "roughnessFactor": draw.pick(&[0.0, 0.3, 1.0])
    });
    textures(draw, &mut pbr, &["baseColorTexture", "metallicRoughnessTexture"]);
    let mut specular = json!({ "specularFactor": draw.pick(&[0.0, 0.0, 1.0]) });
    textures(draw, &mut specular, &["specularTexture", "specularColorTexture"]);
    let mut transmission = json!({ "transmissionFactor": draw.pick(&[0.0, 0.0, 0.0, 1.0]) });
    textures(draw, &mut transmission, &["transmissionTexture"]);
    let glow = draw.pick(&[0.0, 0.0, 0.0, 1.0]);
    let mut m = json!({
        "name": format!("material {index}"),
        "pbrMetallicRoughness": pbr,
        "emissiveFactor": [glow, glow, glow],
        "alphaMode": draw.pick(&["OPAQUE", "OPAQUE", "MASK"]),
        "doubleSided": draw.one_in(2),
        "extensions": { "KHR_materials_specular": specular, "KHR_materials_transmission": transmission }
    });
    textures(draw, &mut m, &["normalTexture", "emissiveTexture"]);
    if draw.one_in(3) {
        m["extensions"]["KHR_materials_volume"] =
            json!({ "thicknessFactor": 1.0, "attenuationDistance": 0.5, "attenuationColor": [0.5, 0.9, 0.7] });
    }
    w.material(m)
}

/// The same scene as .gltf with its images and its buffer in files of their own.
///
/// # Panics
/// When it is not a .glb of this module.
pub fn with_external_files(bundle: &SceneBundle) -> SceneBundle {
    let word = |at: usize| u32::from_le_bytes(bundle.root[at..at + 4].try_into().expect("four bytes")) as usize;
    let json_end = 20 + word(12);
    let mut json: Value = serde_json::from_slice(&bundle.root[20..json_end]).expect("JSON");
    let bin = &bundle.root[json_end + 8..];
    let mut externals = vec![("geometry.bin".to_string(), bin.into())];
    json["buffers"][0]["uri"] = json!("geometry.bin");
    for i in 0..json["images"].as_array().map_or(0, Vec::len) {
        let view = &json["bufferViews"][json["images"][i]["bufferView"].as_u64().expect("a view") as usize];
        let at = |key: &str| view[key].as_u64().expect("a number") as usize;
        let uri = format!("picture{i}.png");
        externals.push((uri.clone(), bin[at("byteOffset")..at("byteOffset") + at("byteLength")].into()));
        json["images"][i] = json!({ "uri": uri });
    }
    let root = json.to_string().into_bytes().into();
    SceneBundle { name: bundle.name.replace(".glb", ".gltf"), root, externals }
}

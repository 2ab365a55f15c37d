//! Writes the scenes of the cases as .glb files in memory, so that they take the way of a user's file: importer, bundle,
//! cluster.

use gatherlight_render::import::SceneBundle;
use glam::{DAffine3, DMat3, DVec3};
use serde_json::{Value, json};

const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const EXTENSIONS: [&str; 6] = [
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_volume",
];

/// Vertices and the triangles between them.
#[derive(Clone, Debug, Default)]
pub(super) struct Shape {
    /// Vertices.
    pub(super) positions: Vec<[f32; 3]>,
    /// Counter-clockwise seen from the front.
    pub(super) triangles: Vec<[u32; 3]>,
}

impl Shape {
    /// A parallelogram with corner `o` and edges `u`, `v`; its front is towards `u × v`.
    pub(super) fn quad(o: [f32; 3], u: [f32; 3], v: [f32; 3]) -> Self {
        let at = |a: f32, b: f32| std::array::from_fn(|i| o[i] + a * u[i] + b * v[i]);
        Shape {
            positions: vec![at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        }
    }

    /// A box with its fronts outwards.
    pub(super) fn cuboid(low: [f32; 3], high: [f32; 3]) -> Self {
        let corner = |i: usize| std::array::from_fn(|axis| if i >> axis & 1 == 0 { low[axis] } else { high[axis] });
        let faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let triangles = faces.iter().flat_map(|f| [[f[0], f[1], f[2]], [f[0], f[2], f[3]]]).collect();
        Shape { positions: (0..8).map(corner).collect(), triangles }
    }

    /// A box with its fronts inwards.
    pub(super) fn room(low: [f32; 3], high: [f32; 3]) -> Self {
        let mut shape = Shape::cuboid(low, high);
        shape.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        shape
    }

    /// Adds the triangles of `other`.
    pub(super) fn join(&mut self, other: &Shape) {
        let first = self.positions.len() as u32;
        self.positions.extend(&other.positions);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + first)));
    }
}

/// A file in the making: everything hangs below one node, which scales and moves it in double precision.
#[derive(Clone, Debug)]
pub(super) struct Glb {
    json: Value,
    bin: Vec<u8>,
    scale: f64,
}

impl Glb {
    /// An empty scene.
    pub(super) fn new() -> Self {
        Self::placed(1.0, [0.0; 3])
    }

    /// An empty scene whose parts are scaled by `scale`, then moved by `by`. Intensities are as they are given.
    pub(super) fn placed(scale: f64, by: [f64; 3]) -> Self {
        let json = json!({
            "asset": { "version": "2.0", "generator": "gatherlight stability" },
            "extensionsUsed": EXTENSIONS,
            "scene": 0,
            "scenes": [{ "nodes": [0] }],
            "nodes": [{ "name": "all", "scale": [scale, scale, scale], "translation": by, "children": [] }],
        });
        Glb { json, bin: Vec::new(), scale }
    }

    /// The scale of everything.
    pub(super) fn scale(&self) -> f64 {
        self.scale
    }

    fn push(&mut self, section: &str, value: Value) -> usize {
        match &mut self.json[section] {
            Value::Array(list) => {
                list.push(value);
                list.len() - 1
            }
            other => {
                *other = json!([value]);
                0
            }
        }
    }

    fn node(&mut self, node: Value) {
        let index = self.push("nodes", node);
        if let Some(children) = self.json["nodes"][0]["children"].as_array_mut() {
            children.push(json!(index));
        }
    }

    /// A Lambertian surface that emits `radiance` from its front.
    pub(super) fn lambert(&mut self, albedo: f64, radiance: f64) -> usize {
        self.push(
            "materials",
            json!({
                "pbrMetallicRoughness": { "baseColorFactor": [albedo, albedo, albedo, 1.0], "metallicFactor": 0.0 },
                "emissiveFactor": [1.0, 1.0, 1.0],
                "extensions": {
                    "KHR_materials_emissive_strength": { "emissiveStrength": radiance },
                    "KHR_materials_specular": { "specularFactor": 0.0 }
                }
            }),
        )
    }

    /// A black surface that emits `radiance` from its front.
    pub(super) fn emitter(&mut self, radiance: f64) -> usize {
        self.lambert(0.0, radiance)
    }

    /// A metal that reflects everything at normal incidence, and by Schlick's formula at every other angle.
    pub(super) fn white_metal(&mut self, roughness: f64) -> usize {
        self.push(
            "materials",
            json!({ "pbrMetallicRoughness": { "metallicFactor": 1.0, "roughnessFactor": roughness } }),
        )
    }

    /// A clear solid body.
    pub(super) fn glass(&mut self, ior: f64, roughness: f64) -> usize {
        self.push(
            "materials",
            json!({
                "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": roughness },
                "extensions": {
                    "KHR_materials_transmission": { "transmissionFactor": 1.0 },
                    "KHR_materials_ior": { "ior": ior },
                    "KHR_materials_volume": { "thicknessFactor": 1.0 }
                }
            }),
        )
    }

    /// Puts `shape` into the scene.
    pub(super) fn add(&mut self, shape: &Shape, material: usize) {
        let at = |k: fn(f32, f32) -> f32, i: usize| shape.positions.iter().map(|p| p[i]).reduce(k);
        // A file with numbers that are not finite has bounds that JSON cannot write; readers must see it in the data.
        let bound = |k: fn(f32, f32) -> f32| [0, 1, 2].map(|i| at(k, i).filter(|v| v.is_finite()).unwrap_or(0.0));
        let (low, high) = (bound(f32::min), bound(f32::max));
        let positions: Vec<u8> = shape.positions.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        let indices: Vec<u8> = shape.triangles.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        let corners = 3 * shape.triangles.len();
        let (positions, indices) = (self.view(&positions), self.view(&indices));
        let count = shape.positions.len();
        let vertices = json!({ "bufferView": positions, "componentType": FLOAT, "type": "VEC3", "count": count,
                               "min": low, "max": high });
        let positions = self.push("accessors", vertices);
        let numbers = json!({ "bufferView": indices, "componentType": UNSIGNED_INT, "type": "SCALAR",
                              "count": corners });
        let indices = self.push("accessors", numbers);
        let primitive = json!({ "attributes": { "POSITION": positions }, "indices": indices, "material": material });
        let mesh = self.push("meshes", json!({ "primitives": [primitive] }));
        self.node(json!({ "mesh": mesh }));
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        let view = json!({ "buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len() });
        self.bin.extend(bytes);
        self.push("bufferViews", view)
    }

    /// A light of one colour at `position` that shines along `direction`: `kind` holds its type, and its cone.
    pub(super) fn light(&mut self, mut kind: Value, intensity: f64, position: [f64; 3], direction: [f64; 3]) {
        kind["intensity"] = json!(intensity);
        let lights = &mut self.json["extensions"]["KHR_lights_punctual"]["lights"];
        let number = lights.as_array().map_or(0, Vec::len);
        if number == 0 {
            *lights = json!([]);
        }
        if let Some(list) = lights.as_array_mut() {
            list.push(kind);
        }
        let matrix = look_along(position.into(), direction.into());
        self.node(json!({ "matrix": matrix, "extensions": { "KHR_lights_punctual": { "light": number } } }));
    }

    /// A point light.
    pub(super) fn point(&mut self, intensity: f64, position: [f64; 3]) {
        self.light(json!({ "type": "point" }), intensity, position, [0.0, -1.0, 0.0]);
    }

    /// A camera at `eye` that looks at `target`, with its full vertical angle in radians.
    pub(super) fn camera(&mut self, eye: [f64; 3], target: [f64; 3], yfov: f64) {
        let camera = self.push(
            "cameras",
            json!({ "type": "perspective", "perspective": { "yfov": yfov, "znear": 1e-3, "aspectRatio": 1.0 } }),
        );
        let (eye, target) = (DVec3::from(eye), DVec3::from(target));
        self.node(json!({ "matrix": look_along(eye, target - eye), "camera": camera }));
    }

    /// The file.
    pub(super) fn bundle(mut self, name: &str) -> SceneBundle {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        if self.json["nodes"][0]["children"].as_array().is_some_and(Vec::is_empty)
            && let Some(node) = self.json["nodes"][0].as_object_mut()
        {
            node.remove("children");
        }
        if !self.bin.is_empty() {
            self.json["buffers"] = json!([{ "byteLength": self.bin.len() }]);
        }
        let mut text = self.json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut parts = vec![(*b"JSON", text)];
        if !self.bin.is_empty() {
            parts.push((*b"BIN\0", self.bin));
        }
        let total = 12 + parts.iter().map(|(_, bytes)| 8 + bytes.len()).sum::<usize>();
        let mut file = Vec::with_capacity(total);
        file.extend(b"glTF");
        file.extend(2u32.to_le_bytes());
        file.extend((total as u32).to_le_bytes());
        for (kind, bytes) in parts {
            file.extend((bytes.len() as u32).to_le_bytes());
            file.extend(kind);
            file.extend(bytes);
        }
        SceneBundle { name: format!("{}.glb", name.replace(' ', "-")), root: file.into(), externals: Vec::new() }
    }
}

/// The matrix, column by column, of a node at `position` whose −z axis is `direction`.
fn look_along(position: DVec3, direction: DVec3) -> [f64; 16] {
    let z = -direction.normalize();
    let hint = if z.y.abs() < 0.9 { DVec3::Y } else { DVec3::X };
    let x = hint.cross(z).normalize();
    let m = DAffine3 { matrix3: DMat3::from_cols(x, z.cross(x), z), translation: position };
    let [x, y, z, p] = [m.matrix3.x_axis, m.matrix3.y_axis, m.matrix3.z_axis, m.translation];
    [x.x, x.y, x.z, 0.0, y.x, y.y, y.z, 0.0, z.x, z.y, z.z, 0.0, p.x, p.y, p.z, 1.0]
}

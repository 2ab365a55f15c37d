//! Writes glTF 2.0.

use super::shapes::Shape;
use glam::DVec3;
use serde_json::{Value, json};

const FLOAT: u32 = 5126;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;

/// A glTF file in the making: one scene, one buffer.
pub(crate) struct Writer {
    json: Value,
    bin: Vec<u8>,
}

impl Writer {
    /// An empty scene with the extensions that its parts will use.
    pub(crate) fn new(name: &str, extensions: &[&str]) -> Self {
        let mut json = json!({
            "asset": { "version": "2.0", "generator": "gatherlight make_scenes" },
            "scene": 0,
            "scenes": [{ "name": name, "nodes": [] }]
        });
        if !extensions.is_empty() {
            json["extensionsUsed"] = json!(extensions);
        }
        Writer { json, bin: Vec::new() }
    }

    /// Appends to a section; returns the index.
    pub(crate) fn push(&mut self, section: &str, value: Value) -> usize {
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

    /// Appends a node to the scene.
    pub(crate) fn root(&mut self, node: Value) -> usize {
        let index = self.push("nodes", node);
        if let Some(list) = self.json["scenes"][0]["nodes"].as_array_mut() {
            list.push(json!(index));
        }
        index
    }

    /// Appends a material.
    pub(crate) fn material(&mut self, material: Value) -> usize {
        self.push("materials", material)
    }

    /// Appends a Lambertian material.
    pub(crate) fn lambert(&mut self, name: &str, color: [f64; 3]) -> usize {
        let [r, g, b] = color;
        self.material(json!({
            "name": name,
            "pbrMetallicRoughness": { "baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0 },
            "extensions": { "KHR_materials_specular": { "specularFactor": 0.0 } }
        }))
    }

    /// Appends a black material that emits `radiance` in all three channels.
    pub(crate) fn emitter(&mut self, name: &str, radiance: f64) -> usize {
        self.material(json!({
            "name": name,
            "pbrMetallicRoughness": { "baseColorFactor": [0.0, 0.0, 0.0, 1.0], "metallicFactor": 0.0 },
            "emissiveFactor": [1.0, 1.0, 1.0],
            "extensions": {
                "KHR_materials_emissive_strength": { "emissiveStrength": radiance },
                "KHR_materials_specular": { "specularFactor": 0.0 }
            }
        }))
    }

    /// Appends a glossy coat of index 1.5 over a Lambertian ground.
    pub(crate) fn coated(&mut self, name: &str, color: [f64; 3], roughness: f64) -> usize {
        let [r, g, b] = color;
        self.material(json!({
            "name": name,
            "pbrMetallicRoughness": {
                "baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0, "roughnessFactor": roughness
            }
        }))
    }

    /// Appends a smooth glass of the given index of refraction.
    pub(crate) fn glass(&mut self, name: &str, ior: f64) -> usize {
        self.material(json!({
            "name": name,
            "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 0.0 },
            "extensions": {
                "KHR_materials_transmission": { "transmissionFactor": 1.0 },
                "KHR_materials_ior": { "ior": ior },
                "KHR_materials_volume": { "thicknessFactor": 1.0 }
            }
        }))
    }

    /// Appends a metal.
    pub(crate) fn metal(&mut self, name: &str, f0: [f64; 3], roughness: f64) -> usize {
        let [r, g, b] = f0;
        self.material(json!({
            "name": name,
            "pbrMetallicRoughness": { "baseColorFactor": [r, g, b, 1.0], "roughnessFactor": roughness }
        }))
    }

    /// Appends a mesh with one primitive for each shape and material.
    pub(crate) fn mesh(&mut self, name: &str, parts: &[(&Shape, usize)]) -> usize {
        let primitives: Vec<Value> = parts.iter().map(|(shape, material)| self.primitive(shape, *material)).collect();
        self.push("meshes", json!({ "name": name, "primitives": primitives }))
    }

    /// Adds a vertex attribute to the first primitive of a mesh.
    pub(crate) fn attribute<const N: usize>(&mut self, mesh: usize, name: &str, kind: &str, values: &[[f32; N]]) {
        let accessor = self.floats(kind, values);
        self.json["meshes"][mesh]["primitives"][0]["attributes"][name] = json!(accessor);
    }

    /// Appends a mesh of one shape, and a node that places it where it is.
    pub(crate) fn object(&mut self, name: &str, shape: &Shape, material: usize) -> usize {
        let mesh = self.mesh(name, &[(shape, material)]);
        self.root(json!({ "name": name, "mesh": mesh }))
    }

    fn primitive(&mut self, shape: &Shape, material: usize) -> Value {
        let positions = self.floats("VEC3", &shape.positions);
        let low = shape.positions.iter().copied().reduce(|a, b| std::array::from_fn(|i| a[i].min(b[i])));
        let high = shape.positions.iter().copied().reduce(|a, b| std::array::from_fn(|i| a[i].max(b[i])));
        self.json["accessors"][positions]["min"] = json!(low.unwrap_or_default());
        self.json["accessors"][positions]["max"] = json!(high.unwrap_or_default());
        let mut attributes = json!({ "POSITION": positions });
        if !shape.normals.is_empty() {
            attributes["NORMAL"] = json!(self.floats("VEC3", &shape.normals));
        }
        if !shape.uvs.is_empty() {
            attributes["TEXCOORD_0"] = json!(self.floats("VEC2", &shape.uvs));
        }
        if !shape.colors.is_empty() {
            attributes["COLOR_0"] = json!(self.floats("VEC4", &shape.colors));
        }
        let short = shape.positions.len() <= usize::from(u16::MAX);
        let mut bytes = Vec::new();
        for index in shape.triangles.iter().flatten() {
            let wide = index.to_le_bytes();
            bytes.extend_from_slice(if short { &wide[..2] } else { &wide });
        }
        let component = if short { UNSIGNED_SHORT } else { UNSIGNED_INT };
        let indices = self.accessor(component, "SCALAR", 3 * shape.triangles.len(), &bytes);
        json!({ "attributes": attributes, "indices": indices, "material": material })
    }

    /// Appends an accessor of vectors of floats.
    pub(crate) fn floats<const N: usize>(&mut self, kind: &str, values: &[[f32; N]]) -> usize {
        let bytes: Vec<u8> = values.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        self.accessor(FLOAT, kind, values.len(), &bytes)
    }

    /// Appends an accessor with a view of its own; returns its index.
    pub(crate) fn accessor(&mut self, component: u32, kind: &str, count: usize, bytes: &[u8]) -> usize {
        let view = self.view(bytes);
        self.push("accessors", json!({ "bufferView": view, "componentType": component, "count": count, "type": kind }))
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        let offset = self.bin.len();
        self.bin.extend_from_slice(bytes);
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        self.push("bufferViews", json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes.len() }))
    }

    /// Appends an embedded PNG; returns the image.
    pub(crate) fn image(&mut self, name: &str, png: &[u8]) -> usize {
        let view = self.view(png);
        self.push("images", json!({ "name": name, "bufferView": view, "mimeType": "image/png" }))
    }

    /// Appends a texture of an image with a wrap mode and a filter by their glTF numbers.
    pub(crate) fn texture(&mut self, image: usize, wrap: u32, filter: u32) -> usize {
        let sampler = self.push("samplers", json!({ "wrapS": wrap, "wrapT": wrap, "magFilter": filter }));
        self.push("textures", json!({ "source": image, "sampler": sampler }))
    }

    /// Appends a perspective camera for square pictures and a node that looks from `eye` to `target`, +y up.
    pub(crate) fn camera(&mut self, name: &str, eye: [f64; 3], target: [f64; 3], yfov_degrees: f64) {
        self.wide_camera(name, eye, target, yfov_degrees, 1.0);
    }

    /// Appends a perspective camera likewise, for pictures `aspect` times as wide as high.
    pub(crate) fn wide_camera(&mut self, name: &str, eye: [f64; 3], target: [f64; 3], yfov_degrees: f64, aspect: f64) {
        let yfov = yfov_degrees * (std::f64::consts::PI / 180.0);
        let lens = json!({ "yfov": yfov, "aspectRatio": aspect, "znear": 0.01 });
        let lens = json!({ "type": "perspective", "perspective": lens });
        let camera = self.push("cameras", lens);
        self.root(json!({ "name": name, "camera": camera, "matrix": look_at(eye, target) }));
    }

    /// Appends an orthographic camera likewise; `half` is half its width and height.
    pub(crate) fn orthographic_camera(&mut self, name: &str, eye: [f64; 3], target: [f64; 3], half: f64) {
        let lens = json!({ "xmag": half, "ymag": half, "znear": 0.01, "zfar": 100.0 });
        let camera = self.push("cameras", json!({ "type": "orthographic", "orthographic": lens }));
        self.root(json!({ "name": name, "camera": camera, "matrix": look_at(eye, target) }));
    }

    /// Appends a punctual light and a node that looks from `eye` to `target`.
    pub(crate) fn light(&mut self, name: &str, light: Value, eye: [f64; 3], target: [f64; 3]) {
        let extension = &mut self.json["extensions"]["KHR_lights_punctual"]["lights"];
        if extension.is_null() {
            *extension = json!([]);
        }
        let index = extension.as_array().map_or(0, Vec::len);
        if let Some(lights) = extension.as_array_mut() {
            lights.push(light);
        }
        let reference = json!({ "KHR_lights_punctual": { "light": index } });
        self.root(json!({ "name": name, "extensions": reference, "matrix": look_at(eye, target) }));
    }

    /// The .glb.
    pub(crate) fn glb(mut self) -> Vec<u8> {
        self.json["buffers"] = json!([{ "byteLength": self.bin.len() }]);
        let mut text = self.json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let length = 12 + 8 + text.len() + 8 + self.bin.len();
        let mut out = b"glTF".to_vec();
        out.extend([2, length as u32].map(u32::to_le_bytes).as_flattened());
        out.extend((text.len() as u32).to_le_bytes());
        out.extend(b"JSON");
        out.extend(text);
        out.extend((self.bin.len() as u32).to_le_bytes());
        out.extend(b"BIN\0");
        out.extend(self.bin);
        out
    }

    /// The .gltf, whose buffer is the file `uri`, and that file.
    pub(crate) fn gltf(mut self, uri: &str) -> (Vec<u8>, Vec<u8>) {
        self.json["buffers"] = json!([{ "byteLength": self.bin.len(), "uri": uri }]);
        (format!("{:#}\n", self.json).into_bytes(), self.bin)
    }
}

/// Columns of the matrix that puts the origin at `eye` and turns −z to `target`, +y up.
fn look_at(eye: [f64; 3], target: [f64; 3]) -> [f64; 16] {
    let (eye, target) = (DVec3::from_array(eye), DVec3::from_array(target));
    let z = (eye - target).normalize();
    let up = if z.y.abs() > 0.999 { DVec3::NEG_Z } else { DVec3::Y };
    let x = up.cross(z).normalize();
    let y = z.cross(x);
    [x.x, x.y, x.z, 0.0, y.x, y.y, y.z, 0.0, z.x, z.y, z.z, 0.0, eye.x, eye.y, eye.z, 1.0]
}

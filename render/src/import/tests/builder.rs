//! Small glTF files made from parts, for tests.

use crate::import::{SceneBundle, load};
use crate::scene::description::SceneDescription;
use serde_json::{Value, json};
use std::sync::Arc;

/// Component types by their glTF numbers.
pub(super) const U8: u64 = 5121;
pub(super) const U16: u64 = 5123;
pub(super) const U32: u64 = 5125;
pub(super) const F32: u64 = 5126;

/// A glTF file in the making.
#[derive(Clone)]
pub(super) struct Builder {
    pub(super) json: Value,
    pub(super) bin: Vec<u8>,
    pub(super) externals: Vec<(String, Arc<[u8]>)>,
}

pub(super) fn f32s(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}
pub(super) fn u16s(values: &[u16]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}
pub(super) fn u32s(values: &[u32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// Corners of the unit square in the xy plane, counter-clockwise seen from +z.
pub(super) const SQUARE: [f32; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0];

impl Builder {
    /// No nodes, no meshes; one scene.
    pub(super) fn empty() -> Self {
        let json = json!({
            "asset": { "version": "2.0" },
            "scene": 0,
            "scenes": [{ "nodes": [] }],
            "buffers": [{ "byteLength": 0 }]
        });
        Builder { json, bin: Vec::new(), externals: Vec::new() }
    }
    /// One node "Square" with a mesh "Sheet" of one primitive: accessor 0 positions, accessor 1 indices (u16).
    pub(super) fn square() -> Self {
        let mut b = Builder::empty();
        let positions = b.accessor(F32, "VEC3", 4, &f32s(&SQUARE));
        let indices = b.accessor(U16, "SCALAR", 6, &u16s(&[0, 1, 2, 0, 2, 3]));
        b.push(
            "meshes",
            json!({ "name": "Sheet", "primitives": [{ "attributes": { "POSITION": positions }, "indices": indices }] }),
        );
        b.node(json!({ "name": "Square", "mesh": 0 }));
        b
    }
    /// The square with a material of the given members.
    pub(super) fn with_material(material: Value) -> Self {
        let mut b = Builder::square();
        let index = b.push("materials", material);
        b.set("/meshes/0/primitives/0/material", json!(index));
        b
    }
    /// Appends to a section; returns the index.
    pub(super) fn push(&mut self, section: &str, value: Value) -> usize {
        let list = &mut self.json[section];
        if list.is_null() {
            *list = json!([]);
        }
        let list = list.as_array_mut().expect("a section");
        list.push(value);
        list.len() - 1
    }
    /// Appends a root node.
    pub(super) fn node(&mut self, value: Value) -> usize {
        let index = self.push("nodes", value);
        self.json["scenes"][0]["nodes"].as_array_mut().expect("nodes").push(json!(index));
        index
    }
    /// Appends a buffer view.
    pub(super) fn view(&mut self, bytes: &[u8]) -> usize {
        while !self.bin.len().is_multiple_of(4) {
            self.bin.push(0);
        }
        let offset = self.bin.len();
        self.bin.extend_from_slice(bytes);
        self.json["buffers"][0]["byteLength"] = json!(self.bin.len());
        self.push("bufferViews", json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes.len() }))
    }
    /// Appends an accessor with its own view.
    pub(super) fn accessor(&mut self, component: u64, kind: &str, count: usize, bytes: &[u8]) -> usize {
        let view = self.view(bytes);
        self.push("accessors", json!({ "bufferView": view, "componentType": component, "type": kind, "count": count }))
    }
    /// Appends an accessor and makes it an attribute of the first primitive.
    pub(super) fn attribute(&mut self, name: &str, component: u64, kind: &str, count: usize, bytes: &[u8]) -> usize {
        let index = self.accessor(component, kind, count, bytes);
        self.set(&format!("/meshes/0/primitives/0/attributes/{name}"), json!(index));
        index
    }
    /// Appends a texture of a PNG or JPEG.
    pub(super) fn texture(&mut self, image: &[u8], mime: &str) -> usize {
        let view = self.view(image);
        let source = self.push("images", json!({ "bufferView": view, "mimeType": mime }));
        self.push("textures", json!({ "source": source }))
    }
    /// Sets the member at a JSON pointer whose parent exists.
    pub(super) fn set(&mut self, pointer: &str, value: Value) {
        let (parent, key) = pointer.rsplit_once('/').expect("a pointer");
        let parent = self.json.pointer_mut(parent).unwrap_or_else(|| panic!("no {parent}"));
        match parent {
            Value::Array(list) => list[key.parse::<usize>().expect("an index")] = value,
            other => other[key] = value,
        }
    }
    /// [`Builder::set`] on a copy.
    pub(super) fn but(&self, pointer: &str, value: Value) -> Self {
        let mut copy = self.clone();
        copy.set(pointer, value);
        copy
    }
    /// A copy without the member at a pointer.
    pub(super) fn without(&self, pointer: &str) -> Self {
        let mut copy = self.clone();
        let (parent, key) = pointer.rsplit_once('/').expect("a pointer");
        copy.json.pointer_mut(parent).and_then(Value::as_object_mut).expect("an object").remove(key).expect("a member");
        copy
    }
    /// The .glb.
    pub(super) fn glb(&self) -> Vec<u8> {
        glb(self.json.to_string().as_bytes(), Some(&self.bin))
    }
    /// As a bundle named `test.glb`.
    pub(super) fn bundle(&self) -> SceneBundle {
        SceneBundle { name: "test.glb".into(), root: self.glb().into(), externals: self.externals.clone() }
    }
    /// The scene.
    #[track_caller]
    pub(super) fn scene(&self) -> SceneDescription {
        load(&self.bundle()).unwrap_or_else(|e| panic!("{e}"))
    }
    /// The scene, which must have no warnings.
    #[track_caller]
    pub(super) fn clean_scene(&self) -> SceneDescription {
        let scene = self.scene();
        assert_eq!(scene.warnings, Vec::<String>::new());
        scene
    }
    /// The message of the error.
    #[track_caller]
    pub(super) fn error(&self) -> String {
        load(&self.bundle()).expect_err("an error").to_string()
    }
    /// The only warning.
    #[track_caller]
    pub(super) fn warning(&self) -> String {
        let warnings = self.scene().warnings;
        assert_eq!(warnings.len(), 1, "{warnings:?}");
        warnings[0].clone()
    }
}

/// A .glb of these chunks, padded.
pub(super) fn glb(json: &[u8], bin: Option<&[u8]>) -> Vec<u8> {
    let mut body = Vec::new();
    let mut chunk = |kind: &[u8; 4], data: &[u8], fill: u8| {
        body.extend((data.len().next_multiple_of(4) as u32).to_le_bytes());
        body.extend(kind);
        body.extend(data);
        body.resize(body.len().next_multiple_of(4), fill);
    };
    chunk(b"JSON", json, b' ');
    if let Some(bin) = bin {
        chunk(b"BIN\0", bin, 0);
    }
    let mut out = b"glTF\x02\0\0\0".to_vec();
    out.extend((12 + body.len() as u32).to_le_bytes());
    out.extend(body);
    out
}

/// A PNG with 8-bit RGBA pixels.
pub(super) fn png(width: u32, height: u32, rgba: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut out);
    image::ImageEncoder::write_image(encoder, rgba, width, height, image::ExtendedColorType::Rgba8).expect("a PNG");
    out
}

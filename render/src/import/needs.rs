//! Which bytes of which files an image needs, known from the JSON alone.

use super::accessor::Layout;
use super::buffer::{ByteRange, View};
use super::document::Document;
use super::json::{Item, Result};
use super::material::Materials;
use super::topology::Topology;
use super::uri;
use super::{Structure, Wanted};
use std::collections::BTreeSet;

/// The bytes of buffers, and the images, that loading a scene reads.
#[derive(Default)]
pub(super) struct Needs {
    ranges: BTreeSet<ByteRange>,
    /// Images of the file, ascending.
    images: BTreeSet<usize>,
}

impl Needs {
    /// What the meshes and textures of `structure` read.
    ///
    /// # Errors
    /// When a primitive or an image is damaged.
    pub(super) fn of(
        doc: &Document,
        structure: &Structure,
        views: &[View],
        layouts: &[Layout],
        wanted: Wanted,
    ) -> Result<Self> {
        let mut needs = Needs::default();
        for &mesh in &structure.meshes {
            for primitive in doc.item("meshes", mesh)?.require("primitives")?.elements()? {
                if Topology::read(&primitive)?.is_none() {
                    continue;
                }
                for accessor in read_accessors(doc, &primitive, &structure.materials, wanted)? {
                    needs.ranges.extend(layouts.get(accessor).into_iter().flat_map(Layout::ranges));
                }
            }
        }
        let images = &structure.materials.textures.images;
        for &image in images.iter().filter(|_| wanted.images) {
            needs.images.insert(image);
            let view = doc.reference(&doc.item("images", image)?, "bufferView", "bufferViews")?;
            needs.ranges.extend(view.and_then(|v| views.get(v)).map(View::range));
        }
        Ok(needs)
    }
    /// The bytes of buffers, ascending.
    pub(super) fn ranges(&self) -> impl Iterator<Item = &ByteRange> {
        self.ranges.iter()
    }
    /// Whether anything of a buffer is read.
    pub(super) fn reads_buffer(&self, buffer: usize) -> bool {
        let first = ByteRange { buffer, offset: 0, length: 0 };
        self.ranges.range(first..).next().is_some_and(|r| r.buffer == buffer)
    }
    /// Whether an image is read.
    pub(super) fn reads_image(&self, image: usize) -> bool {
        self.images.contains(&image)
    }
    /// Bytes of a buffer that are read, those read twice counted once.
    pub(super) fn bytes_of(&self, buffer: usize) -> u64 {
        super::cut::Pieces::of(self.ranges().filter(|r| r.buffer == buffer)).len()
    }
    /// Names of the external files that are read, in file order without duplicates.
    ///
    /// # Errors
    /// When a name is no text.
    pub(super) fn external_uris(&self, doc: &Document) -> Result<Vec<String>> {
        let mut uris: Vec<String> = Vec::new();
        let buffers = (0..doc.count("buffers")).filter(|b| self.reads_buffer(*b)).map(|b| ("buffers", b));
        let images = self.images.iter().map(|i| ("images", *i));
        for (section, index) in buffers.chain(images) {
            let uri = doc.item(section, index)?.opt("uri", Item::text)?;
            if let Some(uri) = uri.filter(|u| !uri::is_data(u) && !uris.iter().any(|known| known == u)) {
                uris.push(uri.to_owned());
            }
        }
        Ok(uris)
    }
}

/// Accessors that reading a primitive opens, and perhaps some more where it turns out to have no triangles.
fn read_accessors(doc: &Document, primitive: &Item, materials: &Materials, wanted: Wanted) -> Result<Vec<usize>> {
    let attributes = primitive.require("attributes")?;
    let mut found = Vec::new();
    found.extend(doc.reference(primitive, "indices", "accessors")?);
    let material = materials.index(doc.reference(primitive, "material", "materials")?);
    for name in read_attributes(materials, material, wanted) {
        found.extend(doc.reference(&attributes, &name, "accessors")?);
    }
    Ok(found)
}

/// Names of the vertex attributes that a mesh with `material` is read with.
pub(super) fn read_attributes(materials: &Materials, material: usize, wanted: Wanted) -> BTreeSet<String> {
    let mut names: BTreeSet<String> = ["POSITION", "NORMAL", "COLOR_0"].map(String::from).into();
    let sources = materials.uv_sources.get(material).into_iter().flatten();
    names.extend(sources.filter(|s| s.read).map(|s| format!("TEXCOORD_{}", s.set)));
    if wanted.everything {
        names.extend(["TEXCOORD_0", "TEXCOORD_1", "TANGENT"].map(String::from));
    }
    if materials.list.get(material).is_some_and(|m| m.normal_texture.is_some()) {
        names.insert("TANGENT".into());
    }
    names
}

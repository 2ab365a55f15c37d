//! What of a scene file is read and what is left out, for the plan.
//!
//! Everything but the size of decoded images is known from the JSON, so that a cut scene says the same as the whole.

use super::accessor::Layout;
use super::buffer::{ByteRange, View};
use super::cut::Pieces;
use super::document::Document;
use super::image::pixels_of;
use super::json::{Item, Result};
use super::needs::{Needs, read_attributes};
use super::topology::Topology;
use super::{Files, Structure, Wanted};
use crate::scene::description::{PlanEntry, Saving};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

/// What the entries are made from.
pub(super) struct Inventory<'r, 'a> {
    pub(super) doc: &'r Document<'a>,
    pub(super) structure: &'r Structure,
    pub(super) views: &'r [View],
    pub(super) layouts: &'r [Layout],
    pub(super) needs: &'r Needs,
    pub(super) files: Files<'r>,
    pub(super) wanted: Wanted,
}

impl Inventory<'_, '_> {
    /// One entry for each kind of thing that the file holds and that is read or left out.
    ///
    /// # Errors
    /// When a reference leads nowhere.
    pub(super) fn entries(&self) -> Result<Vec<PlanEntry>> {
        if self.wanted.everything {
            let reason = "--keep-all: every mesh, material, image and texture coordinate is read".into();
            let what = "parts of the scene file that nothing needs".into();
            return Ok(vec![PlanEntry { what, kept: true, reason, ..Default::default() }]);
        }
        let entries = [self.images()?, self.meshes()?, self.materials(), self.attributes()?, self.moving()?];
        Ok(entries.into_iter().flatten().chain(self.cameras()).chain(self.buffers()?).collect())
    }

    fn images(&self) -> Result<Vec<PlanEntry>> {
        let count = self.doc.count("images");
        let users = texture_users(self.doc)?;
        let (mut read, mut unread) = (Vec::new(), Vec::new());
        let mut saves = Saving::default();
        for image in 0..count {
            let name = self.doc.label("image", "images", image);
            let by: Vec<&str> = users.get(&image).into_iter().flatten().map(String::as_str).collect();
            let by = if by.is_empty() { "no material".into() } else { by.join(", ") };
            if self.structure.materials.textures.images.contains(&image) {
                read.push(format!("{name}: {by}"));
                continue;
            }
            let why = self.structure.unread.iter().filter(|u| u.image == image).map(|u| u.why.as_str());
            let why: Vec<&str> = why.collect();
            unread.push(match why.is_empty() {
                true => format!("{name}: {by}, which nothing placed wears"),
                false => format!("{name}: {}", why.join(", ")),
            });
            let view = self.doc.reference(&self.doc.item("images", image)?, "bufferView", "bufferViews")?;
            saves.wire_bytes += view.and_then(|v| self.views.get(v)).map_or(0, |v| v.len() as u64);
            saves.memory_bytes += 4 * pixels_of(self.doc, image, self.views, self.files).unwrap_or(0);
        }
        let mut entries = Vec::new();
        if !read.is_empty() {
            let reason = format!("materials in use read {} of {}", read.len(), plural(count, "image"));
            entries.push(entry("textures", true, reason, Saving::default(), read));
        }
        if !unread.is_empty() {
            let reason = format!("{} of {} cannot change the image", unread.len(), plural(count, "image"));
            entries.push(entry("other textures", false, reason, saves, unread));
        } else if count == 0 {
            entries.push(entry("textures", false, "the scene has none".into(), Saving::default(), Vec::new()));
        }
        Ok(entries)
    }

    fn meshes(&self) -> Result<Vec<PlanEntry>> {
        let count = self.doc.count("meshes");
        let unplaced: Vec<usize> = (0..count).filter(|m| !self.structure.meshes.contains(m)).collect();
        if unplaced.is_empty() {
            return Ok(Vec::new());
        }
        let mut accessors = Vec::new();
        for &mesh in &unplaced {
            collect_accessors(self.doc.item("meshes", mesh)?.raw(), &mut accessors);
        }
        let bytes = self.unread_bytes(&accessors);
        let reason = format!("no node of the scene places {} of {}", unplaced.len(), plural(count, "mesh"));
        let names = unplaced.iter().map(|m| self.doc.label("mesh", "meshes", *m)).collect();
        Ok(vec![entry("other meshes", false, reason, same(bytes), names)])
    }

    fn materials(&self) -> Vec<PlanEntry> {
        let count = self.doc.count("materials");
        let unused: Vec<usize> = (0..count).filter(|m| !self.structure.used.contains(&Some(*m))).collect();
        if unused.is_empty() {
            return Vec::new();
        }
        let reason = format!("no placed mesh wears {} of {}", unused.len(), plural(count, "material"));
        let names = unused.iter().map(|m| self.doc.label("material", "materials", *m)).collect();
        vec![entry("other materials", false, reason, Saving::default(), names)]
    }

    /// Vertex attributes and morph targets of placed meshes.
    fn attributes(&self) -> Result<Vec<PlanEntry>> {
        let mut unread: BTreeMap<String, usize> = BTreeMap::new();
        let mut accessors = Vec::new();
        for &mesh in &self.structure.meshes {
            for primitive in self.doc.item("meshes", mesh)?.require("primitives")?.elements()? {
                if Topology::read(&primitive)?.is_none() {
                    continue;
                }
                let material = self.doc.reference(&primitive, "material", "materials")?;
                let materials = &self.structure.materials;
                let read = read_attributes(materials, materials.index(material), self.wanted);
                for (name, accessor) in members(primitive.require("attributes")?.raw()) {
                    if !read.contains(name) {
                        *unread.entry(name.to_owned()).or_default() += 1;
                        collect_indices(accessor, &mut accessors);
                    }
                }
                if let Some(targets) = primitive.get("targets")? {
                    *unread.entry("morph targets".into()).or_default() += 1;
                    collect_accessors(targets.raw(), &mut accessors);
                }
            }
        }
        if unread.is_empty() {
            return Ok(Vec::new());
        }
        let names: Vec<&str> = unread.keys().map(String::as_str).collect();
        let reason = format!("no texture, normal map or method reads {}", names.join(", "));
        let evidence = unread.iter().map(|(name, n)| format!("{name} of {}", plural(*n, "primitive"))).collect();
        let bytes = self.unread_bytes(&accessors);
        Ok(vec![entry("other vertex attributes", false, reason, same(bytes), evidence)])
    }

    /// Animations and skins.
    fn moving(&self) -> Result<Vec<PlanEntry>> {
        let mut entries = Vec::new();
        for (section, what) in [("animations", "animation"), ("skins", "skin")] {
            let count = self.doc.count(section);
            if count == 0 {
                continue;
            }
            let mut accessors = Vec::new();
            for index in 0..count {
                collect_accessors(self.doc.item(section, index)?.raw(), &mut accessors);
            }
            let reason = format!("nothing moves in an image: {}", plural(count, what));
            let names = (0..count).map(|i| self.doc.label(what, section, i)).collect();
            entries.push(entry(section, false, reason, same(self.unread_bytes(&accessors)), names));
        }
        Ok(entries)
    }

    fn cameras(&self) -> Option<PlanEntry> {
        let count = self.doc.count("cameras");
        let reason = format!("the image has one of {}", plural(count, "camera"));
        (count > 1).then(|| entry("other cameras", false, reason, Saving::default(), Vec::new()))
    }

    /// What all that comes to in the files of buffers.
    fn buffers(&self) -> Result<Option<PlanEntry>> {
        let (mut all, mut read) = (0u64, 0u64);
        for buffer in 0..self.doc.count("buffers") {
            all += self.doc.item("buffers", buffer)?.require("byteLength")?.unsigned()?;
            read += self.needs.bytes_of(buffer);
        }
        let rest = all.saturating_sub(read);
        let reason = format!("of the {all} bytes of its buffers {read} are read; a cluster gets no others");
        let saves = Saving { wire_bytes: rest, ..Default::default() };
        Ok((rest > 0).then(|| entry("the rest of the scene file", false, reason, saves, Vec::new())))
    }

    /// Bytes of accessors that nothing reads.
    fn unread_bytes(&self, accessors: &[usize]) -> u64 {
        let read: BTreeSet<&ByteRange> = self.needs.ranges().collect();
        let ranges = accessors.iter().filter_map(|a| self.layouts.get(*a)).flat_map(Layout::ranges);
        let mut by_buffer: BTreeMap<usize, BTreeSet<ByteRange>> = BTreeMap::new();
        for range in ranges.filter(|r| !read.contains(r)) {
            by_buffer.entry(range.buffer).or_default().insert(range);
        }
        by_buffer.values().map(|ranges| Pieces::of(ranges.iter()).len()).sum()
    }
}

fn entry(what: &str, kept: bool, reason: String, saves: Saving, evidence: Vec<String>) -> PlanEntry {
    PlanEntry { what: what.into(), kept, reason, saves, evidence }
}

/// What is as large in memory as in the file.
fn same(bytes: u64) -> Saving {
    Saving { wire_bytes: bytes, memory_bytes: bytes, ..Default::default() }
}

fn plural(n: usize, what: &str) -> String {
    let ending = match (n, what.ends_with('h')) {
        (1, _) => "",
        (_, true) => "es",
        (_, false) => "s",
    };
    format!("{n} {what}{ending}")
}

fn members(value: &Value) -> impl Iterator<Item = (&str, &Value)> {
    value.as_object().into_iter().flatten().map(|(key, value)| (key.as_str(), value))
}

/// For each image, the materials that name it: `the normalTexture of "Wall"`.
fn texture_users(doc: &Document) -> Result<BTreeMap<usize, Vec<String>>> {
    let mut users: BTreeMap<usize, Vec<String>> = BTreeMap::new();
    for material in 0..doc.count("materials") {
        let name = doc.label("material", "materials", material);
        let mut found = Vec::new();
        collect_textures(doc.item("materials", material)?.raw(), &mut found);
        for (key, texture) in found {
            let source = doc.item("textures", texture).ok().and_then(|t| t.opt("source", Item::size).ok().flatten());
            if let Some(image) = source {
                users.entry(image).or_default().push(format!("the {key} of {name}"));
            }
        }
    }
    Ok(users)
}

/// Members like `"normalTexture": { "index": 3 }`, at any depth.
fn collect_textures<'v>(value: &'v Value, found: &mut Vec<(&'v str, usize)>) {
    for (key, inner) in members(value) {
        match inner.get("index").and_then(Value::as_u64).filter(|_| key.ends_with("Texture")) {
            Some(index) => found.push((key, index as usize)),
            None => collect_textures(inner, found),
        }
    }
}

/// Indices of accessors in a mesh, an animation or a skin, wherever they stand.
fn collect_accessors(value: &Value, found: &mut Vec<usize>) {
    const KEYS: [&str; 6] = ["attributes", "indices", "targets", "input", "output", "inverseBindMatrices"];
    match value {
        Value::Array(list) => list.iter().for_each(|v| collect_accessors(v, found)),
        Value::Object(_) => {
            for (key, inner) in members(value) {
                if KEYS.contains(&key) { collect_indices(inner, found) } else { collect_accessors(inner, found) }
            }
        }
        _ => {}
    }
}

/// Every whole number in `value`.
fn collect_indices(value: &Value, found: &mut Vec<usize>) {
    match value {
        Value::Number(n) => found.extend(n.as_u64().map(|n| n as usize)),
        Value::Array(list) => list.iter().for_each(|v| collect_indices(v, found)),
        Value::Object(map) => map.values().for_each(|v| collect_indices(v, found)),
        _ => {}
    }
}

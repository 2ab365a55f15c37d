//! The glTF document: its sections, references between them, and what every file must state.

use super::json::{Item, Result, quoted};
use super::limits::MAX_WARNINGS;
use serde_json::Value;

/// Sections whose elements other parts refer to by index.
const SECTIONS: [&str; 12] = [
    "accessors",
    "animations",
    "bufferViews",
    "buffers",
    "cameras",
    "images",
    "materials",
    "meshes",
    "nodes",
    "samplers",
    "scenes",
    "textures",
];

/// A parsed glTF file.
pub(super) struct Document<'a> {
    root: Item<'a>,
}

impl<'a> Document<'a> {
    /// Checks the version and that each section is an array of objects.
    ///
    /// # Errors
    /// Names the first member that is not as glTF 2.0 has it.
    pub(super) fn new(file: &'a str, json: &'a Value) -> Result<Self> {
        let root = Item::root(file, json);
        let asset = root.require("asset")?;
        check_version(&asset.require("version")?, false)?;
        if let Some(least) = asset.get("minVersion")? {
            check_version(&least, true)?;
        }
        for name in SECTIONS {
            let Some(section) = root.get(name)? else { continue };
            for (index, value) in section.values()?.iter().enumerate() {
                if !value.is_object() {
                    return Err(root.error(format!("{name}[{index}] must be an object")));
                }
            }
        }
        Ok(Document { root })
    }
    /// The document's root object.
    pub(super) fn root(&self) -> &Item<'a> {
        &self.root
    }
    /// How many elements a section has.
    pub(super) fn count(&self, section: &str) -> usize {
        self.section(section).map_or(0, |s| s.values().map_or(0, <[Value]>::len))
    }
    fn section(&self, section: &str) -> Option<Item<'a>> {
        self.root.get(section).ok().flatten()
    }
    /// Element `index` of a section.
    ///
    /// # Errors
    /// When the section is shorter.
    pub(super) fn item(&self, section: &str, index: usize) -> Result<Item<'a>> {
        self.section(section)
            .and_then(|s| s.at(index))
            .ok_or_else(|| self.root.error(format!("there is no {section}[{index}]")))
    }
    /// Reads `reference` as an index into `section`.
    ///
    /// # Errors
    /// When it is not a whole number, or the section is shorter.
    pub(super) fn index(&self, reference: &Item<'a>, section: &str) -> Result<usize> {
        let count = self.count(section);
        let index = reference.unsigned()?;
        usize::try_from(index).ok().filter(|i| *i < count).ok_or_else(|| {
            reference.error(match count {
                0 => format!("refers to {section}[{index}], but the file has no {section}"),
                _ => format!("refers to {section}[{index}], but {section} has only {count} entries"),
            })
        })
    }
    /// Reads the member `key` of `item` as an index into `section`, where there is one.
    ///
    /// # Errors
    /// As [`Document::index`].
    pub(super) fn reference(&self, item: &Item<'a>, key: &str, section: &str) -> Result<Option<usize>> {
        item.opt(key, |r| self.index(r, section))
    }
    /// `mesh "Lid"`, or `meshes[3]` for one without a name.
    pub(super) fn label(&self, kind: &str, section: &str, index: usize) -> String {
        match self.name(section, index) {
            "" => format!("{section}[{index}]"),
            name => format!("{kind} {}", quoted(name)),
        }
    }
    /// The element's name; empty where it has none.
    pub(super) fn name(&self, section: &str, index: usize) -> &'a str {
        let name = self.section(section).and_then(|s| s.at(index)).and_then(|item| item.get("name").ok().flatten());
        name.and_then(|n| n.text().ok()).unwrap_or("")
    }
}

fn check_version(version: &Item, least: bool) -> Result<()> {
    let text = version.text()?;
    let parts: Option<(u32, u32)> = text.split_once('.').and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
    match parts {
        Some((2, 0)) => Ok(()),
        Some((2, _)) if !least => Ok(()),
        Some((1, _)) => Err(version.error("glTF 1.0 is not supported; re-export the scene as glTF 2.0")),
        _ => Err(version.error(format!("glTF version {} is not supported; this renderer reads 2.0", quoted(text)))),
    }
}

/// What was read but is not shown as the file asks.
#[derive(Default)]
pub(super) struct Warnings {
    list: Vec<String>,
    more: bool,
}

impl Warnings {
    /// Notes one thing; repeats are kept once.
    pub(super) fn add(&mut self, message: impl Into<String>) {
        let message = message.into();
        if self.list.contains(&message) {
            return;
        }
        if self.list.len() < MAX_WARNINGS { self.list.push(message) } else { self.more = true }
    }
    /// The warnings in the order they came.
    pub(super) fn finish(mut self) -> Vec<String> {
        if self.more {
            self.list.push("further warnings are not shown".into());
        }
        self.list
    }
}

//! Textures as materials refer to them: samplers, texture coordinate sets, KHR_texture_transform.

use super::document::{Document, Warnings};
use super::json::{Item, Result};
use crate::math::ops;
use crate::scene::description::{TextureDescription, TextureRef, Wrap};
use std::collections::BTreeMap;

/// Texture coordinate sets that a mesh can carry.
pub(super) const UV_SLOTS: usize = 2;

/// Where one of a mesh's texture coordinate sets comes from: a set of the file, transformed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct UvSource {
    /// n of TEXCOORD_n.
    pub(super) set: u64,
    /// Rows of the affine map.
    transform: Option<[[f32; 3]; 2]>,
    /// Some texture that is not left out reads it.
    pub(super) read: bool,
}

impl UvSource {
    /// The transformed coordinates.
    pub(super) fn apply(&self, [u, v]: [f32; 2]) -> [f32; 2] {
        match self.transform {
            None => [u, v],
            Some(rows) => rows.map(|[a, b, c]| a * u + b * v + c),
        }
    }
}

/// The textures and images that used materials need.
#[derive(Default)]
pub(super) struct Textures {
    /// In order of first use.
    pub(super) list: Vec<TextureDescription>,
    /// Image indices of the file, in order of first use.
    pub(super) images: Vec<usize>,
    by_file_index: BTreeMap<usize, Option<usize>>,
}

/// What a material asks of one texture.
pub(super) struct TextureInfo {
    /// The texture, to be used with a slot.
    pub(super) texture: usize,
    /// Its coordinates.
    pub(super) source: UvSource,
}

impl Textures {
    /// Reads the textureInfo object `key` of `owner`. `None` where there is none or its texture has no image.
    ///
    /// # Errors
    /// When it refers to something that is not there.
    pub(super) fn info(
        &mut self,
        doc: &Document,
        owner: &Item,
        key: &str,
        warnings: &mut Warnings,
    ) -> Result<Option<TextureInfo>> {
        let Some(item) = owner.get(key)? else { return Ok(None) };
        let index = doc.index(&item.require("index")?, "textures")?;
        let set = item.opt("texCoord", Item::unsigned)?.unwrap_or(0);
        let (set, transform) = match item.extension("KHR_texture_transform")? {
            None => (set, None),
            Some(ext) => (ext.opt("texCoord", Item::unsigned)?.unwrap_or(set), transform(&ext)?),
        };
        let texture = self.texture(doc, index, warnings)?;
        Ok(texture.map(|texture| TextureInfo { texture, source: UvSource { set, transform, read: true } }))
    }

    /// The image of the file that a texture shows.
    pub(super) fn file_image(&self, texture: usize) -> Option<usize> {
        self.images.get(self.list.get(texture)?.image).copied()
    }
    /// Keeps the textures at `kept`, in that order, and their images.
    pub(super) fn retain(&mut self, kept: &[usize]) {
        let textures: Vec<TextureDescription> = kept.iter().filter_map(|t| self.list.get(*t).copied()).collect();
        let mut images: Vec<usize> = Vec::new();
        self.list = textures;
        for texture in &mut self.list {
            let Some(&file_index) = self.images.get(texture.image) else { continue };
            texture.image = images.iter().position(|i| *i == file_index).unwrap_or_else(|| {
                images.push(file_index);
                images.len() - 1
            });
        }
        self.images = images;
        self.by_file_index.clear();
    }

    fn texture(&mut self, doc: &Document, index: usize, warnings: &mut Warnings) -> Result<Option<usize>> {
        if let Some(known) = self.by_file_index.get(&index) {
            return Ok(*known);
        }
        let item = doc.item("textures", index)?;
        let entry = match doc.reference(&item, "source", "images")? {
            None => {
                let name = doc.label("texture", "textures", index);
                warnings.add(format!("{name} has no PNG or JPEG image; it is left out"));
                None
            }
            Some(source) => {
                let image = self.images.iter().position(|i| *i == source).unwrap_or_else(|| {
                    self.images.push(source);
                    self.images.len() - 1
                });
                let description = sampled(doc, &item, image)?;
                self.list.push(description);
                Some(self.list.len() - 1)
            }
        };
        self.by_file_index.insert(index, entry);
        Ok(entry)
    }
}

fn sampled(doc: &Document, texture: &Item, image: usize) -> Result<TextureDescription> {
    let mut out = TextureDescription { image, wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat, nearest: false };
    let Some(index) = doc.reference(texture, "sampler", "samplers")? else { return Ok(out) };
    let sampler = doc.item("samplers", index)?;
    let wrap = |item: &Item| match item.unsigned()? {
        10_497 => Ok(Wrap::Repeat),
        33_071 => Ok(Wrap::ClampToEdge),
        33_648 => Ok(Wrap::MirroredRepeat),
        other => Err(item.error(format!("{other} is not a wrap mode; glTF has 10497, 33071 and 33648"))),
    };
    out.wrap_u = sampler.opt("wrapS", wrap)?.unwrap_or_default();
    out.wrap_v = sampler.opt("wrapT", wrap)?.unwrap_or_default();
    if let Some(filter) = sampler.get("magFilter")? {
        out.nearest = match filter.unsigned()? {
            9728 => true,
            9729 => false,
            other => return Err(filter.error(format!("{other} is not a filter; glTF has 9728 and 9729"))),
        };
    }
    Ok(out)
}

/// Translation · rotation · scale of KHR_texture_transform; `None` for the identity.
fn transform(item: &Item) -> Result<Option<[[f32; 3]; 2]>> {
    let [x, y] = item.opt("offset", Item::floats::<2>)?.unwrap_or([0.0; 2]);
    let [su, sv] = item.opt("scale", Item::floats::<2>)?.unwrap_or([1.0; 2]);
    let angle = item.opt("rotation", Item::float)?.unwrap_or(0.0);
    let (sin, cos) = (ops::sin(angle), ops::cos(angle));
    let rows = [[cos * su, sin * sv, x], [-sin * su, cos * sv, y]];
    Ok((rows != [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]).then_some(rows))
}

/// Gives each texture of one material its place among the [`UV_SLOTS`] coordinate sets of the meshes that wear it.
#[derive(Default)]
pub(super) struct Slots {
    /// At most [`UV_SLOTS`] sources.
    pub(super) sources: Vec<UvSource>,
    /// True when a texture found no slot.
    pub(super) overflow: bool,
}

impl Slots {
    /// The texture with its slot; a texture beyond the last slot is left out.
    pub(super) fn assign(&mut self, info: TextureInfo) -> Option<TextureRef> {
        let slot = self.sources.iter().position(|s| *s == info.source).unwrap_or(self.sources.len());
        if slot >= UV_SLOTS {
            self.overflow = true;
            return None;
        }
        if slot == self.sources.len() {
            self.sources.push(info.source);
        }
        Some(TextureRef { texture: info.texture, uv_set: slot })
    }
}

//! Metallic-roughness materials and their extensions.

use super::document::{Document, Warnings};
use super::json::{Item, Result};
use super::texture::{Slots, Textures, UvSource};
use crate::math::Rgb;
use crate::scene::description::{IOR_FULL_REFLECTION, MaterialDescription, TextureRef};
use std::collections::{BTreeMap, BTreeSet};

/// Alpha below which a point of a blended material is a hole.
const BLEND_CUTOFF: f32 = 0.5;

/// The materials that placed meshes use.
#[derive(Default)]
pub(super) struct Materials {
    /// In file order; glTF's default material, where it is used, is the first.
    pub(super) list: Vec<MaterialDescription>,
    /// For each material, where each of the texture coordinate sets of its meshes comes from.
    pub(super) uv_sources: Vec<Vec<UvSource>>,
    /// Their textures.
    pub(super) textures: Textures,
    by_file_index: BTreeMap<Option<usize>, usize>,
}

impl Materials {
    /// Reads the materials `used`; `None` stands for the default one.
    ///
    /// # Errors
    /// Names the member that is damaged.
    pub(super) fn read(doc: &Document, used: &BTreeSet<Option<usize>>, warnings: &mut Warnings) -> Result<Self> {
        let mut materials = Materials::default();
        for &index in used {
            let (description, sources) = match index {
                None => (MaterialDescription { name: "default".into(), ..Default::default() }, Vec::new()),
                Some(index) => {
                    let item = doc.item("materials", index)?;
                    let label = doc.label("material", "materials", index);
                    let name = match doc.name("materials", index) {
                        "" => label.clone(),
                        name => name.to_owned(),
                    };
                    let mut reader =
                        Reader { doc, textures: &mut materials.textures, slots: Slots::default(), label, warnings };
                    let description = MaterialDescription { name, ..reader.material(&item)? };
                    if reader.slots.overflow {
                        let label = &reader.label;
                        reader.warnings.add(format!(
                            "{label} uses more than two differently transformed texture coordinate sets; the textures beyond are left out"
                        ));
                    }
                    (description, reader.slots.sources)
                }
            };
            materials.by_file_index.insert(index, materials.list.len());
            materials.list.push(description);
            materials.uv_sources.push(sources);
        }
        Ok(materials)
    }
    /// Index in [`Materials::list`] of a material of the file.
    pub(super) fn index(&self, file_index: Option<usize>) -> usize {
        self.by_file_index.get(&file_index).copied().unwrap_or(0)
    }
}

struct Reader<'r, 'a> {
    doc: &'r Document<'a>,
    textures: &'r mut Textures,
    slots: Slots,
    label: String,
    warnings: &'r mut Warnings,
}

impl<'a> Reader<'_, 'a> {
    fn material(&mut self, item: &Item<'a>) -> Result<MaterialDescription> {
        let mut m = MaterialDescription::default();
        if let Some(pbr) = item.get("pbrMetallicRoughness")? {
            self.metallic_roughness(&mut m, &pbr)?;
        }
        if let Some(normal) = item.get("normalTexture")? {
            m.normal_scale = normal.opt("scale", Item::float)?.unwrap_or(1.0);
            m.normal_texture = self.texture(item, "normalTexture")?;
        }
        m.double_sided = item.opt("doubleSided", Item::flag)?.unwrap_or(false);
        self.emission(&mut m, item)?;
        self.alpha(&mut m, item)?;
        self.transmission_and_volume(&mut m, item)?;
        self.specular(&mut m, item)?;
        Ok(m)
    }

    fn texture(&mut self, owner: &Item<'a>, key: &str) -> Result<Option<TextureRef>> {
        let info = self.textures.info(self.doc, owner, key, self.warnings)?;
        Ok(info.and_then(|info| self.slots.assign(info)))
    }

    fn metallic_roughness(&mut self, m: &mut MaterialDescription, pbr: &Item<'a>) -> Result<()> {
        if let Some([r, g, b, a]) = pbr.opt("baseColorFactor", Item::floats::<4>)? {
            m.base_color = self.color(Rgb::new(r, g, b), "baseColorFactor (albedo)");
            m.base_alpha = self.unit(a, "baseColorFactor's alpha");
        }
        m.base_color_texture = self.texture(pbr, "baseColorTexture")?;
        m.metallic = self.factor(pbr, "metallicFactor", 1.0)?;
        m.roughness = self.factor(pbr, "roughnessFactor", 1.0)?;
        m.metallic_roughness_texture = self.texture(pbr, "metallicRoughnessTexture")?;
        Ok(())
    }

    fn emission(&mut self, m: &mut MaterialDescription, item: &Item<'a>) -> Result<()> {
        let factor = item.opt("emissiveFactor", Item::floats::<3>)?.unwrap_or([0.0; 3]);
        let strength = match item.extension("KHR_materials_emissive_strength")? {
            Some(ext) => ext.opt("emissiveStrength", Item::float)?.unwrap_or(1.0),
            None => 1.0,
        };
        let emission = Rgb::from(factor) * strength;
        if factor.iter().any(|c| *c < 0.0) || strength < 0.0 || !emission.is_finite() {
            let message =
                format!("emissiveFactor {factor:?} × emissiveStrength {strength} must be finite and not negative");
            return Err(item.error(message));
        }
        m.emission = emission;
        m.emissive_texture = self.texture(item, "emissiveTexture")?;
        Ok(())
    }

    fn alpha(&mut self, m: &mut MaterialDescription, item: &Item<'a>) -> Result<()> {
        let Some(mode) = item.get("alphaMode")? else { return Ok(()) };
        match mode.text()? {
            "OPAQUE" => {}
            "MASK" => {
                let cutoff = item.get("alphaCutoff")?;
                let value = cutoff.as_ref().map_or(Ok(BLEND_CUTOFF), Item::float)?;
                if let Some(cutoff) = cutoff.filter(|_| value < 0.0) {
                    return Err(cutoff.error(format!("must not be negative, found {value}")));
                }
                m.alpha_cutoff = Some(value);
            }
            "BLEND" if m.base_alpha >= 1.0 && m.base_color_texture.is_none() => {}
            "BLEND" => {
                let label = &self.label;
                let shown = if m.base_alpha < BLEND_CUTOFF { ", so the whole material is invisible" } else { "" };
                self.warnings.add(format!(
                    "{label}: alpha blending is shown as a mask with cutoff {BLEND_CUTOFF}{shown}; for glass use transmission"
                ));
                m.alpha_cutoff = Some(BLEND_CUTOFF);
            }
            _ => return Err(mode.error("must be \"OPAQUE\", \"MASK\" or \"BLEND\"")),
        }
        Ok(())
    }

    fn transmission_and_volume(&mut self, m: &mut MaterialDescription, item: &Item<'a>) -> Result<()> {
        if let Some(ext) = item.extension("KHR_materials_transmission")? {
            m.transmission = self.factor(&ext, "transmissionFactor", 0.0)?;
            m.transmission_texture = self.texture(&ext, "transmissionTexture")?;
        }
        if let Some(ext) = item.extension("KHR_materials_ior")? {
            m.ior = self.ior(ext.opt("ior", Item::float)?.unwrap_or(1.5));
        }
        if let Some(ext) = item.extension("KHR_materials_volume")? {
            m.volume = ext.opt("thicknessFactor", Item::float)?.unwrap_or(0.0) > 0.0;
            let color = ext.opt("attenuationColor", Item::floats::<3>)?.unwrap_or([1.0; 3]);
            m.attenuation_color = self.color(color.into(), "attenuationColor");
            if let Some(distance) = ext.get("attenuationDistance")? {
                // Files write "no attenuation" as a number beyond single precision.
                m.attenuation_distance = distance.number()? as f32;
                if m.attenuation_distance <= 0.0 {
                    return Err(distance.error(format!("must be above 0, found {}", distance.number()?)));
                }
            }
        }
        Ok(())
    }

    fn ior(&mut self, ior: f32) -> f32 {
        if ior == 0.0 {
            return IOR_FULL_REFLECTION;
        }
        if ior < 1.0 {
            let label = &self.label;
            self.warnings.add(format!("{label}: index of refraction {ior} is below 1 and taken as 1"));
        }
        ior.clamp(1.0, IOR_FULL_REFLECTION)
    }

    fn specular(&mut self, m: &mut MaterialDescription, item: &Item<'a>) -> Result<()> {
        let Some(ext) = item.extension("KHR_materials_specular")? else { return Ok(()) };
        m.specular = self.factor(&ext, "specularFactor", 1.0)?;
        m.specular_texture = self.texture(&ext, "specularTexture")?;
        if let Some(color) = ext.opt("specularColorFactor", Item::floats::<3>)? {
            if color.iter().any(|c| *c < 0.0) {
                return Err(ext.error(format!("specularColorFactor {color:?} must not be negative")));
            }
            m.specular_color = color.into();
        }
        m.specular_color_texture = self.texture(&ext, "specularColorTexture")?;
        Ok(())
    }

    fn factor(&mut self, owner: &Item<'a>, key: &str, default: f32) -> Result<f32> {
        let value = owner.opt(key, Item::float)?.unwrap_or(default);
        Ok(self.unit(value, key))
    }

    /// `value` clamped to [0, 1], and said.
    fn unit(&mut self, value: f32, what: &str) -> f32 {
        let clamped = value.clamp(0.0, 1.0);
        if clamped != value {
            let label = &self.label;
            self.warnings.add(format!("{label}: {what} {value} lies outside 0 to 1 and is clamped"));
        }
        clamped
    }

    fn color(&mut self, value: Rgb, what: &str) -> Rgb {
        let clamped = value.clamp01();
        if clamped != value {
            let label = &self.label;
            let Rgb { r, g, b } = value;
            self.warnings.add(format!("{label}: {what} ({r}, {g}, {b}) lies outside 0 to 1 and is clamped"));
        }
        clamped
    }
}

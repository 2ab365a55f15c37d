//! Textures of materials in use that cannot change a bit of the image, whatever they hold.
//!
//! Each rule is exact: what the texture would be multiplied with is zero, or nothing reads the product. A rule that
//! holds only nearly has no place here.

use super::Wanted;
use super::material::Materials;
use crate::math::Rgb;
use crate::scene::description::{MaterialDescription, TextureRef};

/// The textures of a material, by what they are.
type Slot = (&'static str, fn(&mut MaterialDescription) -> &mut Option<TextureRef>);

const SLOTS: [Slot; 7] = [
    ("base colour", |m| &mut m.base_color_texture),
    ("metallic-roughness", |m| &mut m.metallic_roughness_texture),
    ("normal", |m| &mut m.normal_texture),
    ("emissive", |m| &mut m.emissive_texture),
    ("transmission", |m| &mut m.transmission_texture),
    ("specular", |m| &mut m.specular_texture),
    ("specular colour", |m| &mut m.specular_color_texture),
];

/// A texture that was left out.
pub(super) struct Unread {
    /// Its image in the file.
    pub(super) image: usize,
    /// `the emissive texture of "Wall": it emits nothing`.
    pub(super) why: String,
}

/// Takes the textures that change nothing from the materials; in a `dark` scene nothing but holes can be seen.
pub(super) fn leave_out(materials: &mut Materials, dark: bool, wanted: Wanted) -> Vec<Unread> {
    let mut unread = Vec::new();
    if wanted.everything {
        return unread;
    }
    let Materials { list, textures, .. } = materials;
    for m in list {
        for (name, slot) in SLOTS {
            let Some(reason) = reason(m, name, dark && !wanted.surface_layers) else { continue };
            if let Some(reference) = slot(m).take() {
                let why = format!("the {name} texture of {:?}: {reason}", m.name);
                unread.extend(textures.file_image(reference.texture).map(|image| Unread { image, why }));
            }
        }
    }
    materials.keep_read();
    unread
}

/// Why the texture `name` of `m` changes nothing; `None` where it may.
fn reason(m: &MaterialDescription, name: &str, dark: bool) -> Option<&'static str> {
    let cuts_holes = name == "base colour" && m.alpha_cutoff.is_some();
    if cuts_holes {
        return None;
    }
    if dark {
        return Some("there is no light");
    }
    let metal = m.metallic == 1.0 && m.metallic_roughness_texture.is_none();
    let matt = m.metallic == 0.0 && m.specular == 0.0 && m.transmission == 0.0;
    match name {
        "base colour" => (m.base_color == Rgb::BLACK).then_some("the base colour is black"),
        "emissive" => m.emission.is_black().then_some("it emits nothing"),
        "metallic-roughness" if matt => Some("it is neither metallic nor specular nor transparent"),
        "metallic-roughness" => (m.metallic == 0.0 && m.roughness == 0.0).then_some("both factors are 0"),
        "transmission" if m.transmission == 0.0 => Some("it lets no light through"),
        "specular" | "specular colour" if m.specular == 0.0 => Some("the specular factor is 0"),
        "transmission" | "specular" | "specular colour" => metal.then_some("it is metal all over"),
        _ => None,
    }
}

impl Materials {
    /// Drops textures, images and coordinate sets that no material refers to any more, in order of first use.
    fn keep_read(&mut self) {
        let mut kept: Vec<usize> = Vec::new();
        for (m, sources) in self.list.iter_mut().zip(&mut self.uv_sources) {
            let mut read = [false; super::texture::UV_SLOTS];
            for (_, slot) in SLOTS {
                let Some(reference) = slot(m) else { continue };
                let at = kept.iter().position(|t| *t == reference.texture).unwrap_or_else(|| {
                    kept.push(reference.texture);
                    kept.len() - 1
                });
                reference.texture = at;
                if let Some(read) = read.get_mut(reference.uv_set) {
                    *read = true;
                }
            }
            for (source, read) in sources.iter_mut().zip(read) {
                source.read = read;
            }
        }
        self.textures.retain(&kept);
    }
}

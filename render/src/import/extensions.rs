//! Which glTF extensions are read, and what is lost without the others.

use super::document::{Document, Warnings};
use super::json::{Item, Result, quoted};
use crate::error::SceneError;

/// Extensions the importer reads in full.
pub const SUPPORTED: [&str; 8] = [
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// Extensions that change nothing an image could show.
const HARMLESS: [&str; 2] = ["KHR_xmp", "KHR_xmp_json_ld"];

/// What is lost when an optional extension is left out.
const LOSSES: [(&str, &str); 21] = [
    ("EXT_lights_ies", "the lights' measured distributions"),
    ("EXT_lights_image_based", "light from the environment image"),
    ("EXT_mesh_gpu_instancing", "copies of a mesh beyond the first"),
    ("EXT_meshopt_compression", "nothing where uncompressed data is given as well"),
    ("EXT_texture_avif", "AVIF textures; their PNG or JPEG stand-ins are used where given"),
    ("EXT_texture_webp", "WebP textures; their PNG or JPEG stand-ins are used where given"),
    ("KHR_animation_pointer", "animation"),
    ("KHR_draco_mesh_compression", "compressed geometry; meshes need uncompressed data as well"),
    ("KHR_lights_environment", "light from the environment"),
    ("KHR_materials_anisotropy", "stretched highlights"),
    ("KHR_materials_clearcoat", "the clear coat on top"),
    ("KHR_materials_diffuse_transmission", "light shining through thin diffuse sheets"),
    ("KHR_materials_dispersion", "the spreading of colours by refraction"),
    ("KHR_materials_iridescence", "thin-film colours"),
    ("KHR_materials_pbrSpecularGlossiness", "specular-glossiness values; the metallic-roughness ones are used"),
    ("KHR_materials_sheen", "the sheen of cloth"),
    ("KHR_materials_subsurface", "light scattered beneath the surface"),
    ("KHR_materials_unlit", "the flat look: the material is lit like any other"),
    ("KHR_materials_variants", "other variants; the default one is shown"),
    ("KHR_node_visibility", "hiding: hidden nodes are shown"),
    ("KHR_texture_basisu", "KTX2 textures; their PNG or JPEG stand-ins are used where given"),
];

/// Refuses required extensions that are not supported, and warns of optional ones.
///
/// # Errors
/// Names the extension.
pub(super) fn check(doc: &Document, warnings: &mut Warnings) -> Result<()> {
    for item in list(doc, "extensionsRequired")? {
        let name = item.text()?;
        if !known(name) {
            return Err(SceneError::UnsupportedExtension {
                place: item.place(),
                extension: name.escape_debug().to_string(),
            });
        }
    }
    for item in list(doc, "extensionsUsed")? {
        let name = item.text()?;
        if known(name) {
            continue;
        }
        let loss = LOSSES.iter().find(|(known, _)| *known == name).map_or("what it adds", |(_, loss)| loss);
        warnings.add(format!("the optional glTF extension {} is not supported; lost: {loss}", quoted(name)));
    }
    Ok(())
}

fn known(name: &str) -> bool {
    SUPPORTED.contains(&name) || HARMLESS.contains(&name)
}

fn list<'a>(doc: &Document<'a>, key: &str) -> Result<Vec<Item<'a>>> {
    doc.root().get(key)?.map_or(Ok(Vec::new()), |list| list.elements())
}

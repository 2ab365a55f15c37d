//! Materials, their extensions, textures' samplers and coordinates.

use super::builder::{Builder, F32, f32s, png};
use crate::math::Rgb;
use crate::scene::description::{IOR_FULL_REFLECTION, MaterialDescription, TextureRef, Wrap};
use serde_json::{Value, json};

fn material(value: Value) -> MaterialDescription {
    Builder::with_material(value).clean_scene().materials.remove(0)
}
fn extended(name: &str, value: Value) -> Value {
    json!({ "name": "M", "extensions": { name: value } })
}

#[test]
fn defaults_are_gltfs() {
    let m = material(json!({}));
    assert_eq!((m.base_color, m.metallic, m.roughness, m.ior), (Rgb::WHITE, 1.0, 1.0, 1.5));
    assert_eq!((m.name.as_str(), m.alpha_cutoff, m.volume, m.double_sided), ("materials[0]", None, false, false));
    let none = Builder::square().clean_scene();
    assert_eq!((none.materials.len(), none.materials[0].name.as_str(), none.meshes[0].material), (1, "default", 0));
}

#[test]
fn factors_and_extensions_arrive() {
    let m = material(json!({
        "name": "Everything",
        "doubleSided": true,
        "pbrMetallicRoughness": { "baseColorFactor": [0.1, 0.2, 0.3, 0.4], "metallicFactor": 0.5, "roughnessFactor": 0.6 },
        "emissiveFactor": [1, 0.5, 0],
        "alphaMode": "MASK",
        "extensions": {
            "KHR_materials_emissive_strength": { "emissiveStrength": 10 },
            "KHR_materials_transmission": { "transmissionFactor": 0.7 },
            "KHR_materials_ior": { "ior": 1.33 },
            "KHR_materials_volume": { "thicknessFactor": 0.1, "attenuationDistance": 2.5, "attenuationColor": [0.9, 0.8, 0.7] },
            "KHR_materials_specular": { "specularFactor": 0.25, "specularColorFactor": [2, 1, 0.5] }
        }
    }));
    assert_eq!((m.name.as_str(), m.double_sided, m.alpha_cutoff), ("Everything", true, Some(0.5)));
    assert_eq!((m.base_color, m.base_alpha), (Rgb::new(0.1, 0.2, 0.3), 0.4));
    assert_eq!((m.metallic, m.roughness, m.transmission, m.ior), (0.5, 0.6, 0.7, 1.33));
    assert_eq!(m.emission, Rgb::new(10.0, 5.0, 0.0));
    assert_eq!((m.volume, m.attenuation_distance, m.attenuation_color), (true, 2.5, Rgb::new(0.9, 0.8, 0.7)));
    assert_eq!((m.specular, m.specular_color), (0.25, Rgb::new(2.0, 1.0, 0.5)));
    let thin = material(extended("KHR_materials_volume", json!({ "attenuationDistance": 1e300 })));
    assert_eq!((thin.volume, thin.attenuation_distance), (false, f32::INFINITY));
    assert_eq!(material(extended("KHR_materials_ior", json!({}))).ior, 1.5);
    assert_eq!(material(extended("KHR_materials_ior", json!({ "ior": 0 }))).ior, IOR_FULL_REFLECTION);
}

#[test]
fn factors_out_of_range_are_clamped_and_said() {
    let bright = Builder::with_material(
        json!({ "name": "Snow", "pbrMetallicRoughness": { "baseColorFactor": [1.5, 1, 0, 1] } }),
    );
    assert_eq!(bright.scene().materials[0].base_color, Rgb::new(1.0, 1.0, 0.0));
    assert_eq!(
        bright.warning(),
        "material \"Snow\": baseColorFactor (albedo) (1.5, 1, 0) lies outside 0 to 1 and is clamped"
    );
    let rough = Builder::with_material(json!({ "name": "M", "pbrMetallicRoughness": { "roughnessFactor": -0.5 } }));
    assert_eq!(
        (rough.scene().materials[0].roughness, rough.warning().as_str()),
        (0.0, "material \"M\": roughnessFactor -0.5 lies outside 0 to 1 and is clamped")
    );
    let thin = Builder::with_material(extended("KHR_materials_ior", json!({ "ior": 0.5 })));
    assert_eq!(
        (thin.scene().materials[0].ior, thin.warning().as_str()),
        (1.0, "material \"M\": index of refraction 0.5 is below 1 and taken as 1")
    );
}

#[test]
fn nonsense_factors_are_errors_with_their_place() {
    let error = |value: Value| Builder::with_material(value).error();
    assert!(
        error(json!({ "emissiveFactor": [-1, 0, 0] }))
            .starts_with("test.glb: materials[0]: emissiveFactor [-1.0, 0.0, 0.0]")
    );
    assert_eq!(
        error(json!({ "alphaMode": "GLASS" })),
        "test.glb: materials[0].alphaMode: must be \"OPAQUE\", \"MASK\" or \"BLEND\""
    );
    assert_eq!(
        error(json!({ "alphaMode": "MASK", "alphaCutoff": -1 })),
        "test.glb: materials[0].alphaCutoff: must not be negative, found -1"
    );
    assert_eq!(
        error(json!({ "doubleSided": 1 })),
        "test.glb: materials[0].doubleSided: expected true or false, found 1"
    );
    assert_eq!(
        error(json!({ "pbrMetallicRoughness": { "metallicFactor": 1e39 } })),
        "test.glb: materials[0].pbrMetallicRoughness.metallicFactor: expected a number within single precision, found 1e+39"
    );
    let distance = error(extended("KHR_materials_volume", json!({ "attenuationDistance": 0 })));
    assert_eq!(
        distance,
        "test.glb: materials[0].extensions.KHR_materials_volume.attenuationDistance: must be above 0, found 0"
    );
    let color = error(extended("KHR_materials_specular", json!({ "specularColorFactor": [1, -1, 0] })));
    assert!(
        color.contains("KHR_materials_specular: specularColorFactor [1.0, -1.0, 0.0] must not be negative"),
        "{color}"
    );
}

#[test]
fn blending_becomes_a_mask_and_is_said() {
    let blend = |alpha: f64| {
        let pbr = json!({ "baseColorFactor": [1, 1, 1, alpha] });
        Builder::with_material(json!({ "name": "Veil", "alphaMode": "BLEND", "pbrMetallicRoughness": pbr }))
    };
    assert_eq!(blend(1.0).clean_scene().materials[0].alpha_cutoff, None);
    assert_eq!(blend(0.7).scene().materials[0].alpha_cutoff, Some(0.5));
    assert_eq!(
        blend(0.7).warning(),
        "material \"Veil\": alpha blending is shown as a mask with cutoff 0.5; for glass use transmission"
    );
    assert!(blend(0.2).warning().contains("so the whole material is invisible"));
}

#[test]
fn unused_materials_and_textures_are_left_out() {
    let mut b = Builder::square();
    b.push("materials", json!({ "name": "Unused", "emissiveFactor": [1, 1, 1], "emissiveTexture": { "index": 0 } }));
    let used = b.push("materials", json!({ "name": "Used" }));
    b.texture(b"not an image", "image/png");
    b.set("/meshes/0/primitives/0/material", json!(used));
    let scene = b.clean_scene();
    assert_eq!((scene.materials.len(), scene.materials[0].name.as_str(), scene.meshes[0].material), (1, "Used", 0));
    assert!(scene.textures.is_empty() && scene.images.is_empty());
    // A black emitter has no use for its texture.
    let dark = Builder::with_material(json!({ "emissiveTexture": { "index": 0 } })).error();
    assert!(
        dark.contains("materials[0].emissiveTexture.index: refers to textures[0], but the file has no textures"),
        "{dark}"
    );
}

/// The square with texture coordinates and two textures of two images.
fn textured(material: Value) -> Builder {
    let mut b = Builder::with_material(material);
    b.texture(&png(1, 1, &[255, 0, 0, 255]), "image/png");
    b.texture(&png(2, 1, &[0, 255, 0, 255, 0, 0, 255, 255]), "image/png");
    b.attribute("TEXCOORD_0", F32, "VEC2", 4, &f32s(&[0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0]));
    b.attribute("TEXCOORD_1", F32, "VEC2", 4, &f32s(&[0.5; 8]));
    b
}

#[test]
fn textures_name_their_coordinate_sets_and_samplers() {
    let mut b = textured(json!({
        "pbrMetallicRoughness": { "baseColorTexture": { "index": 1 }, "metallicRoughnessTexture": { "index": 0, "texCoord": 1 } },
        "emissiveFactor": [1, 1, 1],
        "emissiveTexture": { "index": 1, "texCoord": 1 }
    }));
    b.push("samplers", json!({ "wrapS": 33071, "wrapT": 33648, "magFilter": 9728, "minFilter": 9987 }));
    b.set("/textures/1/sampler", json!(0));
    let scene = b.clean_scene();
    let m = &scene.materials[0];
    assert_eq!(m.base_color_texture, Some(TextureRef { texture: 0, uv_set: 0 }));
    assert_eq!(m.metallic_roughness_texture, Some(TextureRef { texture: 1, uv_set: 1 }));
    assert_eq!(m.emissive_texture, Some(TextureRef { texture: 0, uv_set: 1 }));
    let [first, second] = scene.textures[..] else { panic!("{} textures", scene.textures.len()) };
    assert_eq!((first.wrap_u, first.wrap_v, first.nearest), (Wrap::ClampToEdge, Wrap::MirroredRepeat, true));
    assert_eq!((second.wrap_u, second.wrap_v, second.nearest), (Wrap::Repeat, Wrap::Repeat, false));
    assert_eq!((scene.images[first.image].width, scene.images[second.image].width), (2, 1));
    assert_eq!(scene.meshes[0].uvs[1].as_ref().expect("set 1")[0].to_array(), [0.5, 0.5]);
    assert!(b.but("/samplers/0/wrapS", json!(1)).error().contains("samplers[0].wrapS: 1 is not a wrap mode"));
    assert!(
        b.but("/samplers/0/magFilter", json!(9987)).error().contains("samplers[0].magFilter: 9987 is not a filter")
    );
}

#[test]
fn texture_transforms_are_baked_into_the_coordinates() {
    // KHR_texture_transform: scaled, turned counter-clockwise (v runs down), then moved.
    let quarter = std::f64::consts::FRAC_PI_2;
    let transform = json!({ "offset": [0.25, 0.5], "rotation": quarter, "scale": [2, 3], "texCoord": 0 });
    let info = json!({ "index": 0, "texCoord": 1, "extensions": { "KHR_texture_transform": transform } });
    let b = textured(
        json!({ "pbrMetallicRoughness": { "baseColorTexture": info, "metallicRoughnessTexture": { "index": 1 } } }),
    );
    let scene = b.clean_scene();
    let uvs = |set: usize| scene.meshes[0].uvs[set].as_ref().expect("coordinates").clone();
    // (1, 0) → (2, 0) → (0, −2) → (0.25, −1.5); (0, 1) → (0, 3) → (3, 0) → (3.25, 0.5)
    let close = |a: glam::Vec2, x: f32, y: f32| (a - glam::Vec2::new(x, y)).abs().max_element() < 1e-6;
    assert!(close(uvs(0)[1], 0.25, -1.5) && close(uvs(0)[3], 3.25, 0.5), "{:?}", uvs(0));
    assert_eq!(uvs(1)[1].to_array(), [1.0, 0.0], "the other texture keeps the plain coordinates");

    let mut third = b.clone();
    third.set("/materials/0/emissiveFactor", json!([1, 1, 1]));
    third.set("/materials/0/emissiveTexture", json!({ "index": 1, "texCoord": 1 }));
    third.set("/materials/0/name", json!("Busy"));
    assert!(
        third
            .warning()
            .contains("material \"Busy\" uses more than two differently transformed texture coordinate sets")
    );
}

#[test]
fn meshes_without_the_coordinates_are_named() {
    let b = textured(json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0, "texCoord": 4 } } }));
    assert_eq!(
        b.warning(),
        "mesh \"Sheet\" has no TEXCOORD_4, which its material's textures need; their first texel is used"
    );
    let mut sourceless = textured(json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }));
    sourceless.json["textures"][0] = json!({ "name": "Ktx" });
    assert_eq!(sourceless.warning(), "texture \"Ktx\" has no PNG or JPEG image; it is left out");
    assert_eq!(sourceless.scene().materials[0].base_color_texture, None);
}

#[test]
fn extensions_are_checked() {
    let mut b = Builder::square();
    b.json["extensionsUsed"] = json!(["KHR_materials_clearcoat", "KHR_materials_ior", "ACME_glow", "KHR_xmp_json_ld"]);
    assert_eq!(
        b.scene().warnings,
        [
            "the optional glTF extension \"KHR_materials_clearcoat\" is not supported; lost: the clear coat on top",
            "the optional glTF extension \"ACME_glow\" is not supported; lost: what it adds"
        ]
    );
    b.json["extensionsRequired"] = json!(["KHR_materials_ior", "KHR_draco_mesh_compression"]);
    assert_eq!(
        b.error(),
        "test.glb: extensionsRequired[1]: the file requires the glTF extension KHR_draco_mesh_compression, which is not \
         supported; re-export it without, or as optional"
    );
}

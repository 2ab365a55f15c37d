//! Damaged files, by the thousand: each gives a scene or an error, within bounds, and never a panic.

use super::builder::{Builder, F32, U8, U16, f32s, glb, png, u16s};
use crate::import::{SceneBundle, external_uris, load};
use crate::math::{Purpose, Stream};
use serde_json::{Value, json};

/// A file with one of everything.
fn rich() -> Builder {
    let mut b = Builder::with_material(json!({
        "name": "All",
        "pbrMetallicRoughness": { "baseColorFactor": [0.5, 0.5, 0.5, 1], "baseColorTexture": { "index": 0 }, "roughnessFactor": 0.2 },
        "normalTexture": { "index": 1, "extensions": { "KHR_texture_transform": { "scale": [2, 2], "rotation": 1 } } },
        "emissiveFactor": [1, 1, 1],
        "alphaMode": "MASK",
        "extensions": {
            "KHR_materials_transmission": { "transmissionFactor": 1 },
            "KHR_materials_volume": { "thicknessFactor": 1, "attenuationDistance": 1 },
            "KHR_materials_ior": { "ior": 1.4 },
            "KHR_materials_emissive_strength": { "emissiveStrength": 3 },
            "KHR_materials_specular": { "specularFactor": 0.5 }
        }
    }));
    b.texture(&png(4, 4, &[100; 64]), "image/png");
    b.texture(include_bytes!("data/baseline.jpg"), "image/jpeg");
    b.push("samplers", json!({ "wrapS": 33071, "wrapT": 33648, "magFilter": 9728 }));
    b.set("/textures/0/sampler", json!(0));
    b.attribute("TEXCOORD_0", F32, "VEC2", 4, &f32s(&[0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]));
    b.attribute("NORMAL", F32, "VEC3", 4, &f32s(&[0.0, 0.0, 1.0].repeat(4)));
    let colors = b.attribute("COLOR_0", U8, "VEC4", 4, &[255; 16]);
    b.set(&format!("/accessors/{colors}/normalized"), json!(true));
    let indices = b.view(&u16s(&[1, 2]));
    let values = b.view(&f32s(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0]));
    let sparse = b.push(
        "accessors",
        json!({ "componentType": F32, "type": "VEC3", "count": 3, "sparse": {
        "count": 2, "indices": { "bufferView": indices, "componentType": U16 }, "values": { "bufferView": values } } }),
    );
    let strip = json!({ "attributes": { "POSITION": sparse }, "mode": 5 });
    b.json["meshes"][0]["primitives"].as_array_mut().expect("primitives").push(strip);
    b.push("cameras", json!({ "type": "perspective", "perspective": { "yfov": 1, "aspectRatio": 1, "znear": 0.1 } }));
    b.push(
        "cameras",
        json!({ "type": "orthographic", "orthographic": { "xmag": 1, "ymag": 1, "znear": 0, "zfar": 1 } }),
    );
    b.json["extensions"] = json!({ "KHR_lights_punctual": { "lights": [
        { "type": "spot", "intensity": 2, "color": [1, 1, 1], "spot": { "innerConeAngle": 0.1, "outerConeAngle": 0.2 } }] } });
    b.json["extensionsUsed"] = json!(["KHR_lights_punctual", "KHR_texture_transform"]);
    let child = b.push("nodes", json!({ "camera": 0, "rotation": [0, 0, 0, 1] }));
    b.node(json!({ "camera": 1, "mesh": 0, "translation": [1, 2, 3], "scale": [1, -1, 1], "children": [child] }));
    b.node(json!({ "matrix": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1], "extensions": { "KHR_lights_punctual": { "light": 0 } } }));
    b
}

/// Loads, and checks what consumers may rely on. True for a scene.
fn check(root: Vec<u8>) -> bool {
    let _ = external_uris("test.glb", &root);
    let bundle = SceneBundle { name: "test.glb".into(), root: root.into(), externals: Vec::new() };
    let scene = match load(&bundle) {
        Ok(scene) => scene,
        Err(error) => {
            let message = error.to_string();
            assert!(message.starts_with("test.glb") && message.len() < 1500, "{message}");
            return false;
        }
    };
    for mesh in &scene.meshes {
        let count = mesh.positions.len();
        assert!(mesh.triangles.iter().flatten().all(|v| (*v as usize) < count));
        assert!(mesh.positions.iter().all(|p| p.is_finite()));
        assert!(mesh.normals.as_ref().is_none_or(|n| n.len() == count && n.iter().all(|n| n.is_normalized())));
        assert!(
            mesh.tangents.as_ref().is_none_or(|t| t.len() == count && t.iter().all(|t| t.truncate().is_normalized()))
        );
        assert!(mesh.uvs.iter().flatten().all(|uv| uv.len() == count && uv.iter().all(|uv| uv.is_finite())));
        assert!(mesh.colors.as_ref().is_none_or(|c| c.len() == count));
        assert!((mesh.material as usize) < scene.materials.len());
    }
    assert!(scene.instances.iter().all(|i| i.mesh < scene.meshes.len() && i.to_world.is_finite()));
    assert!(scene.textures.iter().all(|t| t.image < scene.images.len()));
    assert!(scene.images.iter().all(|i| i.rgba.len() == 4 * i.width as usize * i.height as usize && i.width > 0));
    for m in &scene.materials {
        let textures = [m.base_color_texture, m.normal_texture, m.metallic_roughness_texture, m.emissive_texture];
        assert!(textures.iter().flatten().all(|t| t.texture < scene.textures.len() && t.uv_set < 2));
        assert!(m.emission.is_finite() && m.base_color.is_finite() && m.ior >= 1.0);
    }
    true
}

#[test]
fn the_rich_file_itself_is_sound() {
    let scene = rich().clean_scene();
    assert_eq!((scene.meshes.len(), scene.instances.len(), scene.cameras.len(), scene.lights.len()), (1 + 1, 4, 2, 1));
    assert!(check(rich().glb()));
}

#[test]
fn flipped_and_spliced_bytes_never_panic() {
    let whole = rich().glb();
    let mut stream = Stream::new(1, Purpose::Test, 0, 0);
    let mut below = |n: usize| (stream.next_f32() * n as f32) as usize % n;
    let mut sound = 0;
    for _ in 0..6_000 {
        let mut bytes = whole.clone();
        for _ in 0..1 + below(4) {
            let at = below(bytes.len());
            match below(4) {
                0 => bytes[at] ^= 1 << below(8),
                1 => bytes[at] = below(256) as u8,
                2 => bytes[at] = [0, 0xff, 0x7f, 0x80, b'9', b'-', b'"', b'}'][below(8)],
                _ => {
                    let from = below(bytes.len());
                    let length = below(16).min(bytes.len() - from).min(bytes.len() - at);
                    bytes.copy_within(from..from + length, at);
                }
            }
        }
        sound += usize::from(check(bytes));
    }
    // Flips in vertex data leave a sound file, flips in the JSON seldom do: both sides must have been visited.
    assert!((600..5_400).contains(&sound), "{sound} of 6000 loaded");
}

#[test]
fn every_truncation_is_an_error() {
    let whole = rich().glb();
    for length in 0..whole.len() {
        assert!(!check(whole[..length].to_vec()), "{length} bytes of {}", whole.len());
    }
}

/// JSON pointers of all values below `value`.
fn pointers(value: &Value, at: &str, out: &mut Vec<String>) {
    let mut visit = |key: String, child: &Value| {
        let path = format!("{at}/{key}");
        out.push(path.clone());
        pointers(child, &path, out);
    };
    match value {
        Value::Object(map) => map.iter().for_each(|(key, child)| visit(key.clone(), child)),
        Value::Array(list) => list.iter().enumerate().for_each(|(i, child)| visit(i.to_string(), child)),
        _ => {}
    }
}

#[test]
fn every_value_changed_and_every_key_removed_never_panics() {
    let rich = rich();
    let mut all = Vec::new();
    pointers(&rich.json, "", &mut all);
    let values = [
        json!(-1),
        json!(0),
        json!(1),
        json!(3),
        json!(1e308),
        json!(5e-324),
        json!(0.5),
        json!(u64::MAX),
        json!(1u64 << 32),
        json!(i32::MAX),
        json!("NaN"),
        json!(""),
        json!("data:,"),
        json!([]),
        json!([0, 0, 0]),
        json!({}),
        Value::Null,
        json!(true),
    ];
    let mut sound = 0;
    for pointer in &all {
        for value in &values {
            sound += usize::from(check(rich.but(pointer, value.clone()).glb()));
        }
        let (parent, key) = pointer.rsplit_once('/').expect("a pointer");
        let mut removed = rich.clone();
        match removed.json.pointer_mut(parent) {
            Some(Value::Object(map)) => drop(map.remove(key)),
            Some(Value::Array(list)) => drop(list.remove(key.parse::<usize>().expect("an index"))),
            _ => continue,
        }
        sound += usize::from(check(removed.glb()));
    }
    assert!(sound > all.len(), "{sound} sound files of {} values", all.len());
}

#[test]
fn json_text_that_is_no_gltf_is_refused() {
    for text in [
        "null",
        "[]",
        "3",
        "\"asset\"",
        "{}",
        "{\"asset\":[]}",
        "{\"asset\":{\"version\":2}}",
        "{\"a\":1e999}",
        "{\"\\ud800\":0}",
    ] {
        assert!(!check(glb(text.as_bytes(), None)), "{text}");
    }
}

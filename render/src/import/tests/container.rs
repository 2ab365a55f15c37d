//! .glb, .gltf, external files and data URIs.

use super::builder::{Builder, glb};
use crate::import::{SceneBundle, external_uris, load, relative_path};
use base64::Engine as _;
use serde_json::json;

fn load_bytes(name: &str, root: &[u8]) -> Result<crate::scene::description::SceneDescription, String> {
    load(&SceneBundle { name: name.into(), root: root.into(), externals: Vec::new() }).map_err(|e| e.to_string())
}

#[test]
fn a_gltf_reads_its_buffer_from_a_data_uri_or_from_a_file() {
    let whole = Builder::square();
    let base64 = base64::engine::general_purpose::STANDARD.encode(&whole.bin);
    let inline = whole.but("/buffers/0/uri", json!(format!("data:application/octet-stream;base64,{base64}")));
    let text = inline.json.to_string();
    assert_eq!(external_uris("a.gltf", text.as_bytes()), Ok(vec![]));
    let scene = load_bytes("a.gltf", text.as_bytes()).expect("a scene");
    assert_eq!(scene.meshes[0].positions, whole.scene().meshes[0].positions);

    let external = whole.but("/buffers/0/uri", json!("my%20mesh.bin")).json.to_string();
    assert_eq!(external_uris("a.gltf", external.as_bytes()), Ok(vec!["my%20mesh.bin".to_owned()]));
    assert_eq!(relative_path("my%20mesh.bin").as_deref(), Some("my mesh.bin"));
    let externals = vec![("my%20mesh.bin".to_owned(), whole.bin.clone().into())];
    let bundle = SceneBundle { name: "a.gltf".into(), root: external.as_bytes().into(), externals };
    assert_eq!(load(&bundle).expect("a scene").meshes[0].triangles, whole.scene().meshes[0].triangles);
    let lonely = load_bytes("a.gltf", external.as_bytes()).expect_err("no buffer");
    assert_eq!(lonely, "a.gltf: buffers[0].uri: the external file \"my%20mesh.bin\" is missing");
}

#[test]
fn paths_come_from_uris_and_network_addresses_are_none() {
    assert_eq!(relative_path("../textures/%C3%A4.png").as_deref(), Some("../textures/ä.png"));
    assert_eq!(relative_path("a%2").as_deref(), Some("a%2"));
    assert_eq!(relative_path("C:/a.bin").as_deref(), Some("C:/a.bin"));
    assert_eq!(relative_path("https://example.org/a.bin"), None);
    assert_eq!(relative_path("%ff"), None);
    let remote = Builder::square().but("/buffers/0/uri", json!("https://example.org/a.bin")).error();
    assert!(remote.contains("only files beside the scene are read, not network addresses"), "{remote}");
}

#[test]
fn only_files_that_the_image_needs_are_asked_for() {
    let mut b = Builder::with_material(json!({ "emissiveFactor": [1, 1, 1], "emissiveTexture": { "index": 0 } }));
    for name in ["used.png", "unused.png"] {
        let source = b.push("images", json!({ "uri": name }));
        b.push("textures", json!({ "source": source }));
    }
    assert_eq!(external_uris("test.glb", &b.glb()), Ok(vec!["used.png".to_owned()]));
}

#[test]
fn damaged_containers_are_told_apart() {
    let whole = Builder::square().glb();
    let message = |bytes: &[u8]| load_bytes("test.glb", bytes).expect_err("damaged");
    assert_eq!(message(b""), "test.glb: the file is empty");
    assert_eq!(message(b"PK\x03\x04"), "test.glb: not a .glb file: it does not begin with \"glTF\"");
    let not_gltf = load_bytes("cat.jpg", b"\xff\xd8\xff\xe0").expect_err("a JPEG");
    assert!(not_gltf.starts_with("cat.jpg: not a glTF 2.0 file: neither .glb nor JSON"), "{not_gltf}");
    assert_eq!(message(&whole[..6]), "test.glb: the file is cut short: 6 bytes do not hold the .glb header");
    let cut = message(&whole[..whole.len() - 5]);
    let (all, there) = (whole.len(), whole.len() - 5);
    assert_eq!(cut, format!("test.glb: header: the file is cut short: the header says {all} bytes, there are {there}"));

    let edited = |at: usize, value: u32| {
        let mut bytes = whole.clone();
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        message(&bytes)
    };
    assert!(edited(4, 1).contains("header: container version 1 is not supported"));
    assert!(edited(12, 0x7fff_fffc).contains("chunk at byte 12: the chunk says 2147483644 bytes, there are"));
    assert!(edited(12, 0xffff_fffc).contains("chunk at byte 12: the chunk says"));
    assert!(edited(12, 13).contains("the chunk's length 13 is not a multiple of 4"));
    assert!(edited(16, 0x004e_4942).contains("chunk 0: the first chunk must be JSON"));
}

#[test]
fn damaged_json_is_told_with_its_line() {
    let error = load_bytes("a.gltf", b"{\n  \"asset\": { \"version\": \"2.0\", }\n}").expect_err("damaged");
    assert_eq!(error, "a.gltf: the JSON is damaged: trailing comma at line 2 column 32");
    let deep = [b"{\"a\":".as_slice(), &b"[".repeat(100_000)].concat();
    assert!(load_bytes("a.gltf", &deep).expect_err("too deep").contains("recursion limit exceeded"));
    let many = [b"{\"a\":[0".as_slice(), &b",0".repeat(9 << 20), b"]}"].concat();
    let error = load_bytes("a.gltf", &many).expect_err("too many values");
    assert!(error.contains("the number of JSON values is") && error.contains("over the limit of 8388608"), "{error}");
}

#[test]
fn versions_other_than_2_0_are_refused() {
    let b = Builder::square();
    let version = |v: &str| b.but("/asset/version", json!(v));
    assert_eq!(version("2.1").clean_scene().meshes.len(), 1);
    assert_eq!(
        version("1.0").error(),
        "test.glb: asset.version: glTF 1.0 is not supported; re-export the scene as glTF 2.0"
    );
    assert!(version("two").error().contains("asset.version: glTF version \"two\" is not supported"));
    assert!(b.but("/asset/minVersion", json!("2.1")).error().contains("asset.minVersion: glTF version \"2.1\""));
    assert_eq!(b.without("/asset/version").error(), "test.glb: asset: \"version\" is missing");
}

#[test]
fn a_second_chunk_and_trailing_bytes_do_no_harm() {
    let mut bytes = Builder::square().glb();
    bytes.extend([0; 8]);
    let scene = load_bytes("test.glb", &bytes).expect("a scene");
    assert_eq!(scene.warnings, ["8 bytes after the end of the .glb are ignored"]);
    let bare = glb(br#"{"asset":{"version":"2.0"}}"#, None);
    let scene = load_bytes("test.glb", &bare).expect("an empty scene");
    assert!(scene.meshes.is_empty() && scene.cameras.is_empty() && scene.instances.is_empty());
}

#[test]
fn damaged_data_uris_are_told() {
    let b = Builder::square();
    let uri = |text: &str| b.but("/buffers/0/uri", json!(text)).error();
    assert_eq!(
        uri("data:application/octet-stream"),
        "test.glb: buffers[0].uri: the data URI has no comma before its data"
    );
    assert!(uri("data:;base64,&&&&").starts_with("test.glb: buffers[0].uri: the base64 is damaged: "));
    assert_eq!(uri("data:,abc"), "test.glb: buffers[0].byteLength: says 60 bytes, but there are only 3");
    let mut text = b.clone();
    text.json["buffers"][0]["uri"] = json!(format!("DATA:,{}", "%00".repeat(60)));
    assert!(text.scene().meshes.is_empty(), "sixty zero bytes make no triangle with an area");
}

//! Small hostile files must not take large memory: measured as this process's peak resident set, so Linux only, and
//! alone in its file so that no other test shares the process.
#![cfg(target_os = "linux")]

use gatherlight_render::import::{SceneBundle, load};
use serde_json::{Value, json};

fn peak_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").expect("the process's status");
    let line = status.lines().find(|l| l.starts_with("VmHWM:")).expect("a peak");
    let kib: u64 = line.split_whitespace().nth(1).and_then(|v| v.parse().ok()).expect("a number");
    kib * 1024
}

fn refuse(json: Value) -> String {
    let bundle =
        SceneBundle { name: "small.gltf".into(), root: json.to_string().into_bytes().into(), externals: Vec::new() };
    load(&bundle).map(|_| ()).expect_err("hostile").to_string()
}

fn scene(accessor: Value, primitive: Value, image: Value) -> Value {
    json!({
        "asset": { "version": "2.0" },
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [primitive] }],
        "accessors": [accessor],
        "images": [image],
        "textures": [{ "source": 0 }],
        "materials": [{ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }]
    })
}

#[test]
fn a_kilobyte_cannot_ask_for_a_gigabyte() {
    let before = peak_bytes();
    let plain = json!({ "attributes": { "POSITION": 0 }, "material": 0 });
    let count = u64::from(u32::MAX);
    let hollow = scene(
        json!({ "componentType": 5126, "type": "VEC3", "count": count }),
        plain.clone(),
        json!({ "uri": "a.png" }),
    );
    assert!(refuse(hollow).contains("over the limit of 419"));
    // Four million vertices are allowed to any file; ten thousand primitives of them are not.
    let mut many =
        scene(json!({ "componentType": 5126, "type": "VEC3", "count": 3_000_000 }), plain, json!({ "uri": "a.png" }));
    let primitive = json!({ "attributes": { "POSITION": 0 } });
    many["meshes"][0]["primitives"] = Value::Array(vec![primitive; 10_000]);
    assert!(refuse(many).contains("over the limit of"));
    let after = peak_bytes();
    assert!(after - before < 1 << 30, "grew from {before} to {after} bytes");
}

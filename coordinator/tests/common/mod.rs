//! Runs the real program, and makes small scenes for it.
#![allow(dead_code, unreachable_pub, reason = "each test file uses its part")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// What a run said.
#[derive(Debug)]
pub struct Run {
    /// Exit code.
    pub code: i32,
    /// Results.
    pub out: String,
    /// Messages.
    pub err: String,
}

impl From<Output> for Run {
    fn from(o: Output) -> Self {
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
        Run { code: o.status.code().unwrap_or(-1), out: text(o.stdout), err: text(o.stderr) }
    }
}

impl Run {
    /// Asserts the exit code and that the messages contain every part.
    #[track_caller]
    pub fn says(&self, code: i32, parts: &[&str]) -> &Self {
        assert_eq!(self.code, code, "{self:#?}");
        for part in parts {
            assert!(self.err.contains(part), "no {part:?} in {self:#?}");
        }
        self
    }
    /// The JSON on stdout.
    #[track_caller]
    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.out).unwrap_or_else(|e| panic!("{e}: {self:#?}"))
    }
}

/// `gatherlight` in `dir`, with nothing of the caller's environment that it reads.
pub fn command(dir: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gatherlight"));
    command.current_dir(dir).stdin(Stdio::null());
    for name in ["GATHERLIGHT_LOG", "GATHERLIGHT_COORDINATOR", "GATHERLIGHT_LISTEN", "GATHERLIGHT_STORE"] {
        command.env_remove(name);
    }
    command
}

/// Runs `gatherlight` with arguments separated by spaces.
pub fn run(dir: &Path, args: &str) -> Run {
    command(dir).args(args.split_whitespace()).output().expect("the program starts").into()
}

/// A scene of the repository.
pub fn scene(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes").join(name)
}

/// One lit triangle in front of two cameras, as a .gltf file with its buffer in a file beside it, whose name needs
/// percent-encoding.
pub struct Triangle {
    /// Has a point light.
    pub light: bool,
    /// Has the cameras `wide` (2 : 1) and `tall` (1 : 2).
    pub cameras: bool,
}

impl Triangle {
    /// Writes `triangle.gltf` and its buffer into `dir`.
    pub fn write(&self, dir: &Path) {
        let positions = [[-1.0f32, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]];
        let bytes: Vec<u8> = positions.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        std::fs::write(dir.join("the triangle.bin"), bytes).expect("written");
        std::fs::write(dir.join("triangle.gltf"), self.gltf().to_string()).expect("written");
    }

    fn gltf(&self) -> serde_json::Value {
        use serde_json::json;
        let mut nodes = vec![json!({ "mesh": 0, "name": "Triangle" })];
        let mut file = json!({
            "asset": { "version": "2.0" },
            "buffers": [{ "byteLength": 36, "uri": "the%20triangle.bin" }],
            "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
            "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
                            "min": [-1.0, -1.0, 0.0], "max": [1.0, 1.0, 0.0] }],
            "materials": [{ "name": "White", "pbrMetallicRoughness": { "metallicFactor": 0.0 } }],
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "material": 0 }] }],
            "scene": 0,
        });
        if self.cameras {
            let camera = |name: &str, aspect: f64| {
                json!({ "type": "perspective", "name": name,
                        "perspective": { "yfov": 0.8, "znear": 0.1, "aspectRatio": aspect } })
            };
            file["cameras"] = json!([camera("wide", 2.0), camera("tall", 0.5)]);
            nodes.push(json!({ "camera": 0, "name": "wide", "translation": [0.0, 0.0, 4.0] }));
            nodes.push(json!({ "camera": 1, "name": "tall", "translation": [0.0, 0.0, 4.0] }));
        }
        if self.light {
            file["extensionsUsed"] = json!(["KHR_lights_punctual"]);
            file["extensions"] =
                json!({ "KHR_lights_punctual": { "lights": [{ "type": "point", "intensity": 10.0 }] } });
            nodes.push(
                json!({ "translation": [0.0, 1.0, 3.0], "extensions": { "KHR_lights_punctual": { "light": 0 } } }),
            );
        }
        file["scenes"] = json!([{ "nodes": (0..nodes.len()).collect::<Vec<_>>() }]);
        file["nodes"] = json!(nodes);
        file
    }
}

/// A directory with a good triangle scene in it.
pub fn triangle_dir() -> tempfile::TempDir {
    let dir = tempfile::tempdir().expect("a temporary directory");
    Triangle { light: true, cameras: true }.write(dir.path());
    dir
}

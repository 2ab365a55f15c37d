//! What the fuzzers run: each target takes any bytes and must come back, with its promises kept. The programs of `fuzz/` call
//! these under libFuzzer; `tests/tests/fuzz.rs` calls them with the committed corpora and with damage done to them.

mod machines;
pub mod seeds;
mod wire;

/// Takes any bytes, and panics where something is wrong.
pub type Target = fn(&[u8]);

/// A target by the name of its corpus, `fuzz/corpus/NAME`.
pub const TARGETS: [(&str, Target); 6] = [
    ("chunks", wire::chunks),
    ("messages", wire::messages),
    ("payloads", wire::payloads),
    ("gltf", gltf),
    ("session", machines::session),
    ("schedule", machines::schedule),
];

/// Runs the target called `name`.
///
/// # Panics
/// When there is none, or a promise is broken.
pub fn run(name: &str, bytes: &[u8]) {
    let target = TARGETS.iter().find(|(n, _)| *n == name);
    (target.unwrap_or_else(|| panic!("no target {name:?}")).1)(bytes);
}

/// A scene file that nobody has looked at: read, listed, cut and loaded.
fn gltf(bytes: &[u8]) {
    use gatherlight_render::import::{SceneBundle, external_uris, load};
    use gatherlight_render::job::cut;
    use gatherlight_render::settings::RenderSettings;
    let name = if bytes.starts_with(b"glTF") { "x.glb" } else { "x.gltf" };
    let bundle = SceneBundle { name: name.into(), root: bytes.into(), externals: Vec::new() };
    drop(external_uris(name, bytes));
    let loaded = load(&bundle);
    if let Ok(cut) = cut(&bundle, &RenderSettings::default()) {
        // What is cut is a scene as far as the whole is.
        assert_eq!(load(&cut).is_ok(), loaded.is_ok(), "cutting changed whether it is a scene");
    }
}

/// Bytes as a source of choices; zeros when they are used up.
struct Choices<'b>(&'b [u8]);

impl Choices<'_> {
    fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
    fn byte(&mut self) -> u8 {
        let Some((&first, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        first
    }
    /// 0 … `n` − 1.
    fn below(&mut self, n: u8) -> u8 {
        self.byte() % n.max(1)
    }
}

//! Helpers that tests share.

pub mod agree;
pub mod calibration;
pub mod chi_square;
pub mod cluster;
pub mod fixtures;
pub mod fuzz;
pub mod hostile;
pub mod pipeline;
pub mod processes;
pub mod proxy;
pub mod random;
pub mod real_cluster;
pub mod references;
pub mod scenes;
pub mod simulation;
pub mod single;
pub mod transport;
pub mod welch;

use gatherlight_render::export::decode;
use sha2::{Digest, Sha256};

/// SHA-256 over the bits of every pixel of an EXR file, channel by channel in file order: equal for equal images,
/// whatever the attributes say.
///
/// # Panics
/// When the file cannot be decoded.
pub fn pixel_sha256(exr: &[u8]) -> String {
    let image = decode(exr).expect("an EXR file");
    let mut hash = Sha256::new();
    for (name, values) in &image.channels {
        hash.update(name.as_bytes());
        values.iter().for_each(|v| hash.update(v.to_bits().to_le_bytes()));
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// SHA-256 over the bits of every float of a film, in film order.
pub fn film_sha256(film: &gatherlight_render::film::Film) -> String {
    let mut hash = Sha256::new();
    film.pixels.iter().for_each(|v| hash.update(v.to_bits().to_le_bytes()));
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A scene of the repository's `scenes/`.
///
/// # Panics
/// When it cannot be read.
pub fn scene(name: &str) -> gatherlight_render::import::SceneBundle {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes").join(name);
    let root = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    gatherlight_render::import::SceneBundle { name: name.into(), root: root.into(), externals: Vec::new() }
}

/// [`pixel_sha256`] of the EXR file of a film.
///
/// # Panics
/// When it cannot be encoded.
pub fn film_pixels_sha256(film: &gatherlight_render::film::Film) -> String {
    use gatherlight_render::export::{ImageMetadata, encode};
    let meta = ImageMetadata {
        scene_digest: String::new(),
        settings: Default::default(),
        maps: Vec::new(),
        plan: Vec::new(),
        non_finite: 0,
        samples: None,
        noise: None,
        bias: None,
        rounds: None,
        units: None,
    };
    pixel_sha256(&encode(film, &meta).expect("an EXR file"))
}

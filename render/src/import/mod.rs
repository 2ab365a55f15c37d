//! glTF 2.0 bytes → [`SceneDescription`].

use crate::error::SceneError;
use crate::scene::description::SceneDescription;
use std::sync::Arc;

/// A scene file with every external file it names, as bytes: what a client packs and a cluster passes on.
#[derive(Clone, Debug, Default)]
pub struct SceneBundle {
    /// The .glb or .gltf file's name (without directory).
    pub name: String,
    /// The file itself.
    pub root: Arc<[u8]>,
    /// External buffers and images by the URI the file uses, in file order.
    pub externals: Vec<(String, Arc<[u8]>)>,
}

/// URIs of the external files that a .glb or .gltf names, in file order without duplicates (data URIs left out).
///
/// # Errors
/// When the file is not glTF 2.0.
pub fn external_uris(_name: &str, _root: &[u8]) -> Result<Vec<String>, SceneError> {
    Ok(Vec::new())
}

/// Reads a scene.
///
/// # Errors
/// Names the place in the file and what is wrong with it. Never panics, whatever the bytes.
pub fn load(bundle: &SceneBundle) -> Result<SceneDescription, SceneError> {
    Err(SceneError::invalid(&bundle.name, "not implemented yet"))
}

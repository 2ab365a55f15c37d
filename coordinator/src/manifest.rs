//! A scene's files ↔ their digests.

use bytes::Bytes;
use gatherlight_proto::Digest;
use gatherlight_proto::message::{BlobRef, SceneManifest};
use gatherlight_render::import::SceneBundle;
use std::collections::BTreeMap;

/// The manifest of `bundle`, and its files by digest, sharing the bundle's memory.
pub(crate) fn pack(bundle: &SceneBundle) -> (SceneManifest, BTreeMap<Digest, Bytes>) {
    let mut blobs = BTreeMap::new();
    let mut add = |file: &std::sync::Arc<[u8]>| {
        let blob = BlobRef { digest: Digest::of(file), bytes: file.len() as u64 };
        blobs.entry(blob.digest).or_insert_with(|| Bytes::from_owner(file.clone()));
        blob
    };
    let root = add(&bundle.root);
    let externals = bundle.externals.iter().map(|(uri, file)| (uri.clone(), add(file))).collect();
    (SceneManifest { name: bundle.name.clone(), root, externals }, blobs)
}

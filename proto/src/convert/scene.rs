//! Scene manifests.

use super::{name, required};
use crate::digest::Digest;
use crate::error::WireError;
use crate::limits::{MAX_BLOB_BYTES, MAX_EXTERNALS};
use crate::message::{BlobRef, SceneManifest};
use crate::wire;

impl From<BlobRef> for wire::Blob {
    fn from(b: BlobRef) -> Self {
        wire::Blob { digest: b.digest.to_bytes(), bytes: b.bytes }
    }
}

impl TryFrom<wire::Blob> for BlobRef {
    type Error = WireError;
    fn try_from(b: wire::Blob) -> Result<Self, WireError> {
        WireError::check_limit("blob size in bytes", b.bytes, MAX_BLOB_BYTES, "MAX_BLOB_BYTES")?;
        Ok(BlobRef { digest: Digest::try_from(&b.digest[..])?, bytes: b.bytes })
    }
}

impl From<&SceneManifest> for wire::SceneManifest {
    fn from(m: &SceneManifest) -> Self {
        let external =
            |(uri, blob): &(String, BlobRef)| wire::External { uri: uri.clone(), blob: Some((*blob).into()) };
        wire::SceneManifest {
            name: m.name.clone(),
            root: Some(m.root.into()),
            externals: m.externals.iter().map(external).collect(),
        }
    }
}

impl TryFrom<wire::SceneManifest> for SceneManifest {
    type Error = WireError;
    fn try_from(m: wire::SceneManifest) -> Result<Self, WireError> {
        WireError::check_limit("external files", m.externals.len() as u64, MAX_EXTERNALS as u64, "MAX_EXTERNALS")?;
        let external = |e: wire::External| {
            let blob = required("external.blob", e.blob)?;
            Ok::<_, WireError>((name("external.uri", e.uri)?, BlobRef::try_from(blob)?))
        };
        Ok(SceneManifest {
            name: name("scene.name", m.name)?,
            root: required("scene.root", m.root)?.try_into()?,
            externals: m.externals.into_iter().map(external).collect::<Result<_, _>>()?,
        })
    }
}

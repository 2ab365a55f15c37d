//! The content hash by which both ends know that they hold the same scene.

use crate::import::{self, SceneBundle};

/// BLAKE3 over the scene file and every external file that some image of it may need.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SceneDigest(pub [u8; 32]);

impl SceneDigest {
    /// The digest of `bundle`, or of the scene it was cut from; file names of externals count, the scene file's own name
    /// does not.
    pub fn of(bundle: &SceneBundle) -> Self {
        if let Some(original) = import::original_digest(&bundle.root) {
            return SceneDigest(original);
        }
        // With `keep_all` there are files that no image needs. A scene that is no glTF is named all the same.
        let needed = import::external_uris(&bundle.name, &bundle.root).ok().filter(|_| !bundle.externals.is_empty());
        let counts = |uri: &String| needed.as_ref().is_none_or(|list| list.contains(uri));
        let mut h = blake3::Hasher::new();
        let mut part = |bytes: &[u8]| {
            h.update(&(bytes.len() as u64).to_le_bytes());
            h.update(bytes);
        };
        part(&bundle.root);
        for (uri, bytes) in bundle.externals.iter().filter(|(uri, _)| counts(uri)) {
            part(uri.as_bytes());
            part(bytes);
        }
        SceneDigest(*h.finalize().as_bytes())
    }
}

impl std::fmt::Display for SceneDigest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.iter().try_for_each(|b| write!(f, "{b:02x}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_byte_and_every_boundary_counts() {
        let bundle = |root: &[u8], ext: &[(&str, &[u8])]| SceneBundle {
            name: "x".into(),
            root: root.into(),
            externals: ext.iter().map(|(u, b)| (u.to_string(), (*b).into())).collect(),
        };
        let a = SceneDigest::of(&bundle(b"ab", &[("c", b"d")]));
        assert_eq!(a, SceneDigest::of(&SceneBundle { name: "other".into(), ..bundle(b"ab", &[("c", b"d")]) }));
        assert_ne!(a, SceneDigest::of(&bundle(b"a", &[("bc", b"d")])));
        assert_ne!(a, SceneDigest::of(&bundle(b"ab", &[("c", b"e")])));
        assert_eq!(a.to_string().len(), 64);
    }
}

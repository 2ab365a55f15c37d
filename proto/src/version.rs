//! Versions in the metadata of every call.

use crate::error::{WireError, truncated};
use crate::limits::{PROTOCOL_KEY, PROTOCOL_VERSION, VERSION_KEY};
use gatherlight_render::VERSION;
use tonic::metadata::{AsciiMetadataValue, MetadataMap};

/// Longest version text repeated in an error.
const MAX_VERSION_BYTES: usize = 32;

/// What one side runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Versions {
    /// Protocol of messages and payloads.
    pub protocol: u32,
    /// Program version; decides the bits of an image.
    pub program: String,
}

impl Versions {
    /// Those of this build.
    pub fn own() -> Self {
        Versions { protocol: PROTOCOL_VERSION, program: VERSION.into() }
    }
    /// Writes them into a call's metadata.
    pub fn write(&self, metadata: &mut MetadataMap) {
        metadata.insert(PROTOCOL_KEY, AsciiMetadataValue::from(self.protocol));
        if let Ok(value) = AsciiMetadataValue::try_from(self.program.as_str()) {
            metadata.insert(VERSION_KEY, value);
        }
    }
}

/// Checks a peer's versions. Clients need the same protocol; workers need the same program as well, since another one
/// may compute other bits.
///
/// # Errors
/// [`WireError::Version`] with both sides' versions.
pub fn check(metadata: &MetadataMap, peer: &'static str, same_program: bool) -> Result<(), WireError> {
    let read = |key| metadata.get(key).and_then(|v| v.to_str().ok()).map(|v| truncated(v, MAX_VERSION_BYTES));
    let (protocol, version) = (read(PROTOCOL_KEY), read(VERSION_KEY));
    let fits = protocol.is_some_and(|p| p == PROTOCOL_VERSION.to_string())
        && (!same_program || version.is_some_and(|v| v == VERSION));
    if fits {
        return Ok(());
    }
    let text = |v: Option<&str>| v.unwrap_or("?").to_owned();
    Err(WireError::Version { peer, version: text(version), protocol: text(protocol) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checked(versions: &Versions, same_program: bool) -> Result<(), WireError> {
        let mut metadata = MetadataMap::new();
        versions.write(&mut metadata);
        check(&metadata, "worker", same_program)
    }

    #[test]
    fn own_versions_fit() {
        assert_eq!(checked(&Versions::own(), true), Ok(()));
    }

    #[test]
    fn another_protocol_is_refused_with_both_versions() {
        let text = checked(&Versions { protocol: 99, program: "7.8.9".into() }, false).unwrap_err().to_string();
        for part in [VERSION, "7.8.9", "protocol 99", &format!("protocol {PROTOCOL_VERSION}")] {
            assert!(text.contains(part), "{text:?} lacks {part:?}");
        }
    }

    #[test]
    fn another_program_is_refused_for_workers_only() {
        let other = Versions { program: "7.8.9".into(), ..Versions::own() };
        assert!(checked(&other, true).is_err());
        assert_eq!(checked(&other, false), Ok(()));
    }

    #[test]
    fn no_version_at_all_is_refused() {
        assert!(check(&MetadataMap::new(), "client", false).unwrap_err().to_string().contains("gatherlight ?"));
    }
}

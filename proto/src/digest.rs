//! Content addresses.

use crate::error::WireError;
use bytes::Bytes;
use std::fmt;

/// BLAKE3 of some bytes; their name everywhere.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Digest(pub [u8; 32]);

impl Digest {
    /// Digest of `bytes`.
    pub fn of(bytes: &[u8]) -> Self {
        Digest(*blake3::hash(bytes).as_bytes())
    }
    /// For the wire.
    pub fn to_bytes(self) -> Bytes {
        Bytes::copy_from_slice(&self.0)
    }
}

impl TryFrom<&[u8]> for Digest {
    type Error = WireError;
    fn try_from(bytes: &[u8]) -> Result<Self, WireError> {
        let array = bytes
            .try_into()
            .map_err(|_| WireError::invalid("digest", format!("has {} bytes, a BLAKE3 digest has 32", bytes.len())))?;
        Ok(Digest(array))
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|b| write!(f, "{b:02x}"))
    }
}

impl fmt::Debug for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

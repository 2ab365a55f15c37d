//! Content addresses.

use crate::error::WireError;
use bytes::Bytes;
use std::fmt;
use std::str::FromStr;

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

impl FromStr for Digest {
    type Err = WireError;
    fn from_str(text: &str) -> Result<Self, WireError> {
        let invalid = || WireError::invalid("digest", "has to be 64 hexadecimal digits");
        let mut digest = [0; 32];
        if text.len() != 64 || !text.bytes().all(|b| b.is_ascii_hexdigit()) {
            return Err(invalid());
        }
        for (i, byte) in digest.iter_mut().enumerate() {
            *byte = u8::from_str_radix(&text[2 * i..2 * i + 2], 16).map_err(|_| invalid())?;
        }
        Ok(Digest(digest))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_digest_is_read_as_it_is_written() {
        let digest = Digest::of(b"a");
        assert_eq!(Digest::from_str(&digest.to_string()), Ok(digest));
        for bad in ["", "12", &"g".repeat(64), &"+".repeat(64), &"é".repeat(32)] {
            assert!(Digest::from_str(bad).is_err(), "{bad}");
        }
    }
}

//! Reading the fixed header of a payload.

use crate::error::WireError;
use std::cell::Cell;
use std::fmt::Display;

/// Reads fields in order; every error names the payload.
pub(super) struct Reader<'a> {
    what: &'static str,
    rest: Cell<&'a [u8]>,
}

impl<'a> Reader<'a> {
    pub(super) fn new(what: &'static str, bytes: &'a [u8]) -> Self {
        Reader { what, rest: Cell::new(bytes) }
    }
    /// The next `N` bytes.
    pub(super) fn array<const N: usize>(&self) -> Result<[u8; N], WireError> {
        let Some((head, rest)) = self.rest.get().split_first_chunk::<N>() else {
            return Err(WireError::payload(self.what, "ends within its header"));
        };
        self.rest.set(rest);
        Ok(*head)
    }
    /// Checks the first word and the layout's version.
    pub(super) fn magic(&self, magic: [u8; 4], version: u32) -> Result<(), WireError> {
        if self.array()? != magic {
            return Err(WireError::payload(self.what, format!("does not start with {}", magic.escape_ascii())));
        }
        self.expect("the layout version", u32::from_le_bytes(self.array()?), version)
    }
    /// Checks that a field is what it must be.
    pub(super) fn expect<T: PartialEq + Display>(&self, field: &str, actual: T, due: T) -> Result<(), WireError> {
        if actual == due {
            return Ok(());
        }
        Err(WireError::payload(self.what, format!("{field} is {actual}, expected {due}")))
    }
}

//! Half-open ranges of work indices: emitted photon paths, or tiles.

use std::fmt;

/// Indices [first, end).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct EmissionRange {
    /// First index.
    pub first: u64,
    /// One past the last index.
    pub end: u64,
}

impl EmissionRange {
    /// [first, end); `None` when end < first.
    pub fn new(first: u64, end: u64) -> Option<Self> {
        (first <= end).then_some(EmissionRange { first, end })
    }
    /// Number of indices.
    pub fn len(&self) -> u64 {
        self.end - self.first
    }
    /// No index.
    pub fn is_empty(&self) -> bool {
        self.first == self.end
    }
}

impl fmt::Display for EmissionRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "[{}, {})", self.first, self.end)
    }
}

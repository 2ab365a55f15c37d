//! Triangle lists, strips and fans → triangles.

use super::json::{Item, Result};

/// glTF's primitive modes that make triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Topology {
    Triangles,
    Strip,
    Fan,
}

impl Topology {
    /// The primitive's mode; `None` for points and lines.
    ///
    /// # Errors
    /// When it is none of glTF's.
    pub(super) fn read(primitive: &Item) -> Result<Option<Self>> {
        let Some(mode) = primitive.get("mode")? else { return Ok(Some(Topology::Triangles)) };
        match mode.unsigned()? {
            0..=3 => Ok(None),
            4 => Ok(Some(Topology::Triangles)),
            5 => Ok(Some(Topology::Strip)),
            6 => Ok(Some(Topology::Fan)),
            other => Err(mode.error(format!("{other} is not a primitive mode; glTF has 0 to 6"))),
        }
    }
    /// Triangles that `corners` indices make.
    pub(super) fn triangle_count(self, corners: usize) -> usize {
        match self {
            Topology::Triangles => corners / 3,
            Topology::Strip | Topology::Fan => corners.saturating_sub(2),
        }
    }
    /// Which indices make triangle `t`, counter-clockwise (glTF §3.7.2.1).
    #[inline]
    pub(super) fn corners(self, t: usize) -> [usize; 3] {
        match self {
            Topology::Triangles => [3 * t, 3 * t + 1, 3 * t + 2],
            Topology::Strip => [t, t + 1 + t % 2, t + 2 - t % 2],
            Topology::Fan => [t + 1, t + 2, 0],
        }
    }
}

//! The photons of one emission range, in path order, packed as they travel and are stored.

use super::EmissionRange;

/// Which map photons belong to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum MapKind {
    /// All light on diffuse surfaces, read behind final-gather rays (L(S|G|D)*D).
    Global,
    /// Light focused by specular or glossy lobes onto diffuse surfaces, read directly (L(S|G)⁺D).
    Caustic,
}

impl MapKind {
    /// Both kinds, in canonical order.
    pub const ALL: [MapKind; 2] = [MapKind::Global, MapKind::Caustic];
    /// Name in logs and headers.
    pub const fn name(self) -> &'static str {
        match self {
            MapKind::Global => "global",
            MapKind::Caustic => "caustic",
        }
    }
}

/// Photons stored by the paths of `range`, structure of arrays, sorted by (path index, bounce).
///
/// All arrays that are present have one entry per photon.
#[derive(Clone, Debug, PartialEq)]
pub struct PhotonBatch {
    /// The paths that were emitted; its length is the batch's share of the emitted count, the divisor.
    pub range: EmissionRange,
    /// Positions in scene space.
    pub positions: Vec<[f32; 3]>,
    /// Undivided power, RGBE (see [`super::pack::encode_rgbe`]).
    pub powers: Vec<u32>,
    /// Geometric normal on the side the light came from, octahedral 2 × 8 bits.
    pub normals: Vec<u16>,
    /// Direction towards the light (wi), octahedral 2 × 16 bits; `None` where no receiver needs it.
    pub directions: Option<Vec<u32>>,
}

impl PhotonBatch {
    /// An empty batch of `range`.
    pub fn new(range: EmissionRange, directions: bool) -> Self {
        PhotonBatch {
            range,
            positions: Vec::new(),
            powers: Vec::new(),
            normals: Vec::new(),
            directions: directions.then(Vec::new),
        }
    }
    /// Number of stored photons.
    pub fn len(&self) -> usize {
        self.positions.len()
    }
    /// No photon was stored.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }
}

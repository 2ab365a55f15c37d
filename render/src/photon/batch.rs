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

/// What light vertices carry beyond photons (Georgiev 2012, "Implementing Vertex Connection and Merging"). One entry a
/// vertex in each array.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LightVertices {
    /// Direction towards the light (wi), octahedral 2 × 16 bits.
    pub directions: Vec<u32>,
    /// Square roots of dVCM and dVM, the vertex's share in the weights of the paths it becomes part of; finite, ≥ 0. Roots,
    /// because the power heuristic's squares would leave the range of f32.
    pub shares: Vec<[f32; 2]>,
    /// Edges from the light; 255 also stands for more.
    pub lengths: Vec<u8>,
}

impl LightVertices {
    /// Whether every array has `count` entries.
    pub fn have_length(&self, count: usize) -> bool {
        self.directions.len() == count && self.shares.len() == count && self.lengths.len() == count
    }
    /// Makes room for `count` more.
    pub(super) fn reserve_exact(&mut self, count: usize) {
        self.directions.reserve_exact(count);
        self.shares.reserve_exact(count);
        self.lengths.reserve_exact(count);
    }
    /// Appends those of `other`.
    pub(super) fn extend(&mut self, other: &LightVertices) {
        self.directions.extend_from_slice(&other.directions);
        self.shares.extend_from_slice(&other.shares);
        self.lengths.extend_from_slice(&other.lengths);
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
    /// Geometric normal, octahedral 2 × 8 bits: of photons on the side the light came from, of light vertices the front's.
    pub normals: Vec<u16>,
    /// Of light vertices, what they carry besides.
    pub vertices: Option<LightVertices>,
    /// Photons left out because their power was not finite.
    pub non_finite: u64,
}

impl PhotonBatch {
    /// An empty batch of `range`, of photons or of light `vertices`.
    pub fn new(range: EmissionRange, vertices: bool) -> Self {
        PhotonBatch {
            range,
            positions: Vec::new(),
            powers: Vec::new(),
            normals: Vec::new(),
            vertices: vertices.then(LightVertices::default),
            non_finite: 0,
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

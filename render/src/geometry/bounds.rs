//! Axis-aligned boxes.

use glam::Vec3;

/// An axis-aligned box; empty where `min > max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Lower corner.
    pub min: Vec3,
    /// Upper corner.
    pub max: Vec3,
}

impl Bounds {
    /// The box that holds nothing; the neutral element of [`Bounds::union`].
    pub const EMPTY: Bounds = Bounds { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    /// The smallest box around `points`.
    pub fn of(points: impl IntoIterator<Item = Vec3>) -> Self {
        points.into_iter().fold(Bounds::EMPTY, |b, p| b.with(p))
    }
    /// The smallest box that also holds `point`.
    #[inline]
    pub fn with(self, point: Vec3) -> Self {
        Bounds { min: self.min.min(point), max: self.max.max(point) }
    }
    /// The smallest box that holds both.
    #[inline]
    pub fn union(self, other: Bounds) -> Self {
        Bounds { min: self.min.min(other.min), max: self.max.max(other.max) }
    }
    /// Whether it holds nothing.
    pub fn is_empty(self) -> bool {
        !self.min.cmple(self.max).all()
    }
    /// Extent along each axis; zero if empty.
    #[inline]
    pub fn extent(self) -> Vec3 {
        (self.max - self.min).max(Vec3::ZERO)
    }
    /// Middle; not finite if empty.
    #[inline]
    pub fn center(self) -> Vec3 {
        self.min * 0.5 + self.max * 0.5
    }
    /// Half the surface area, the measure of the surface area heuristic; zero if empty.
    #[inline]
    pub fn half_area(self) -> f32 {
        let e = self.extent();
        e.x * e.y + e.y * e.z + e.z * e.x
    }
    /// Its eight corners.
    pub fn corners(self) -> [Vec3; 8] {
        std::array::from_fn(|i| {
            let pick = |bit: usize, low: f32, high: f32| if i >> bit & 1 == 0 { low } else { high };
            Vec3::new(pick(0, self.min.x, self.max.x), pick(1, self.min.y, self.max.y), pick(2, self.min.z, self.max.z))
        })
    }
}

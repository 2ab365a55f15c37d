//! Sets of lobe kinds.

/// A set of lobe kinds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lobes(u8);

impl Lobes {
    /// No lobe.
    pub const NONE: Lobes = Lobes(0);
    /// Lambertian reflection, under a coat or not.
    pub const DIFFUSE: Lobes = Lobes(1);
    /// Rough reflection and transmission: neither Dirac nor Lambertian.
    pub const GLOSSY: Lobes = Lobes(2);
    /// Dirac reflection and transmission.
    pub const SPECULAR: Lobes = Lobes(4);
    /// Everything that `eval` and `pdf` see.
    pub const NON_DIRAC: Lobes = Lobes(3);
    /// Everything but Lambertian reflection: what makes caustics.
    pub const NON_DIFFUSE: Lobes = Lobes(6);
    /// Every kind.
    pub const ALL: Lobes = Lobes(7);

    /// Whether every kind of `other` is in this set.
    #[inline]
    pub const fn contains(self, other: Lobes) -> bool {
        self.0 & other.0 == other.0
    }
    /// Whether the two sets share a kind.
    #[inline]
    pub const fn intersects(self, other: Lobes) -> bool {
        self.0 & other.0 != 0
    }
    /// Kinds in either set.
    #[inline]
    pub const fn union(self, other: Lobes) -> Lobes {
        Lobes(self.0 | other.0)
    }
    /// Kinds in both sets.
    #[inline]
    pub const fn intersection(self, other: Lobes) -> Lobes {
        Lobes(self.0 & other.0)
    }
    /// Whether the set is empty.
    #[inline]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }
}

impl std::ops::BitOr for Lobes {
    type Output = Lobes;
    #[inline]
    fn bitor(self, o: Lobes) -> Lobes {
        self.union(o)
    }
}

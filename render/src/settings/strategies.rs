//! The strategies of bidirectional path tracing as image layers (Veach 1997, figure 10.3).

/// Edges of the longest path whose strategies are told apart.
pub const MAX_EDGES: u32 = 5;

/// A way to make a path of s + t − 1 edges: `s` vertices from a light, `t` from the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Strategy {
    /// Vertices of the light sub-path, the one on the light among them.
    pub s: u32,
    /// Vertices of the camera sub-path, the lens among them; ≥ 1.
    pub t: u32,
}

impl Strategy {
    /// Strategies of paths of up to [`MAX_EDGES`] edges.
    pub const COUNT: usize = before(MAX_EDGES + 1) as usize;
    /// Planes of a light image that has all of them, beside the image itself.
    pub const PLANES: u32 = 2 * Self::COUNT as u32;

    /// The strategy, where it is one that is told apart: its paths are short enough, and it is not the one of a light seen
    /// by itself from the light's side, which nothing uses.
    pub fn new(s: u32, t: u32) -> Option<Strategy> {
        let edges = s.checked_add(t)?.checked_sub(1)?;
        let used = t >= 1 && (1..=MAX_EDGES).contains(&edges) && (edges > 1 || s == 0);
        used.then_some(Strategy { s, t })
    }
    /// All, by edges, then by s: the rows of the triangle.
    pub fn all() -> impl Iterator<Item = Strategy> {
        (1..=MAX_EDGES).flat_map(|edges| (0..=edges).filter_map(move |s| Strategy::new(s, edges + 1 - s)))
    }
    /// Edges of its paths.
    pub fn edges(self) -> u32 {
        self.s + self.t - 1
    }
    /// Place in [`Strategy::all`].
    pub fn index(self) -> u32 {
        before(self.edges()) + self.s
    }
    /// Planes of the light image that its weighted and its unweighted contributions are summed in.
    pub fn planes(self) -> [u32; 2] {
        [1 + 2 * self.index(), 2 + 2 * self.index()]
    }
    /// Channels of all, in the order of their planes: `weighted.s0t2.R`, … `unweighted.s0t2.R`, ….
    pub fn channel_names() -> Vec<String> {
        let kinds = |s: Strategy| ["weighted", "unweighted"].map(|kind| format!("{kind}.s{}t{}", s.s, s.t));
        let channels = |name: String| ["R", "G", "B"].map(|c| format!("{name}.{c}"));
        Strategy::all().flat_map(kinds).flat_map(channels).collect()
    }
}

/// Strategies of paths of fewer than `edges` ≥ 1 edges: one for one edge, k + 1 for k.
const fn before(edges: u32) -> u32 {
    if edges < 2 { 0 } else { edges * (edges + 1) / 2 - 2 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_count_the_triangle() {
        let all: Vec<Strategy> = Strategy::all().collect();
        assert_eq!(all.len(), Strategy::COUNT);
        for (i, s) in all.iter().enumerate() {
            assert_eq!(s.index() as usize, i, "{s:?}");
        }
        assert_eq!([1, 2, 5].map(|k| all.iter().filter(|s| s.edges() == k).count()), [1, 3, 6]);
        for (s, t) in [(0, 0), (0, 1), (1, 1), (3, 0), (0, 7), (4, 3), (u32::MAX, 2)] {
            assert_eq!(Strategy::new(s, t), None, "({s}, {t})");
        }
        assert_eq!(Strategy::channel_names().len(), 3 * Strategy::PLANES as usize);
    }
}

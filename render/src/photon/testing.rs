//! Point sets that the tests of all search structures share.

use crate::math::{Purpose, Stream};

/// Point sets from random volumes to every kind of degeneration.
pub(super) fn point_sets() -> Vec<(&'static str, Vec<[f32; 3]>)> {
    let mut s = Stream::new(11, Purpose::Test, 0, 0);
    let mut random = |n: usize| -> Vec<[f32; 3]> {
        (0..n).map(|_| [s.next_f32() * 2.0 - 1.0, s.next_f32() * 2.0 - 1.0, s.next_f32() * 2.0 - 1.0]).collect()
    };
    let mut sets = vec![];
    for n in [0, 1, 2, 3, 15, 16, 17, 31, 32, 33, 63, 64, 65, 127, 128, 129, 255, 500, 1023, 1025, 3000] {
        sets.push(("volume", random(n)));
    }
    sets.push(("plane", random(3000).iter().map(|p| [p[0], 0.25, p[2]]).collect()));
    sets.push(("line", random(2000).iter().map(|p| [0.5, p[1], -0.125]).collect()));
    sets.push(("point", vec![[0.1, -0.2, 0.3]; 2000]));
    sets.push(("two points", (0..2000).map(|i| [(i % 2) as f32, 0.0, 0.0]).collect()));
    sets.push(("signed zeros", (0..500).map(|i| [if i % 2 == 0 { 0.0 } else { -0.0 }, 0.0, -0.0]).collect()));
    sets.push(("lattice", random(3000).iter().map(|p| p.map(|c| (c * 4.0).round() / 4.0)).collect()));
    let mut spot = random(2500);
    spot.iter_mut().skip(500).for_each(|p| *p = [p[0] * 1e-3 + 0.5, 0.0, p[2] * 1e-3]);
    sets.push(("caustic spot", spot));
    sets
}

/// Squared distance, computed as the searches do.
pub(super) fn distance_squared(a: [f32; 3], b: [f32; 3]) -> f32 {
    let d = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
}

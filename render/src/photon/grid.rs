//! A spatial hash grid for searches within a fixed radius: the alternative to the k-d tree for rounds of one radius.
//!
//! Space is cut into cubes with edges of twice the radius, so that a ball touches at most two cubes along each axis. Photons are
//! sorted by the bucket of their cube; cubes that follow each other along x have buckets that follow each other, so that a ball
//! is at most four runs of memory (Teschner et al. 2003 for the hash). Photons of another cube in the same bucket are told
//! apart by their position, which holds the result exact whatever collides. A search may use any radius: more cubes are
//! visited, or all photons when that is less.

use super::query::{Neighbour, PhotonSearch, bound_of, from_key, key};

/// Photons per bucket aimed at.
const PHOTONS_PER_BUCKET: usize = 4;
/// Photons whose distances are computed at once.
const LANES: usize = 16;
/// Least edge of a cube, scene space: below it positions are rounding errors, and cube numbers would overflow.
const MIN_EDGE: f32 = 1e-6;

/// A hash grid that owns the photons' positions, sorted by bucket.
#[derive(Clone, Debug, PartialEq)]
pub struct HashGrid {
    len: usize,
    radius: f32,
    inverse_edge: f32,
    /// Buckets are this + 1, a power of two.
    mask: u32,
    /// First photon of each bucket, and the end.
    starts: Vec<u32>,
    /// Coordinates in bucket order, padded by [`LANES`] zeros.
    coordinates: [Vec<f32>; 3],
}

/// Numbers of the cubes a ball touches, from the first to the last along each axis.
struct Cubes {
    first: [i32; 3],
    last: [i32; 3],
}

impl HashGrid {
    /// Builds the grid for searches within `radius` > 0, scene space, and says where each photon went: entry i of the second
    /// result is the index in `positions` of the photon that is now i-th.
    ///
    /// # Panics
    /// With more than 2³² − 1 photons.
    pub fn build(positions: &[[f32; 3]], radius: f32) -> (HashGrid, Vec<u32>) {
        let len = positions.len();
        assert!(len <= u32::MAX as usize, "{len} photons: a grid holds at most {}", u32::MAX);
        let inverse_edge = 1.0 / (2.0 * radius).max(MIN_EDGE);
        let mask = (len / PHOTONS_PER_BUCKET).next_power_of_two().min(1 << 31) as u32 - 1;
        let mut grid =
            HashGrid { len, radius, inverse_edge, mask, starts: Vec::new(), coordinates: Default::default() };
        // A counting sort: stable, so that photons of a bucket keep their order.
        let buckets: Vec<u32> = positions.iter().map(|&p| grid.bucket(p.map(|c| grid.cube(c)))).collect();
        let mut starts = vec![0u32; mask as usize + 2];
        buckets.iter().for_each(|&b| starts[b as usize + 1] += 1);
        for b in 1..starts.len() {
            starts[b] += starts[b - 1];
        }
        let mut next = starts.clone();
        let mut order = vec![0u32; len];
        for (i, &b) in buckets.iter().enumerate() {
            order[next[b as usize] as usize] = i as u32;
            next[b as usize] += 1;
        }
        grid.starts = starts;
        grid.coordinates = [0, 1, 2].map(|axis| {
            let mut c = Vec::with_capacity(len + LANES);
            c.extend(order.iter().map(|&i| positions[i as usize][axis]));
            c.resize(len + LANES, 0.0);
            c
        });
        (grid, order)
    }

    /// Number of photons.
    pub fn len(&self) -> usize {
        self.len
    }
    /// No photon.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }
    /// The radius the grid is made for, scene space.
    pub fn radius(&self) -> f32 {
        self.radius
    }
    /// Position of photon `index` (< len) in the grid's order.
    #[inline]
    pub fn position(&self, index: u32) -> [f32; 3] {
        let i = index as usize;
        [self.coordinates[0][i], self.coordinates[1][i], self.coordinates[2][i]]
    }
    /// The coordinates along `axis` (0, 1, 2), in the grid's order.
    pub fn coordinates(&self, axis: usize) -> &[f32] {
        &self.coordinates[axis][..self.len]
    }
    /// Memory of positions and buckets.
    pub fn memory_bytes(&self) -> u64 {
        (12 * (self.len + LANES) + 4 * self.starts.len()) as u64
    }

    /// Number of the cube that holds coordinate `v`: ⌊v / edge⌋, saturated. Never falls as `v` grows.
    #[inline(always)]
    fn cube(&self, v: f32) -> i32 {
        let scaled = v * self.inverse_edge;
        let truncated = scaled as i32;
        truncated.saturating_sub(i32::from(truncated as f32 > scaled))
    }
    #[inline(always)]
    fn bucket(&self, [x, y, z]: [i32; 3]) -> u32 {
        self.row(y, z).wrapping_add(x as u32) & self.mask
    }
    /// Bucket of cube (0, y, z), before the mask.
    #[inline(always)]
    fn row(&self, y: i32, z: i32) -> u32 {
        let h = (y as u32).wrapping_mul(0x9e37_79b1) ^ (z as u32).wrapping_mul(0x85eb_ca77);
        (h ^ h >> 15).wrapping_mul(0x2c1b_3c6d)
    }

    /// The cubes around `q` with all photons whose computed squared distance is below `radius_squared`; `None` when looking at
    /// all photons is less work.
    fn cubes(&self, q: [f32; 3], radius_squared: f32) -> Option<Cubes> {
        // The rounding of differences, squares and sums, and of q ± r, is far below these margins.
        let reach = |c: f32| radius_squared.sqrt() * (1.0 + 1e-6) + c.abs() * 1e-6 + f32::MIN_POSITIVE;
        let first = q.map(|c| self.cube(c - reach(c)));
        let last = q.map(|c| self.cube(c + reach(c)));
        let count = [0, 1, 2].map(|a| (i64::from(last[a]) - i64::from(first[a]) + 1) as u64);
        let rows = count[1].saturating_mul(count[2]);
        let visits = rows.saturating_mul(count[0]);
        (count[0] <= u64::from(self.mask) + 1 && visits <= self.len as u64).then_some(Cubes { first, last })
    }

    /// Calls `visit` with the index and squared distance of each photon of `range` below the bound.
    #[inline(always)]
    fn scan(&self, range: std::ops::Range<usize>, q: [f32; 3], bound: u64, mut visit: impl FnMut(u64)) {
        let mut first = range.start;
        while first < range.end {
            let [Some(x), Some(y), Some(z)] = [0, 1, 2].map(|a| self.coordinates[a][first..].first_chunk::<LANES>())
            else {
                return;
            };
            let mut distances = [0.0f32; LANES];
            for (i, d) in distances.iter_mut().enumerate() {
                let (dx, dy, dz) = (x[i] - q[0], y[i] - q[1], z[i] - q[2]);
                *d = dx * dx + dy * dy + dz * dz;
            }
            for (i, &d) in distances.iter().enumerate().take(range.end - first) {
                let key = key(d, (first + i) as u32);
                if key < bound {
                    visit(key);
                }
            }
            first += LANES;
        }
    }

    /// Calls `visit` with the key of each photon within the radius, each once.
    #[inline(always)]
    fn for_each_key(&self, q: [f32; 3], radius_squared: f32, mut visit: impl FnMut(u64)) {
        let bound = bound_of(radius_squared);
        if bound == 0 || !q.iter().all(|c| c.is_finite()) {
            return;
        }
        let Some(Cubes { first, last }) = self.cubes(q, radius_squared) else {
            return self.scan(0..self.len, q, bound, visit);
        };
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                let begin = self.row(y, z).wrapping_add(first[0] as u32) & self.mask;
                let end = u64::from(begin) + (last[0] - first[0]) as u64;
                // The run of buckets, in two parts where it wraps around.
                let wrapped = end.checked_sub(u64::from(self.mask) + 1).map(|e| (0, e as usize));
                let run = (begin as usize, end.min(u64::from(self.mask)) as usize);
                for (a, b) in std::iter::once(run).chain(wrapped) {
                    let photons = self.starts[a] as usize..self.starts[b + 1] as usize;
                    self.scan(photons, q, bound, |key| {
                        let i = key as u32 as usize;
                        // Only in its own row is a photon met in its own bucket, and there once.
                        if self.cube(self.coordinates[1][i]) == y && self.cube(self.coordinates[2][i]) == z {
                            visit(key);
                        }
                    });
                }
            }
        }
    }
}

impl PhotonSearch for HashGrid {
    fn for_each_within(&self, point: [f32; 3], radius_squared: f32, mut visit: impl FnMut(Neighbour)) {
        self.for_each_key(point, radius_squared, |key| visit(from_key(key)));
    }

    fn nearest(&self, point: [f32; 3], radius_squared: f32, accept: impl Fn(u32) -> bool) -> Option<Neighbour> {
        let mut best = u64::MAX;
        self.for_each_key(point, radius_squared, |key| {
            if key < best && accept(key as u32) {
                best = key;
            }
        });
        (best != u64::MAX).then(|| from_key(best))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{Purpose, Stream};
    use crate::photon::testing::{distance_squared, point_sets};

    #[test]
    fn searches_equal_brute_force_at_any_radius() {
        let mut s = Stream::new(21, Purpose::Test, 0, 0);
        for (name, points) in point_sets() {
            for made_for in [1e-9, 0.003, 0.05, 0.4, 3.0] {
                let (grid, order) = HashGrid::build(&points, made_for);
                let mut sorted = order.clone();
                sorted.sort_unstable();
                assert!(sorted.iter().enumerate().all(|(i, &o)| o == i as u32));
                for _ in 0..12 {
                    let q = match s.next_u64() % 3 {
                        0 if !points.is_empty() => points[(s.next_u64() % points.len() as u64) as usize],
                        _ => [s.next_f32() * 3.0 - 1.5, s.next_f32() * 3.0 - 1.5, s.next_f32() * 3.0 - 1.5],
                    };
                    let factor = [1.0, 0.3, 2.7, 40.0, f32::INFINITY][(s.next_u64() % 5) as usize];
                    let radius_squared = (made_for * factor) * (made_for * factor);
                    let mut expect: Vec<u64> = (0..points.len() as u32)
                        .map(|i| key(distance_squared(grid.position(i), q), i))
                        .filter(|&k| k < bound_of(radius_squared))
                        .collect();
                    let mut found = vec![];
                    grid.for_each_within(q, radius_squared, |n| found.push(key(n.distance_squared, n.index)));
                    expect.sort_unstable();
                    found.sort_unstable();
                    assert_eq!(found, expect, "{name} {} {made_for} {factor}", points.len());
                    let even = expect.iter().copied().find(|k| k % 2 == 0).map(from_key);
                    assert_eq!(grid.nearest(q, radius_squared, |i| i % 2 == 0), even);
                }
            }
        }
    }

    #[test]
    fn runs_of_buckets_wrap_around() {
        // Few buckets and many cubes: most runs cross the end of the table.
        let mut s = Stream::new(22, Purpose::Test, 0, 0);
        let points: Vec<[f32; 3]> = (0..64).map(|_| [s.next_f32(), 0.0, s.next_f32() * 0.1]).collect();
        let (grid, _) = HashGrid::build(&points, 0.04);
        for &q in &points {
            let mut found = 0;
            grid.for_each_within(q, 0.0016, |_| found += 1);
            assert_eq!(found, points.iter().filter(|&&p| distance_squared(p, q) < 0.0016).count());
        }
    }

    #[test]
    fn senseless_arguments_find_nothing() {
        let (grid, _) = HashGrid::build(&[[0.0; 3]; 10], 0.1);
        for (q, r2) in
            [([f32::NAN; 3], 1.0), ([f32::INFINITY; 3], 1.0), ([0.0; 3], f32::NAN), ([0.0; 3], -1.0), ([0.0; 3], 0.0)]
        {
            grid.for_each_within(q, r2, |_| panic!("{q:?} {r2}"));
        }
        let far = [[f32::MAX; 3], [f32::MIN; 3], [f32::NAN; 3], [0.0; 3]];
        let (grid, _) = HashGrid::build(&far, 0.1);
        assert_eq!(grid.nearest([0.0; 3], 0.01, |_| true).map(|n| n.distance_squared), Some(0.0));
    }
}

//! Neighbour searches over photons: the interface of the search structures and the collectors they feed.
//!
//! A candidate is one `u64` key, squared distance (as ordered bits) above photon index. Keys are unique, so "the k
//! nearest" is one well-defined set, ties broken by the lower index, and every structure finds the same set as brute force.

/// One photon found by a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// Index of the photon in the structure's order.
    pub index: u32,
    /// Squared distance from the query point, scene space.
    pub distance_squared: f32,
}

/// What a search structure over photons answers. Both searches are exact; "within" is strictly less than the radius.
pub trait PhotonSearch {
    /// Calls `visit` for each photon with squared distance < `radius_squared` from `point`, in an order that is a function
    /// of the structure and the point alone.
    fn for_each_within(&self, point: [f32; 3], radius_squared: f32, visit: impl FnMut(Neighbour));

    /// The nearest photon with squared distance < `radius_squared` that `accept` takes; the lowest index among equals.
    fn nearest(&self, point: [f32; 3], radius_squared: f32, accept: impl Fn(u32) -> bool) -> Option<Neighbour>;
}

/// Squared distance and index as one key that orders by distance, then index. `distance_squared` ≥ 0; NaN orders last.
#[inline(always)]
pub(super) fn key(distance_squared: f32, index: u32) -> u64 {
    u64::from(distance_squared.to_bits()) << 32 | u64::from(index)
}

/// The key below which all candidates within `radius_squared` lie; 0 (nothing) for a radius that is NaN or ≤ 0.
#[inline(always)]
pub(super) fn bound_of(radius_squared: f32) -> u64 {
    if radius_squared > 0.0 { key(radius_squared, 0) } else { 0 }
}

#[inline(always)]
pub(super) fn from_key(key: u64) -> Neighbour {
    Neighbour { index: key as u32, distance_squared: f32::from_bits((key >> 32) as u32) }
}

/// Receives candidates during a traversal and says how near the next ones must be.
pub(super) trait Collector {
    /// Only keys below this matter.
    fn bound(&self) -> u64;
    /// Takes a candidate whose key is below the bound.
    fn take(&mut self, key: u64);
}

/// Calls a function for every candidate within a fixed radius.
pub(super) struct Within<F> {
    pub(super) bound: u64,
    pub(super) visit: F,
}

impl<F: FnMut(Neighbour)> Collector for Within<F> {
    #[inline(always)]
    fn bound(&self) -> u64 {
        self.bound
    }
    #[inline(always)]
    fn take(&mut self, key: u64) {
        (self.visit)(from_key(key));
    }
}

/// Keeps the nearest candidate.
pub(super) struct Nearest {
    pub(super) best: u64,
}

impl Collector for Nearest {
    #[inline(always)]
    fn bound(&self) -> u64 {
        self.best
    }
    #[inline(always)]
    fn take(&mut self, key: u64) {
        self.best = key;
    }
}

/// Memory for k-nearest searches, reused from query to query. Holds nothing that influences a result.
#[derive(Clone, Debug, Default)]
pub struct NeighbourBuffer {
    keys: Vec<u64>,
    scratch: Vec<u64>,
}

impl NeighbourBuffer {
    /// An empty buffer; it grows to what the searches need.
    pub fn new() -> Self {
        Self::default()
    }
    /// The photons the last search found, each once, in an order that is a function of the structure and
    /// the search's arguments alone.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Neighbour> + '_ {
        self.keys.iter().map(|&k| from_key(k))
    }
    /// Number of photons the last search found.
    pub fn len(&self) -> usize {
        self.keys.len()
    }
    /// The last search found nothing.
    pub fn is_empty(&self) -> bool {
        self.keys.is_empty()
    }
    /// The farthest photon of the last search; the highest index among equals.
    pub fn farthest(&self) -> Option<Neighbour> {
        self.keys.iter().copied().max().map(from_key)
    }

    /// A bounded max-heap collector for the `k` nearest within `bound`.
    pub(super) fn heap(&mut self, k: usize, bound: u64) -> BoundedHeap<'_> {
        self.keys.clear();
        BoundedHeap { keys: &mut self.keys, k, bound: if k == 0 { 0 } else { bound } }
    }
    /// A buffering collector for the `k` nearest within `bound`; call [`Buffered::finish`] at the end.
    pub(super) fn buffered(&mut self, k: usize, bound: u64) -> Buffered<'_> {
        self.keys.clear();
        self.scratch.clear();
        let bound = if k == 0 { 0 } else { bound };
        Buffered { keys: &mut self.keys, scratch: &mut self.scratch, k, full: k, bound }
    }
}

/// The k nearest by a max-heap with the farthest on top (Jensen 2001, §4.2).
pub(super) struct BoundedHeap<'a> {
    keys: &'a mut Vec<u64>,
    k: usize,
    bound: u64,
}

impl Collector for BoundedHeap<'_> {
    #[inline(always)]
    fn bound(&self) -> u64 {
        self.bound
    }
    #[inline]
    fn take(&mut self, key: u64) {
        if self.keys.len() < self.k {
            self.keys.push(key);
            if self.keys.len() == self.k {
                for i in (0..self.k / 2).rev() {
                    sift_down(self.keys, i);
                }
                self.bound = self.keys[0];
            }
        } else {
            self.keys[0] = key;
            sift_down(self.keys, 0);
            self.bound = self.keys[0];
        }
    }
}

/// Restores the heap order below `i`, where only `keys[i]` may be too small.
#[inline]
fn sift_down(keys: &mut [u64], mut i: usize) {
    loop {
        let mut child = 2 * i + 1;
        if child >= keys.len() {
            return;
        }
        if child + 1 < keys.len() && keys[child + 1] > keys[child] {
            child += 1;
        }
        if keys[child] <= keys[i] {
            return;
        }
        keys.swap(i, child);
        i = child;
    }
}

/// The k nearest by buffering up to 3k/2 candidates and cutting back to k by quickselect: O(1) a candidate where the heap
/// needs O(log k). Cutting keeps the order of arrival.
pub(super) struct Buffered<'a> {
    keys: &'a mut Vec<u64>,
    scratch: &'a mut Vec<u64>,
    k: usize,
    /// Length at which to cut: k at first (which only sets the bound), then 3k/2.
    full: usize,
    bound: u64,
}

impl Collector for Buffered<'_> {
    #[inline(always)]
    fn bound(&self) -> u64 {
        self.bound
    }
    #[inline(always)]
    fn take(&mut self, key: u64) {
        self.keys.push(key);
        if self.keys.len() >= self.full {
            self.cut();
        }
    }
}

impl Buffered<'_> {
    #[cold]
    fn cut(&mut self) {
        if self.keys.len() > self.k {
            self.scratch.clear();
            self.scratch.extend_from_slice(self.keys);
            // The (k + 1)-th smallest: keys are unique, so exactly k lie below it.
            let (_, &mut limit, _) = self.scratch.select_nth_unstable(self.k);
            self.keys.retain(|&key| key < limit);
        }
        if self.keys.len() == self.k {
            // Later candidates must beat the k-th.
            self.bound = self.keys.iter().copied().max().unwrap_or(self.bound);
        }
        self.full = self.k + self.k / 2;
    }
    /// Leaves exactly the k nearest (or all, when fewer) in the buffer.
    pub(super) fn finish(mut self) {
        if self.keys.len() > self.k {
            self.cut();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{Purpose, Stream};

    #[test]
    fn heap_and_buffer_keep_the_k_smallest_of_any_sequence() {
        let mut s = Stream::new(7, Purpose::Test, 0, 0);
        let mut buffer = NeighbourBuffer::new();
        for round in 0..2000 {
            let n = (s.next_u64() % 300) as u32;
            let k = (s.next_u64() % 40) as usize;
            let levels = 1 + s.next_u64() % 50;
            let keys: Vec<u64> = (0..n).map(|i| key((s.next_u64() % levels) as f32, i)).collect();
            let radius_squared = (s.next_u64() % 60) as f32;
            let bound = bound_of(radius_squared);
            let mut expect: Vec<u64> = keys.iter().copied().filter(|&k| k < bound).collect();
            expect.sort_unstable();
            expect.truncate(k);
            let offer = |c: &mut dyn Collector| {
                keys.iter().for_each(|&k| {
                    if k < c.bound() {
                        c.take(k)
                    }
                })
            };
            if round % 2 == 0 {
                offer(&mut buffer.heap(k, bound));
            } else {
                let mut c = buffer.buffered(k, bound);
                offer(&mut c);
                c.finish();
                let order: Vec<u32> = buffer.iter().map(|n| n.index).collect();
                assert!(order.is_sorted(), "order of arrival is kept");
            }
            assert_eq!(buffer.farthest(), expect.last().map(|&k| from_key(k)));
            let mut found = buffer.keys.clone();
            found.sort_unstable();
            assert_eq!(found, expect, "round {round}");
        }
    }
}

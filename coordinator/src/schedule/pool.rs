//! Sets of work indices as disjoint intervals.

use gatherlight_render::photon::EmissionRange;
use std::collections::BTreeMap;

/// Disjoint half-open intervals, adjacent ones joined.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct IntervalPool {
    /// first → end; none empty, none touching.
    intervals: BTreeMap<u64, u64>,
    units: u64,
}

impl IntervalPool {
    /// All of [0, `units`).
    pub fn full(units: u64) -> Self {
        let mut pool = IntervalPool::default();
        pool.insert(EmissionRange { first: 0, end: units });
        pool
    }
    /// Number of indices in it.
    pub fn units(&self) -> u64 {
        self.units
    }
    /// No index.
    pub fn is_empty(&self) -> bool {
        self.units == 0
    }
    /// Whether some index of `range` is in it.
    pub fn overlaps(&self, range: EmissionRange) -> bool {
        !range.is_empty() && self.intervals.range(..range.end).next_back().is_some_and(|(_, &end)| end > range.first)
    }
    /// Adds `range`. Returns whether all its indices were new; the pool is unchanged otherwise.
    pub fn insert(&mut self, range: EmissionRange) -> bool {
        if self.overlaps(range) {
            return false;
        }
        if range.is_empty() {
            return true;
        }
        let (mut first, mut end) = (range.first, range.end);
        if let Some((&f, &e)) = self.intervals.range(..first).next_back()
            && e == first
        {
            self.intervals.remove(&f);
            first = f;
        }
        if let Some(e) = self.intervals.remove(&end) {
            end = e;
        }
        self.intervals.insert(first, end);
        self.units += range.len();
        true
    }
    /// The indices of [0, `units`) that are not in it.
    pub fn complement(&self, units: u64) -> IntervalPool {
        let mut rest = IntervalPool::default();
        let mut from = 0;
        for (&first, &end) in &self.intervals {
            rest.insert(EmissionRange { first: from, end: first.min(units).max(from) });
            from = from.max(end);
        }
        rest.insert(EmissionRange { first: from, end: units.max(from) });
        rest
    }
    /// Takes up to `units` indices, from the lowest on.
    pub fn take(&mut self, units: u64) -> Option<EmissionRange> {
        self.take_from(0, units)
    }
    /// Takes up to `units` indices of one interval, from its first index at or above `from`, or the pool's lowest.
    pub fn take_from(&mut self, from: u64, units: u64) -> Option<EmissionRange> {
        if units == 0 {
            return None;
        }
        let inside = self.intervals.range(..=from).next_back().filter(|&(_, &end)| end > from).map(|(&f, &e)| (f, e));
        let after = || self.intervals.range(from..).next().map(|(&f, &e)| (f, e));
        let (first, end) = inside.or_else(after).or_else(|| self.intervals.first_key_value().map(|(&f, &e)| (f, e)))?;
        let start = if (first..end).contains(&from) { from } else { first };
        let stop = end.min(start.saturating_add(units));
        self.intervals.remove(&first);
        if first < start {
            self.intervals.insert(first, start);
        }
        if stop < end {
            self.intervals.insert(stop, end);
        }
        self.units -= stop - start;
        Some(EmissionRange { first: start, end: stop })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn range(first: u64, end: u64) -> EmissionRange {
        EmissionRange { first, end }
    }

    #[test]
    fn a_pool_and_its_complement_are_the_whole() {
        let mut pool = IntervalPool::default();
        let pieces = [(3, 5), (8, 10), (19, 20)].map(|(first, end)| range(first, end));
        pieces.iter().for_each(|&r| assert!(pool.insert(r)));
        let mut rest = pool.complement(20);
        assert_eq!((rest.units(), rest.overlaps(range(3, 5)), rest.overlaps(range(5, 6))), (15, false, true));
        pieces.iter().for_each(|&r| assert!(rest.insert(r)));
        assert_eq!(rest, IntervalPool::full(20));
        assert_eq!(IntervalPool::default().complement(7), IntervalPool::full(7));
        assert_eq!(IntervalPool::full(7).complement(7), IntervalPool::default());
    }

    #[test]
    fn taking_all_pieces_and_putting_them_back_gives_the_whole() {
        let mut pool = IntervalPool::full(1_000);
        let pieces: Vec<_> = std::iter::from_fn(|| pool.take(7)).collect();
        assert!(pool.is_empty());
        assert_eq!(pieces.iter().map(EmissionRange::len).sum::<u64>(), 1_000);
        let (even, odd): (Vec<_>, Vec<_>) = pieces.iter().partition(|p| p.first / 7 % 2 == 0);
        even.iter().chain(odd.iter().rev()).for_each(|&p| assert!(pool.insert(p)));
        assert_eq!(pool, IntervalPool::full(1_000));
    }

    #[test]
    fn overlapping_inserts_are_refused_and_change_nothing() {
        let mut pool = IntervalPool::default();
        assert!(pool.insert(range(10, 20)));
        for r in [range(10, 20), range(0, 11), range(19, 30), range(12, 13), range(0, 99)] {
            assert!(!pool.insert(r), "{r:?}");
        }
        assert_eq!(pool.units(), 10);
        assert!(pool.insert(range(20, 30)) && pool.insert(range(0, 10)) && pool.insert(range(5, 5)));
        assert_eq!(pool, IntervalPool::full(30));
    }

    #[test]
    fn taking_from_the_middle_splits() {
        let mut pool = IntervalPool::full(100);
        assert_eq!(pool.take_from(40, 10), Some(range(40, 50)));
        assert_eq!(pool.take_from(45, 10), Some(range(50, 60)));
        assert_eq!(pool.take_from(99, 10), Some(range(99, 100)));
        assert_eq!(pool.take_from(200, 10), Some(range(0, 10)));
        assert_eq!(pool.units(), 69);
    }

    #[test]
    fn an_empty_pool_gives_nothing() {
        assert_eq!(IntervalPool::full(0).take(5), None);
        assert_eq!(IntervalPool::full(5).take(0), None);
    }
}

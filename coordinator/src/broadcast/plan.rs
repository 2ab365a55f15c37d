//! Who passes what to whom: two trees over the same workers, one for each stripe of the payload.
//!
//! Both are binary trees in the order of a heap; the second one numbers the workers backwards. So whoever has children in one
//! has none in the other, and passes on at most two halves: as much as it receives (Sanders, Speck and Träff 2009). The
//! coordinator sends one half to each root: one copy, whatever the number of workers. All links are busy in both directions,
//! and a payload of M bytes takes βM and the time a piece needs down ⌈log₂ p⌉ levels, β being seconds a byte.
//!
//! A worker whose source is lost goes on with the source's own source, and so on up to the coordinator. Sources are always
//! nearer to the coordinator in the same tree, so nobody ever waits for itself.

use gatherlight_proto::limits::MAX_SOURCES;
use gatherlight_proto::pieces::STRIPES;

/// The worker that passes `stripe` to worker `place` of `count`; `None`: the coordinator does.
pub fn parent(stripe: usize, place: usize, count: usize) -> Option<usize> {
    let numbered = |n: usize| if stripe.is_multiple_of(STRIPES) { n } else { count - 1 - n };
    let rank = numbered(place);
    rank.checked_sub(1).map(|r| numbered(r / 2))
}

/// The workers that worker `place` of `count` asks for `stripe`, in this order, before the coordinator: those above it, at
/// most [`MAX_SOURCES`].
pub fn sources(stripe: usize, place: usize, count: usize) -> impl Iterator<Item = usize> {
    let above = move |&p: &usize| parent(stripe, p, count);
    std::iter::successors(parent(stripe, place, count), above).take(MAX_SOURCES)
}

/// The worker that latecomer `number` (from 0) asks for everything, of `count` ≥ 1 that were there: each in turn.
pub fn host(number: usize, count: usize) -> usize {
    number % count
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    const COUNTS: [usize; 9] = [1, 2, 3, 4, 7, 8, 64, 513, 1_000];

    #[test]
    fn everybody_is_reached_within_log2_p_hops() {
        for count in COUNTS {
            let most = (count + 1).next_power_of_two().ilog2();
            for (stripe, place) in (0..STRIPES).flat_map(|s| (0..count).map(move |p| (s, p))) {
                let mut hops = 1;
                let mut at = place;
                while let Some(above) = parent(stripe, at, count) {
                    (at, hops) = (above, hops + 1);
                }
                assert!(hops <= most, "{hops} hops to {place} of {count}");
            }
        }
    }

    #[test]
    fn the_coordinator_sends_one_copy_and_nobody_sends_more_than_it_gets() {
        for count in COUNTS {
            let mut halves = vec![0; count];
            let mut of_coordinator = 0;
            for (stripe, place) in (0..STRIPES).flat_map(|s| (0..count).map(move |p| (s, p))) {
                match parent(stripe, place, count) {
                    Some(p) => halves[p] += 1,
                    None => of_coordinator += 1,
                }
            }
            assert_eq!(of_coordinator, STRIPES, "{count} workers");
            assert!(halves.iter().all(|&h| h <= STRIPES), "{count} workers: {halves:?}");
        }
    }

    #[test]
    fn whoever_is_lost_is_routed_around_and_costs_the_coordinator_little() {
        for count in COUNTS {
            for lost in (0..count).step_by(1 + count / 50) {
                let lost: BTreeSet<usize> = [lost, (lost * 7 + 3) % count].into();
                let mut asked = 0;
                for (stripe, place) in (0..STRIPES).flat_map(|s| (0..count).map(move |p| (s, p))) {
                    let source = sources(stripe, place, count).find(|p| !lost.contains(p));
                    asked += usize::from(source.is_none() && !lost.contains(&place));
                    assert_ne!(source, Some(place));
                }
                // Each loss next to the coordinator leaves it at most two halves more, in one of the trees.
                assert!(
                    asked <= STRIPES + 2 * lost.len(),
                    "{asked} halves asked of the coordinator, {lost:?} of {count}"
                );
            }
        }
    }

    #[test]
    fn latecomers_are_spread_over_those_who_were_there() {
        let mut guests = [0; 7];
        (0..70).for_each(|n| guests[host(n, 7)] += 1);
        assert_eq!(guests, [10; 7]);
    }
}

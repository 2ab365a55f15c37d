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

/// Halves of the payload that each of `count` workers passes on.
pub fn halves(count: usize) -> Vec<u32> {
    let mut halves = vec![0; count];
    for parent in (0..STRIPES).flat_map(|s| (0..count).filter_map(move |p| parent(s, p, count))) {
        halves[parent] += 1;
    }
    halves
}

/// The worker that a latecomer asks for one half: of those that are `there` the one that passes on least, which now passes on more.
pub fn host(halves: &mut [u32], there: impl Fn(usize) -> bool) -> Option<usize> {
    let host = (0..halves.len()).filter(|&p| there(p)).min_by_key(|&p| halves[p])?;
    halves[host] += 1;
    Some(host)
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
            let halves = halves(count);
            let of_coordinator = STRIPES * count - halves.iter().sum::<u32>() as usize;
            assert_eq!(of_coordinator, STRIPES, "{count} workers");
            assert!(halves.iter().all(|&h| h as usize <= STRIPES), "{count} workers: {halves:?}");
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
        let mut halves = halves(8);
        halves.sort_unstable();
        assert_eq!(halves, [1, 1, 2, 2, 2, 2, 2, 2], "one copy is the coordinator's");
        // Who passes on little gets guests first; who is gone gets none.
        let mut hosts: Vec<_> = (0..8).map(|_| host(&mut halves, |p| p != 7).expect("somebody is there")).collect();
        hosts.sort_unstable();
        assert_eq!((hosts, &halves[..]), (vec![0, 0, 1, 1, 2, 3, 4, 5], &[3, 3, 3, 3, 3, 3, 2, 2][..]));
        assert_eq!(host(&mut halves, |_| false), None);
    }
}

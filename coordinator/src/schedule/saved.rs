//! What is known of a job that an earlier coordinator began: it goes on from there.

use super::pool::IntervalPool;
use super::work::{Kind, Total, Work};
use gatherlight_proto::message::InputRef;
use gatherlight_render::job::Phase;
use gatherlight_render::photon::EmissionRange;
use std::collections::BTreeMap;

/// What is done of a job. Nothing, for a new one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Saved {
    /// Rounds closed.
    pub rounds: u32,
    /// Counts over the phases of those rounds.
    pub totals: BTreeMap<Kind, Total>,
    /// What was made of phases, with the photons in it: of later rounds, and of earlier ones where later rounds read them. By
    /// index of the phase.
    pub inputs: BTreeMap<usize, (InputRef, u64)>,
    /// Indices done of phases of later rounds of which nothing was made yet.
    done: BTreeMap<usize, (IntervalPool, u64)>,
}

impl Saved {
    /// So many rounds are closed, and nothing else is there.
    pub fn after(rounds: u32) -> Self {
        Saved { rounds, ..Saved::default() }
    }
    /// Notes a result with `stored` photons of phase `index`, one of `phases`. Returns whether it counts: it does not where the
    /// phase needs it no more, or has it already.
    pub fn add_result(&mut self, phases: &[Phase], index: usize, range: EmissionRange, stored: u64) -> bool {
        let wanted = phases.get(index).is_some_and(|p| p.round() >= self.rounds && range.end <= p.units());
        if !wanted || range.is_empty() || self.inputs.contains_key(&index) {
            return false;
        }
        let (done, photons) = self.done.entry(index).or_default();
        let new = done.insert(range);
        *photons += if new { stored } else { 0 };
        new
    }
    /// The input made of phase `index`, and its work as it stood.
    pub(super) fn take(&mut self, index: usize, phase: Phase) -> (Work, Option<InputRef>) {
        let mut work = Work::new(phase);
        if let Some((input, stored)) = self.inputs.remove(&index) {
            (work.done, work.fresh, work.stored) = (work.fresh, IntervalPool::default(), stored);
            return (work, Some(input));
        }
        if let Some((done, stored)) = self.done.remove(&index) {
            work.fresh = done.complement(phase.units());
            (work.done, work.stored) = (done, stored);
        }
        (work, None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_result_counts_once_and_only_where_it_is_needed() {
        let phases: Vec<Phase> = (0..3).map(|round| Phase::Gather { round, tiles: 10 }).collect();
        let mut saved = Saved::after(1);
        let mut add = |index, first, end| saved.add_result(&phases, index, EmissionRange { first, end }, 3);
        assert!(!add(0, 0, 5), "of a closed round");
        assert!(add(1, 2, 5));
        assert!(!add(1, 4, 6), "index 4 is there already");
        assert!(add(1, 5, 6));
        assert!(!add(1, 6, 6) && !add(1, 6, 11) && !add(3, 0, 1), "no such indices");
        let (work, input) = saved.take(1, phases[1]);
        assert_eq!((work.done.units(), work.fresh.units(), work.stored, input), (4, 6, 6, None));
        assert!(!work.fresh.overlaps(EmissionRange { first: 2, end: 6 }));
    }
}

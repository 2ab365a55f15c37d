//! What an image is made of in portions, and between which of them its error is told.

use super::{Method, RenderSettings};
use std::ops::Range;

/// Consecutive camera samples, chains or rounds that are done, and end, together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pass {
    /// Its first part, from 0.
    pub first: u32,
    /// Number of its parts, ≥ 1.
    pub len: u32,
}

impl RenderSettings {
    /// Number of camera samples, chains or rounds: what the passes divide.
    pub fn parts(&self) -> u32 {
        match self.method {
            Method::Mlt => self.chains,
            m if m.has_rounds() => self.rounds,
            _ => self.samples,
        }
    }
    /// The passes of a job, in order: 1, 1, 2, 4, … parts, up to an eighth of all, or of those before where a limit is to end the job.
    pub fn passes(&self) -> impl Iterator<Item = Pass> + '_ {
        let next = |first: u32| {
            let len = first.clamp(1, self.largest_pass(first)).min(self.parts().saturating_sub(first));
            (len > 0).then_some(Pass { first, len })
        };
        std::iter::successors(next(0), move |p| next(p.first + p.len))
    }

    /// The blocks of an image, by whose differences its error is told: the rounds of each, in order; `parts` are those of each round.
    ///
    /// They are stretches of the same low-discrepancy sequences, well stratified in themselves; that all of them together are better
    /// stratified still is not seen, so where that helps the noise is overstated, never understated. So they are large, up to twice the
    /// largest [`Pass`]: an image has pixels enough to know its noise by four of them.
    pub fn blocks<'a>(&'a self, parts: &'a [u32]) -> impl Iterator<Item = Range<usize>> + 'a {
        let (mut round, mut first) = (0, 0);
        std::iter::from_fn(move || {
            let (start, wanted) = (round, first.clamp(1, 2 * self.largest_pass(first)));
            let mut len = 0;
            while len < wanted && round < parts.len() {
                (len, round) = (len + parts[round], round + 1);
            }
            first += len;
            (round > start).then_some(start..round)
        })
    }

    /// Rounds whose samples decide where those of the others go, where that is wanted: a quarter of all samples, but not so
    /// few that they say nothing, nor so many that it comes late.
    pub fn pilot_rounds(&self) -> Option<u32> {
        const SAMPLES: [u32; 2] = [8, 64];
        let wanted = (self.samples / 4).clamp(SAMPLES[0], SAMPLES[1]);
        let before = self.passes().take_while(|p| p.first < wanted).count() as u32;
        self.adaptive.then_some(before)
    }

    /// Numbers of the camera samples of each pixel, chains or independent rounds that `round` of the image takes: of adaptive
    /// sampling, those of an even distribution.
    pub fn parts_of_round(&self, round: u32) -> Range<u32> {
        if self.merges_rounds() {
            return round..round + 1;
        }
        let parts = self.parts();
        self.passes().nth(round as usize).map_or(parts..parts, |p| p.first..p.first + p.len)
    }

    /// Numbers of the camera samples of each pixel that a gather of `round` takes; an independent round is one of the method's own.
    pub fn samples_of_round(&self, round: u32) -> Range<u32> {
        if self.method.has_rounds() { round..round + 1 } else { self.parts_of_round(round) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_whole_passes_and_up_to_a_quarter() {
        let path = |samples| RenderSettings { samples, ..RenderSettings::for_method(Method::Path) };
        let lengths = |s: &RenderSettings| -> Vec<u32> {
            let parts: Vec<u32> = s.passes().map(|p| p.len).collect();
            s.blocks(&parts).map(|b| parts[b].iter().sum()).collect()
        };
        assert_eq!(lengths(&path(64)), [1, 1, 2, 4, 8, 16, 16, 16]);
        assert_eq!(lengths(&path(1)), [1]);
        // Passes of 13 do not end where twice as many do.
        assert_eq!(lengths(&path(100)), [1, 1, 2, 4, 8, 26, 26, 26, 6]);
        for method in Method::ALL {
            let s = RenderSettings::for_method(method).open_ended();
            let blocks = lengths(&s);
            assert_eq!(blocks.iter().sum::<u32>(), s.parts(), "{method:?}");
            let mut first = 0;
            for (i, len) in blocks.iter().enumerate() {
                // Of those before it at most a quarter, but that chains come in no fewer than eight.
                assert!(*len <= (first / 4).max(16), "{method:?}: block {i} has {len} after {first}");
                first += len;
            }
        }
    }
}

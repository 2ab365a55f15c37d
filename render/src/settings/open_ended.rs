//! Jobs without an end of their own, which a limit of time or error ends.

use super::{MAX_CHAINS, MAX_MUTATIONS, MAX_PHOTONS, MAX_ROUNDS, MAX_SAMPLES, Method, RenderSettings};

/// Number of parts from which on a job is expected to be ended by a limit rather than by them.
pub const ENDLESS: u32 = 1 << 15;

impl RenderSettings {
    /// The same with so many samples, rounds or chains that a limit ends the job. What one of them computes stays the same: a
    /// round has as many photons, a chain as many mutations.
    pub fn open_ended(mut self) -> Self {
        match self.method {
            Method::Mlt => {
                let more = (MAX_CHAINS / self.chains.max(1)).min(MAX_MUTATIONS / self.mutations.max(1)).max(1);
                (self.chains, self.mutations) = (self.chains * more, self.mutations * more);
            }
            m if m.has_rounds() => {
                let of_round = [self.photons, self.caustic_photons].map(|total| self.share_of_round(total, 0));
                let most = MAX_PHOTONS / of_round[0].max(of_round[1]).max(1);
                let rounds = most.clamp(self.rounds.into(), MAX_ROUNDS.into());
                [self.photons, self.caustic_photons] = of_round.map(|paths| paths * rounds);
                self.rounds = rounds as u32;
            }
            _ => self.samples = MAX_SAMPLES,
        }
        self
    }

    /// Whether a limit is expected to end the job, so that what its parts are of all of them says nothing.
    pub fn is_open_ended(&self) -> bool {
        self.parts() >= ENDLESS
    }

    /// The most parts of a pass after `first` others. An eighth of all, so that there are enough to tell the noise by; where a limit
    /// is to end the job, an eighth of those before it, which is the most that it can be late by.
    pub(super) fn largest_pass(&self, first: u32) -> u32 {
        if !self.is_open_ended() {
            return self.parts().div_ceil(8);
        }
        // A single chain or independent round keeps a single worker busy, a sample of each pixel all of them.
        let by_units = self.method == Method::Mlt || self.has_independent_rounds();
        let least = if by_units { 8 } else { 1 };
        // Alike over stretches, so that they can be compared.
        (first / 8).checked_ilog2().map_or(1, |log| 1 << log).max(least)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Merge;

    fn endless(method: Method) -> RenderSettings {
        RenderSettings::for_method(method).open_ended()
    }

    #[test]
    fn it_is_valid_and_each_part_stays_as_it_is() {
        for method in Method::ALL {
            // A light image that large cannot travel.
            let largest = if method.splats() || method == Method::Mlt { 6_144 } else { 16_384 };
            for size in [1, 256, largest] {
                let sized = RenderSettings { width: size, height: size, ..RenderSettings::for_method(method) };
                let [photons, caustic_photons] = sized.default_photons();
                let usual = RenderSettings { photons, caustic_photons, ..sized };
                let s = usual.clone().open_ended();
                assert_eq!(s.validate(), Ok(()), "{method:?} {size}");
                assert!(s.is_open_ended() || size > 4_096, "{method:?}");
                assert!(!usual.is_open_ended());
                let of_round = |s: &RenderSettings| {
                    [s.photons, s.caustic_photons].map(|n| if method.has_rounds() { s.share_of_round(n, 7) } else { n })
                };
                assert_eq!(of_round(&s), of_round(&usual), "{method:?}");
                let of_chain = |s: &RenderSettings| f64::from(s.mutations) / f64::from(s.chains);
                assert_eq!(of_chain(&s), of_chain(&usual), "{method:?}");
            }
        }
    }

    #[test]
    fn a_pass_is_at_most_an_eighth_of_what_is_done() {
        let independent = RenderSettings { merge: Merge::Independent, ..endless(Method::Vcm) };
        for s in [endless(Method::Path), endless(Method::Mlt), independent] {
            let (mut next, mut count) = (0, 0);
            for b in s.passes() {
                assert_eq!(b.first, next);
                assert!(b.len <= (b.first / 8).max(8) && (s.method != Method::Path || b.len <= (b.first / 8).max(1)));
                (next, count) = (next + b.len, count + 1);
            }
            assert_eq!(next, s.parts());
            assert!(count < 200, "{count}");
        }
    }

    #[test]
    fn the_usual_passes_stay_as_they_are() {
        let s = RenderSettings { samples: 64, ..RenderSettings::for_method(Method::Path) };
        let lengths: Vec<u32> = s.passes().map(|b| b.len).collect();
        assert_eq!(lengths, [1, 1, 2, 4, 8, 8, 8, 8, 8, 8, 8]);
    }
}

//! How often something may happen.

use std::time::Duration;

/// A bucket that holds one second's worth: so many at once, and so many a second in the long run. Time is an argument.
#[derive(Clone, Debug)]
pub struct Rate {
    per_second: u32,
    /// What may happen now.
    left: f64,
    last: Duration,
}

impl Rate {
    /// Full, for so many a second.
    pub fn new(per_second: u32) -> Self {
        Rate { per_second, left: per_second.into(), last: Duration::ZERO }
    }
    /// Whether it may happen once more, at time `now` from any origin.
    pub fn admit(&mut self, now: Duration) -> bool {
        let passed = now.saturating_sub(self.last).as_secs_f64();
        let full = f64::from(self.per_second);
        (self.left, self.last) = ((self.left + passed * full).min(full), now.max(self.last));
        let admitted = self.left >= 1.0;
        self.left -= f64::from(u8::from(admitted));
        admitted
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_burst_of_one_second_passes_and_then_the_rate_holds() {
        let mut rate = Rate::new(10);
        let at = Duration::from_millis;
        assert_eq!((0..30).filter(|_| rate.admit(at(5))).count(), 10);
        assert_eq!((0..30).filter(|_| rate.admit(at(305))).count(), 3);
        // Ten seconds of silence save up one second's worth, and a clock that stands still gives nothing.
        assert_eq!((0..30).filter(|_| rate.admit(at(10_305))).count(), 10);
        assert!(!rate.admit(at(10_000)));
        // What is below the rate always passes.
        assert!((1..1_000).all(|i| rate.admit(at(20_000 + 101 * i))));
    }
}

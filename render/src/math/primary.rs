//! Primary sample space: the numbers of a path as the state of a Markov chain (Kelemen et al. 2002).
//!
//! Numbers are made when they are first asked for, and moved when they are next asked for: a number that was not asked for
//! during several steps makes up for them at once.

use super::numbers::Numbers;
use super::ops::{PI, cos, ln64};
use super::rng;

/// Standard deviation of a small step.
const SMALL_STEP: f32 = 0.01;
/// Lanes of numbers within a path, so that a longer sub-path shifts no other number.
const LANES: usize = 4;

/// What numbers are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub enum Lane {
    /// The choice of length and strategy.
    Connection = 0,
    /// The camera sub-path.
    Camera = 1,
    /// The light sub-path.
    Light = 2,
    /// Next-event estimation.
    NextEvent = 3,
}

/// A kind of mutation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Every number anew.
    Large,
    /// Every number a little.
    Small,
}

/// One number: its value and the step at which it was last moved, now and as they were before the present proposal.
#[derive(Clone, Copy, Debug, Default)]
struct Value {
    value: f32,
    modified: u64,
    backup: f32,
    backup_modified: u64,
}

/// The state of a chain: all numbers of its path.
#[derive(Clone, Debug)]
pub struct PrimarySpace {
    random: rng::Stream,
    /// By lane, in the order of use.
    values: [Vec<Value>; LANES],
    /// Number of the present step, from 1; 0 is "never".
    step: u64,
    /// The last accepted large step, or the present proposal if it is one.
    large: u64,
    last_large: u64,
    open: Lane,
    next: usize,
}

impl PrimarySpace {
    /// An independent point: all numbers from `random`, but the first of [`Lane::Connection`], which is `first` in [0, 1].
    pub fn new(random: rng::Stream, first: f32) -> Self {
        let first = Value { value: below_one(first), modified: 1, ..Value::default() };
        let mut values: [Vec<Value>; LANES] = Default::default();
        values[Lane::Connection as usize].push(first);
        PrimarySpace { random, values, step: 1, large: 1, last_large: 1, open: Lane::Connection, next: 0 }
    }
    /// Takes random numbers from another stream from now on.
    pub fn continue_with(&mut self, random: rng::Stream) {
        self.random = random;
    }
    /// The random numbers that move the chain.
    pub fn random(&mut self) -> &mut rng::Stream {
        &mut self.random
    }
    /// Begins a mutation: a large step with probability `large_step`.
    pub fn propose(&mut self, large_step: f32) -> Step {
        self.step += 1;
        if self.random.next_f32() < large_step {
            self.large = self.step;
            Step::Large
        } else {
            Step::Small
        }
    }
    /// The next numbers are those of `lane`, from its first on.
    pub fn open(&mut self, lane: Lane) {
        (self.open, self.next) = (lane, 0);
    }
    /// The proposal becomes the state.
    pub fn accept(&mut self) {
        self.last_large = self.large;
    }
    /// The state stays as it was before the proposal.
    pub fn reject(&mut self) {
        for v in self.values.iter_mut().flatten().filter(|v| v.modified == self.step) {
            (v.value, v.modified) = (v.backup, v.backup_modified);
        }
        self.step -= 1;
        self.large = self.last_large;
    }

    fn next(&mut self) -> f32 {
        let values = &mut self.values[self.open as usize];
        if self.next == values.len() {
            values.push(Value::default());
        }
        let v = &mut values[self.next];
        self.next += 1;
        if v.modified < self.step {
            (v.backup, v.backup_modified) = (v.value, v.modified);
            if v.modified < self.large {
                // The last large step came after its last move.
                (v.value, v.modified) = (self.random.next_f32(), self.large);
            }
            let steps = self.step - v.modified;
            if steps > 0 {
                v.value = moved(v.value, SMALL_STEP * (steps as f32).sqrt(), self.random.next_2d());
                v.modified = self.step;
            }
        }
        v.value
    }
}

impl Numbers for PrimarySpace {
    fn next_1d(&mut self) -> f32 {
        self.next()
    }
    fn next_2d(&mut self) -> [f32; 2] {
        [self.next(), self.next()]
    }
}

/// `value` plus a normal deviate of standard deviation `sigma`, on the circle [0, 1): symmetric, so that it cancels in
/// the acceptance (Box and Muller 1958 for the deviate).
fn moved(value: f32, sigma: f32, u: [f32; 2]) -> f32 {
    let radius = (-2.0 * ln64(1.0 - f64::from(u[0]))).sqrt() as f32;
    let v = value + sigma * radius * cos(2.0 * PI * u[1]);
    below_one(v - v.floor())
}

fn below_one(v: f32) -> f32 {
    v.clamp(0.0, 1.0f32.next_down())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Purpose;

    fn space(index: u64) -> PrimarySpace {
        PrimarySpace::new(rng::Stream::new(3, Purpose::Test, 0, index), 0.25)
    }

    fn read(space: &mut PrimarySpace, n: usize) -> Vec<f32> {
        [Lane::Connection, Lane::Camera]
            .into_iter()
            .flat_map(|stream| {
                space.open(stream);
                (0..n).map(|_| space.next_1d()).collect::<Vec<_>>()
            })
            .collect()
    }

    #[test]
    fn a_rejected_step_leaves_the_state_as_it_was() {
        let mut s = space(0);
        let start = read(&mut s, 5);
        assert_eq!(start[0], 0.25);
        s.accept();
        for large in [0.0, 1.0, 0.5, 0.0] {
            s.propose(large);
            assert_ne!(read(&mut s, 5), start);
            s.reject();
        }
        // Numbers that no proposal asked for are not lost either.
        s.propose(1.0);
        s.open(Lane::Connection);
        s.next_1d();
        s.reject();
        let mut frozen = s;
        assert_eq!(read(&mut frozen, 5), start);
    }

    #[test]
    fn small_steps_are_small_and_keep_the_numbers_uniform() {
        let mut s = space(1);
        read(&mut s, 1);
        s.accept();
        let mut cells = [0u32; 10];
        let n = 200_000;
        let mut last = 0.0f32;
        let mut moved = 0.0f64;
        for _ in 0..n {
            s.propose(0.0);
            s.open(Lane::Camera);
            let v = s.next_1d();
            let distance = (v - last).abs();
            moved += f64::from(distance.min(1.0 - distance)).powi(2);
            last = v;
            s.accept();
            cells[(v * 10.0) as usize] += 1;
        }
        assert!((moved / f64::from(n)).sqrt() < 0.02);
        // The walk crosses the circle in about (1/0.01)² = 10⁴ steps: some 20 independent visits, so cells differ widely,
        // but none stays empty.
        assert!(cells.iter().all(|&c| c > n / 100), "{cells:?}");
    }

    #[test]
    fn numbers_that_rest_make_up_for_the_steps_at_once() {
        // Variance of the move after 25 unseen steps is 25 σ².
        let mut sum = 0.0f64;
        let n = 20_000;
        for i in 0..n {
            let mut s = space(i);
            s.open(Lane::Camera);
            let before = s.next_1d();
            s.accept();
            for _ in 0..25 {
                s.propose(0.0);
                s.accept();
            }
            s.open(Lane::Camera);
            let d = f64::from((s.next_1d() - before).abs());
            sum += d.min(1.0 - d).powi(2);
        }
        let ratio = sum / n as f64 / (25.0 * f64::from(SMALL_STEP).powi(2));
        // Relative standard error of a variance from n normal values: √(2/n) = 0.01.
        assert!((ratio - 1.0).abs() < 4.5 * (2.0 / n as f64).sqrt(), "{ratio}");
    }
}

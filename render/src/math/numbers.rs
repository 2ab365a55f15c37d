//! Where a path takes its random numbers from.

use super::sobol::Sampler;

/// A source of numbers in [0, 1), one path's worth: a [`Sampler`], or the state of a Markov chain.
pub trait Numbers {
    /// One number.
    fn next_1d(&mut self) -> f32;
    /// Two numbers that belong together.
    fn next_2d(&mut self) -> [f32; 2];
    /// Three numbers, the first two of which belong together.
    #[inline]
    fn next_3d(&mut self) -> [f32; 3] {
        let [a, b] = self.next_2d();
        [a, b, self.next_1d()]
    }
}

impl Numbers for Sampler {
    #[inline]
    fn next_1d(&mut self) -> f32 {
        Sampler::next_1d(self)
    }
    #[inline]
    fn next_2d(&mut self) -> [f32; 2] {
        Sampler::next_2d(self)
    }
}

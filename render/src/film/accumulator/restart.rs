//! The closed rounds of a job outlive the process that closed them.

use super::{Accumulator, Sums};

impl Accumulator {
    /// About the bytes of its sums.
    pub fn bytes(&self) -> usize {
        let sums = self.sums.iter().map(|s| s.lengths().iter().sum::<usize>() * 8).sum::<usize>();
        sums + self.film.pixels.len() * 4 + self.weights.len() * 8
    }
    fn pixels(&self) -> usize {
        self.film.grid.width as usize * self.film.grid.height as usize
    }
    /// Whether it can go on as what `fresh`, the same job's before its first round, would have become.
    pub fn continues(&self, fresh: &Accumulator) -> bool {
        let shape = |a: &Accumulator| a.sums.as_ref().map(Sums::lengths);
        self.film.grid == fresh.film.grid
            && self.film.channels == fresh.film.channels
            && self.film.pixels.len() == fresh.film.pixels.len()
            && self.weights == fresh.weights
            && self.blocks == fresh.blocks
            && self.blur.is_some() == fresh.blur.is_some()
            && self.standard_error == fresh.standard_error
            && self.pilot == fresh.pilot
            && shape(self) == shape(fresh)
            && self.pilot == fresh.pilot
            && self.sample_map.is_some() == self.pilot.is_some_and(|rounds| self.closed >= rounds)
            && self.sample_map.as_ref().is_none_or(|m| m.is_even() || m.densities().len() == self.pixels())
            && self.closed as usize <= self.weights.len()
    }
}

impl Sums {
    fn lengths(&self) -> [usize; 4] {
        [&self.values, &self.squares, &self.block, &self.of_rounds].map(Vec::len)
    }
}

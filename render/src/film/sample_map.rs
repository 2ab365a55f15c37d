//! Where camera samples go: more of them where the first ones have shown more error (adaptive sampling).
//!
//! The first blocks of a job, its *pilot*, give every pixel equally many samples. From what they differ it is decided, once, how many of
//! the others each pixel gets. A pixel's own samples have no say in their number, or a pixel that has not met its rare bright paths
//! yet would get few, and stay too dark on average (Kirk and Arvo 1991, "Unbiased sampling techniques for image synthesis").
//! So the pixels are divided like the fields of a chess board: the number of samples of a black pixel follows from white pixels only,
//! and that of a white one from black ones. Pixels are sampled independently; given the other colour, each pixel's number of
//! samples is therefore a constant, and the mean of its samples is what it is without this.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Samples per sample of an even distribution are counted in this many parts.
const EVEN: u8 = 32;
/// Fewest and most: a pixel whose neighbours look smooth may still hide something, and a few bright neighbours may be chance.
const DENSITIES: [u8; 2] = [EVEN / 4, u8::MAX];
/// Pixels on each side of a pixel, of the other colour, that decide for it.
const REACH: usize = 3;
/// How much of the way from an even distribution to the best one for the pilot's errors is tried.
const STEPS: [f64; 4] = [0.25, 0.5, 0.75, 1.0];
/// Share of the variance that has to be saved: less is as likely chance, and even numbers of samples are better stratified.
const LEAST_GAIN: f64 = 0.1;

/// How many camera samples each pixel takes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SampleMap {
    /// Samples that every pixel takes first.
    pilot: u32,
    /// Samples of each pixel after the pilot, in 1/[`EVEN`] of the mean; empty: all even.
    densities: Vec<u8>,
}

/// What the samples of a pilot say.
#[derive(Clone, Copy, Debug)]
pub struct Pilot<'a> {
    /// Samples of each pixel.
    pub samples: u32,
    /// Samples of each pixel in all, on average.
    pub of: u64,
    /// Samples of the smallest block after it that is to have some of every pixel.
    pub least_block: u32,
    /// Pixels across.
    pub width: usize,
    /// Mean and variance of the samples of each channel of each pixel.
    pub pixels: &'a [[[f64; 2]; 3]],
}

impl SampleMap {
    /// From its parts: of each pixel, the samples after the pilot in 32nds of the mean; none where all are alike.
    pub fn new(pilot: u32, densities: Vec<u8>) -> Self {
        SampleMap { pilot, densities }
    }
    /// Samples that every pixel takes first.
    pub fn pilot(&self) -> u32 {
        self.pilot
    }
    /// See [`SampleMap::new`].
    pub fn densities(&self) -> &[u8] {
        &self.densities
    }
    /// Whether every pixel takes the same number.
    pub fn is_even(&self) -> bool {
        self.densities.is_empty()
    }
    /// Samples that `pixel` has taken when it would have taken `even` were all alike.
    #[inline]
    pub fn samples(&self, pixel: usize, even: u64) -> u64 {
        let Some(&density) = self.densities.get(pixel) else { return even };
        let pilot = u64::from(self.pilot);
        let rest = even.saturating_sub(pilot) * u64::from(density);
        even.min(pilot) + (rest + u64::from(EVEN / 2)) / u64::from(EVEN)
    }
    /// Numbers of the samples of `pixel` where those of an even distribution are `even`.
    #[inline]
    pub fn range(&self, pixel: usize, even: &Range<u32>) -> Range<u32> {
        let at = |n: u32| self.samples(pixel, u64::from(n)).min(u64::from(u32::MAX)) as u32;
        at(even.start)..at(even.end)
    }

    /// Decides, on the current rayon pool: the same bits for any number of threads.
    pub fn decide(pilot: &Pilot<'_>) -> Self {
        let errors = relative_errors(pilot);
        let neighbours = Neighbours::new(&errors, pilot.width);
        let densities = [0, 1].map(|color| neighbours.densities_of(color, pilot));
        if densities.iter().all(Option::is_none) {
            return SampleMap::new(pilot.samples, Vec::new());
        }
        let of_pixel = |i: usize| {
            let color = color(i, pilot.width);
            densities[color].as_ref().map_or(EVEN, |d| d.quantised(neighbours.of[i].iter().sum::<f64>() / 2.0))
        };
        SampleMap::new(pilot.samples, (0..errors.len()).into_par_iter().map(of_pixel).collect())
    }
}

/// White or black.
fn color(pixel: usize, width: usize) -> usize {
    (pixel % width + pixel / width) % 2
}

/// Of each pixel, the variance of its samples relative to the square of its value or, where that is greater, of the mean of its colour's
/// pixels; summed over channels. A lucky sample is at most as bad as the number of samples.
fn relative_errors(pilot: &Pilot<'_>) -> Vec<f64> {
    let of_color = |wanted: usize| {
        let row = |(y, row): (usize, &[[[f64; 2]; 3]])| {
            let own = row.iter().enumerate().filter(|(x, _)| (x + y) % 2 == wanted);
            own.fold([0.0, 0.0], |[n, sum], (_, p)| [n + 3.0, sum + p.iter().map(|c| c[0].abs()).sum::<f64>()])
        };
        let rows: Vec<[f64; 2]> = pilot.pixels.par_chunks(pilot.width).enumerate().map(row).collect();
        let [n, sum] = rows.iter().fold([0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
        if n > 0.0 { sum / n } else { 0.0 }
    };
    let means = [of_color(0), of_color(1)];
    let error = |(i, pixel): (usize, &[[f64; 2]; 3])| {
        let floor = means[color(i, pilot.width)];
        let channel = |&[mean, variance]: &[f64; 2]| {
            let scale = (mean * mean).max(floor * floor);
            if variance > 0.0 && scale > 0.0 { variance / scale } else { 0.0 }
        };
        pixel.iter().map(channel).sum()
    };
    pilot.pixels.par_iter().enumerate().map(error).collect()
}

/// Of each pixel, the mean errors of the pixels of the other colour around it: those in even columns and those in odd ones, which are
/// independent of each other.
struct Neighbours {
    width: usize,
    of: Vec<[f64; 2]>,
}

impl Neighbours {
    fn new(errors: &[f64], width: usize) -> Self {
        let height = errors.len() / width.max(1);
        let around = |i: usize| {
            let (x, y) = (i % width, i / width);
            let (mut sums, mut counts) = ([0.0; 2], [0.0; 2]);
            for ny in y.saturating_sub(REACH)..(y + REACH + 1).min(height) {
                for nx in x.saturating_sub(REACH)..(x + REACH + 1).min(width) {
                    if (nx + ny + x + y) % 2 == 1 {
                        sums[nx % 2] += errors[ny * width + nx];
                        counts[nx % 2] += 1.0;
                    }
                }
            }
            [0, 1].map(|half| if counts[half] > 0.0 { sums[half] / counts[half] } else { 0.0 })
        };
        Neighbours { width, of: (0..errors.len()).into_par_iter().map(around).collect() }
    }

    /// Σ over the pixels of a colour of `value`, summed by rows: the same bits for any number of threads.
    fn sum<const N: usize>(&self, wanted: usize, value: impl Fn(&[f64; 2]) -> [f64; N] + Sync) -> [f64; N] {
        let add = |a: [f64; N], b: [f64; N]| std::array::from_fn(|i| a[i] + b[i]);
        let row = |(y, row): (usize, &[[f64; 2]])| {
            let own = row.iter().enumerate().filter(|(x, _)| (x + y) % 2 == wanted);
            own.fold([0.0; N], |sum, (_, e)| add(sum, value(e)))
        };
        let rows: Vec<[f64; N]> = self.of.par_chunks(self.width).enumerate().map(row).collect();
        rows.into_iter().fold([0.0; N], add)
    }

    /// How the samples of one colour are best distributed, by half of the errors around and as the other half says; `None`: evenly.
    fn densities_of(&self, color: usize, pilot: &Pilot<'_>) -> Option<Densities> {
        let share = f64::from(pilot.samples) / pilot.of.max(1) as f64;
        let least = (f64::from(EVEN) / f64::from(pilot.least_block.max(1))).max(f64::from(DENSITIES[0]));
        let limits = [least, f64::from(DENSITIES[1])].map(|d| d / f64::from(EVEN));
        let best = |error: &(dyn Fn(&[f64; 2]) -> f64 + Sync)| self.best(color, share, limits, error);
        let halves = [best(&|e| e[0])?, best(&|e| e[1])?];
        let variances = self.sum(color, |&e| {
            let mut sums = [e[0] + e[1], 0.0, 0.0, 0.0, 0.0];
            for (half, densities) in halves.iter().enumerate() {
                for (sum, step) in sums[1..].iter_mut().zip(STEPS) {
                    let density = Densities { step, ..*densities }.at(e[half]);
                    *sum += e[1 - half] / (share + (1.0 - share) * density);
                }
            }
            sums
        });
        let (step, least) = STEPS.into_iter().zip(&variances[1..]).min_by(|a, b| a.1.total_cmp(b.1))?;
        // Also where it is not a number.
        let is_worth_it = *least < (1.0 - LEAST_GAIN) * variances[0];
        is_worth_it.then(|| best(&|e| (e[0] + e[1]) / 2.0)).flatten().map(|best| Densities { step, ..best })
    }

    /// The distribution with the least variance for these errors: samples in proportion to their root, with a mean of 1.
    fn best(
        &self,
        color: usize,
        pilot_share: f64,
        limits: [f64; 2],
        error: &(dyn Fn(&[f64; 2]) -> f64 + Sync),
    ) -> Option<Densities> {
        let [count, positive, sum] = self.sum(color, |e| [1.0, f64::from(u8::from(error(e) > 0.0)), error(e).sqrt()]);
        if !(sum > 0.0 && sum.is_finite()) {
            return None;
        }
        let with = |per_error| Densities { per_error, pilot_share, limits, step: 1.0 };
        if positive * limits[1] + (count - positive) * limits[0] <= count {
            // All that show any error get as many as may be, the others what is left.
            let least = (count - positive * limits[1]) / (count - positive);
            return Some(Densities { limits: [least, limits[1]], ..with(f64::MAX) });
        }
        // What is asked for in all, per root of error; the limits take some away and add some.
        let mut bounds = [0.0, limits[1] * count / sum];
        while with(bounds[1]).mean_of(self, color, count, error) < 1.0 && bounds[1] < f64::MAX / 2.0 {
            bounds[1] *= 2.0;
        }
        for _ in 0..30 {
            let middle = 0.5 * (bounds[0] + bounds[1]);
            let is_less = with(middle).mean_of(self, color, count, error) < 1.0;
            bounds[usize::from(!is_less)] = middle;
        }
        Some(with(bounds[1]))
    }
}

/// How the density of samples follows from the error.
#[derive(Clone, Copy, Debug)]
struct Densities {
    /// Samples in all, relative to the mean, per root of the error.
    per_error: f64,
    /// The pilot's share of all samples.
    pilot_share: f64,
    limits: [f64; 2],
    /// How much of the way from 1 is gone.
    step: f64,
}

impl Densities {
    /// Samples after the pilot, relative to the mean.
    fn at(&self, error: f64) -> f64 {
        let [least, most] = self.limits;
        let rest = (self.per_error * error.sqrt() - self.pilot_share) / (1.0 - self.pilot_share);
        1.0 + self.step * (rest.clamp(least, most) - 1.0)
    }
    fn quantised(&self, error: f64) -> u8 {
        (self.at(error) * f64::from(EVEN)).round() as u8
    }
    fn mean_of(
        &self,
        neighbours: &Neighbours,
        color: usize,
        count: f64,
        error: &(dyn Fn(&[f64; 2]) -> f64 + Sync),
    ) -> f64 {
        neighbours.sum(color, |e| [self.at(error(e))])[0] / count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 40;

    fn decide(pixels: &[[[f64; 2]; 3]]) -> SampleMap {
        SampleMap::decide(&Pilot { samples: 8, of: 64, least_block: 8, width: WIDTH, pixels })
    }
    /// A quarter of the pixels, in a block, with a hundred times the variance.
    fn image() -> Vec<[[f64; 2]; 3]> {
        let is_hard = |i: usize| i % WIDTH < 20 && i / WIDTH < 20;
        (0..WIDTH * 40).map(|i| [[1.0, if is_hard(i) { 1.0 } else { 0.01 }]; 3]).collect()
    }

    #[test]
    fn samples_go_where_the_error_is_and_their_mean_stays() {
        let map = decide(&image());
        let taken: Vec<u64> = (0..WIDTH * 40).map(|i| map.samples(i, 64)).collect();
        let mean = taken.iter().sum::<u64>() as f64 / taken.len() as f64;
        assert!((mean / 64.0 - 1.0).abs() < 0.02, "{mean}");
        // Ten times as many as elsewhere would be best, but for the pilot and the least there is of each pixel.
        let (hard, easy) = (taken[10 * WIDTH + 10], taken[30 * WIDTH + 30]);
        assert!(hard > 170 && (22..30).contains(&easy), "{hard} {easy}");
        // Blocks join without gaps, and each has some of every pixel.
        for i in [0, 10 * WIDTH + 10, 30 * WIDTH + 30] {
            assert_eq!(map.range(i, &(4..8)), 4..8);
            for at in (8..64).step_by(8) {
                assert_eq!(map.range(i, &(at..at + 8)).end, map.range(i, &(at + 8..at + 16)).start);
                assert!(!map.range(i, &(at..at + 8)).is_empty());
            }
        }
    }

    #[test]
    fn a_pixel_has_no_say_in_its_own_samples() {
        let before = decide(&image());
        for changed in [10 * WIDTH + 10, 30 * WIDTH + 31] {
            let mut pixels = image();
            pixels[changed] = [[300.0, 1e6]; 3];
            let after = decide(&pixels);
            let own = color(changed, WIDTH);
            for i in (0..pixels.len()).filter(|&i| color(i, WIDTH) == own) {
                assert_eq!(before.samples(i, 64), after.samples(i, 64), "pixel {i}");
            }
            assert_ne!(before, after);
        }
    }

    #[test]
    fn where_nothing_is_gained_all_pixels_are_alike() {
        let even = |pixels: &[[[f64; 2]; 3]]| decide(pixels).is_even();
        assert!(even(&vec![[[1.0, 0.5]; 3]; 1600]));
        assert!(even(&vec![[[0.0, 0.0]; 3]; 1600]));
        // Errors that are chance: those of one half say nothing of the other.
        let chance = |i: usize| (i as u32).wrapping_mul(2_654_435_769) >> 24;
        let pixels: Vec<_> = (0..1600).map(|i| [[1.0, if chance(i) < 3 { 50.0 } else { 0.1 }]; 3]).collect();
        assert!(even(&pixels));
        // No neighbours at all.
        let one = Pilot { samples: 8, of: 64, least_block: 8, width: 1, pixels: &[[[1.0, 1.0]; 3]] };
        assert!(SampleMap::decide(&one).is_even());
    }
}

//! The blur of density estimation, told by how the rounds of an image change as their radius falls.
//!
//! The expectation of a round is, to leading order, the truth plus a bias that falls with the round's radius
//! (Knaus and Zwicker 2011, §4.2). The slope of a pixel's rounds over that *width* of theirs, times the mean width, is the
//! bias of their mean. One pixel's slope drowns in noise, and its square is too large by the variance of the slope; but the slopes
//! of two halves of the rounds are all but independent, so their product has the square of the bias as its expectation, and the
//! mean of that over many pixels is well known. Where the rounds' common low-discrepancy sequences matter, the halves make up for
//! each other's errors, and the bias is understated while the noise is overstated.

use super::relative::bounded;
use serde::{Deserialize, Serialize};

/// Pixels that are followed, at most: enough for the mean, and bounded memory for any image.
const MAX_PIXELS: usize = 1 << 16;
/// Blocks of each half before which nothing is said: a slope needs two.
const LEAST_BLOCKS: u32 = 2;

/// Follows some pixels over the rounds.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Blur {
    /// Mean width of the rounds of each block, relative to the first round's.
    widths: Vec<f64>,
    /// Every how many-th pixel is followed.
    stride: usize,
    halves: [Half; 2],
}

/// Weighted sums over half of the blocks.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Half {
    blocks: u32,
    /// Σ w, Σ w x, Σ w x² of the widths x.
    weight: f64,
    first: f64,
    second: f64,
    /// Σ w y and Σ w x y of each followed value.
    values: Vec<[f64; 2]>,
}

/// How far the expectation of an image is from the truth, by the slope of its rounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bias {
    /// Root of the mean of its square over pixels and channels, in radiance; 0 where noise hides it.
    pub absolute: f64,
    /// The same relative to each pixel, as in [`Noise`](super::Noise).
    pub relative: f64,
}

impl Blur {
    /// For an image of `pixels` pixels whose blocks of rounds have these widths.
    pub fn new(pixels: usize, widths: Vec<f64>) -> Self {
        let stride = pixels.div_ceil(MAX_PIXELS).max(1);
        let half = || Half { values: vec![[0.0; 2]; pixels.div_ceil(stride) * 3], ..Half::default() };
        Blur { widths, stride, halves: [half(), half()] }
    }

    /// Adds block `number` of weight `weight`: `value` is that of a pixel and channel.
    pub(super) fn add(&mut self, number: u32, weight: f64, value: impl Fn(usize, usize) -> f64) {
        let Some(&x) = self.widths.get(number as usize) else { return };
        let (stride, half) = (self.stride, &mut self.halves[number as usize % 2]);
        half.blocks += 1;
        half.weight += weight;
        half.first += weight * x;
        half.second += weight * x * x;
        for (i, sums) in half.values.iter_mut().enumerate() {
            let y = value(i / 3 * stride, i % 3);
            sums[0] += weight * y;
            sums[1] += weight * x * y;
        }
    }

    /// The bias of the mean of all rounds so far, where a pixel of less than `floor` counts as of that much; `None` before there
    /// are enough rounds, or where their widths do not differ.
    pub(super) fn bias(&self, floor: f64) -> Option<Bias> {
        let [a, b] = &self.halves;
        let spread = |h: &Half| h.second - h.first * h.first / h.weight;
        if a.blocks.min(b.blocks) < LEAST_BLOCKS || [a, b].iter().any(|h| spread(h) <= 1e-9 * h.second) {
            return None;
        }
        let weight = a.weight + b.weight;
        let mean_width = (a.first + b.first) / weight;
        let slope = |h: &Half, [y, xy]: [f64; 2]| (xy - h.first * y / h.weight) / spread(h);
        let mut sums = [0.0f64; 2];
        for (&of_a, &of_b) in a.values.iter().zip(&b.values) {
            let square = slope(a, of_a) * slope(b, of_b) * mean_width * mean_width;
            let value = ((of_a[0] + of_b[0]) / weight).abs().max(floor);
            sums[0] += square;
            sums[1] += bounded(square, value * value);
        }
        let [absolute, relative] = sums.map(|s| (s / a.values.len().max(1) as f64).max(0.0).sqrt());
        Some(Bias { absolute, relative })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{Purpose, Stream};

    /// Rounds of truth 2 + bias 0.3 x, with noise of 1 a round, far more than the bias of a single pixel shows.
    fn followed(slope: f64, rounds: u32) -> Option<Bias> {
        let widths: Vec<f64> = (0..rounds).map(|r| (1.0 + f64::from(r)).powf(-0.3)).collect();
        let mut blur = Blur::new(90_000, widths.clone());
        let mut s = Stream::new(1, Purpose::Test, 0, 0);
        for round in 0..rounds {
            // Uniform noise of variance 1.
            let mut y = || (2.0 + slope * widths[round as usize]) as f32 + (s.next_f32() - 0.5) * 12f32.sqrt();
            let pixels: Vec<f32> = (0..4 * 90_000).map(|_| y()).collect();
            blur.add(round, 1.0, |i, c| f64::from(pixels[4 * i + c]));
        }
        blur.bias(0.1)
    }

    #[test]
    fn the_slope_of_the_rounds_tells_the_bias_through_the_noise() {
        let rounds = 24;
        let mean = (0..rounds).map(|r| (1.0 + f64::from(r)).powf(-0.3)).sum::<f64>() / f64::from(rounds);
        let bias = followed(0.3, rounds).unwrap();
        let expected = 0.3 * mean;
        assert!((bias.absolute / expected - 1.0).abs() < 0.1, "{bias:?} instead of {expected}");
        assert!((bias.relative / (expected / 2.1) - 1.0).abs() < 0.3, "{bias:?}");
        let none = followed(0.0, rounds).unwrap();
        assert!(none.absolute < 0.04, "{none:?}");
    }

    #[test]
    fn nothing_is_said_of_few_rounds_or_equal_widths() {
        assert_eq!(followed(0.3, 3), None);
        let mut blur = Blur::new(4, vec![0.5; 20]);
        (0..20).for_each(|r| blur.add(r, 1.0, |_, _| 1.0));
        assert_eq!(blur.bias(1.0), None);
        // A black image has no bias.
        let mut blur = Blur::new(1, (1..20).map(f64::from).collect());
        (0..19).for_each(|r| blur.add(r, 1.0, |_, _| 0.0));
        assert_eq!(blur.bias(0.0), Some(Bias { absolute: 0.0, relative: 0.0 }));
    }
}

//! The error of each pixel, by what its blocks differ and by what those of the pixels around it do.
//!
//! A few blocks know the variance of a pixel badly, and worst where it matters: a pixel that has had no rare bright sample shows too little
//! of both light and variance, so that its interval is narrow where it should be wide. Pixels around it see the same light with other
//! samples, so their variances are averaged, as filters of noisy images do (Rousselle et al. 2012, §4: "Adaptive rendering with non-local
//! means filtering").

use rayon::prelude::*;

/// The columns and rows around a pixel that are asked. Where one pixel in a hundred has had a rare bright sample, those next to it know
/// nothing of it; ever sparser ones farther away do, at the price of a square of nine.
const OFFSETS: [isize; 9] = [-8, -5, -3, -1, 0, 1, 3, 5, 8];
/// Pixels are alike whose difference is at most so many of its standard errors: those across an edge are not. A pixel whose light is all from
/// one sample has a standard error of its own value, however many blocks there are, so it differs by exactly one from those that have had none,
/// and they need to know of it: just above one. With more, too much is taken over from brighter pixels, and more than 95 % hold.
const ALIKE: f64 = 1.01;

/// What is known of a pixel by itself, of each channel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pixel {
    /// Its value, the mean over its samples.
    pub value: [f64; 3],
    /// Variance of that mean; infinite where nothing could be compared.
    pub variance: [f64; 3],
    /// Samples, > 0: the variance of the mean falls with their number.
    pub samples: f64,
}

/// Variance of the mean of each pixel and channel of the image in rows of `width`: the mean of the variances of a sample over all that are
/// alike around it, over the pixel's own samples; infinite where none of them is finite.
///
/// # Panics
/// When `pixels` are not whole rows.
pub(super) fn variances(pixels: &[Pixel], width: usize) -> Vec<[f64; 3]> {
    assert!(width > 0 && pixels.len().is_multiple_of(width), "whole rows");
    let height = pixels.len() / width;
    let near = |at: usize, end: usize| {
        OFFSETS.iter().filter_map(move |&o| at.checked_add_signed(o)).filter(move |&at| at < end)
    };
    let one = |i: usize| {
        let (own, [x, y]) = (&pixels[i], [i % width, i / width]);
        let (mut sum, mut count) = ([0.0; 3], 0.0);
        for row in near(y, height) {
            for other in near(x, width).map(|column| &pixels[row * width + column]) {
                if are_alike(own, other) {
                    sum = [0, 1, 2].map(|c| sum[c] + other.variance[c] * other.samples);
                    count += 1.0;
                }
            }
        }
        sum.map(|s| if count > 0.0 { s / count / own.samples } else { f64::INFINITY })
    };
    (0..pixels.len()).into_par_iter().map(one).collect()
}

/// Whether both are known and differ by no more than what chance explains, over all channels. A pixel that is finite is like itself.
fn are_alike(a: &Pixel, b: &Pixel) -> bool {
    let (mut square, mut variance) = (0.0, 0.0);
    for c in 0..3 {
        let difference = a.value[c] - b.value[c];
        square += difference * difference;
        variance += b.variance[c] + if a.variance[c].is_finite() { a.variance[c] } else { b.variance[c] };
    }
    // Of infinite variance or not a number: no.
    variance.is_finite() && square <= ALIKE * ALIKE * variance
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rng::Stream;

    fn gray(value: f64, variance: f64, samples: f64) -> Pixel {
        Pixel { value: [value; 3], variance: [variance; 3], samples }
    }

    #[test]
    fn it_is_the_mean_of_all_that_are_alike() {
        let mut pixels = vec![gray(1.0, 0.04, 2.0); 9];
        pixels[4] = gray(1.1, 0.01, 4.0);
        let found = variances(&pixels, 3);
        // The one in the middle of 3 × 3 pixels asks all, that in the corner those next to it.
        for (i, of_sample, samples) in [(4, (8.0 * 0.08 + 0.04) / 9.0, 4.0), (0, (3.0 * 0.08 + 0.04) / 4.0, 2.0)] {
            found[i].iter().for_each(|v| assert!((v - of_sample / samples).abs() < 1e-15, "{i}: {v}"));
        }
    }

    #[test]
    fn an_edge_is_not_crossed() {
        let row = |x: usize| if x < 5 { gray(1.0, 0.01, 1.0) } else { gray(2.0, 1.0, 1.0) };
        let pixels: Vec<Pixel> = (0..40).map(|i| row(i % 10)).collect();
        // They differ by 1, of which the standard error is 1.005: alike. With a tenth of that they are not.
        assert!(variances(&pixels, 10)[4][0] > 0.05);
        let sharp: Vec<Pixel> = pixels.iter().map(|p| gray(p.value[0], 0.01 * p.variance[0], 1.0)).collect();
        for (i, v) in variances(&sharp, 10).iter().enumerate() {
            assert!((v[0] - sharp[i].variance[0]).abs() < 1e-15, "{i}: {v:?}");
        }
    }

    #[test]
    fn what_is_unknown_is_known_by_others_or_not_at_all() {
        let mut pixels = vec![gray(1.0, 0.04, 1.0); 25];
        pixels[12].variance = [f64::INFINITY; 3];
        let found = variances(&pixels, 5);
        assert!(found.iter().all(|v| (v[0] - 0.04).abs() < 1e-15), "{found:?}");
        assert_eq!(variances(&[gray(1.0, f64::INFINITY, 1.0); 4], 2), [[f64::INFINITY; 3]; 4]);
        assert_eq!(variances(&[gray(0.0, 0.0, 1.0); 4], 2), [[0.0; 3]; 4]);
    }

    /// Rare bright samples, of which a pixel has 64 in eight blocks. By itself it is sure of itself far too often. Those that had several of
    /// the rarer ones are right to be unsure, too, so that more than 95 % hold.
    #[test]
    fn intervals_hold_where_tails_are_heavy() {
        for (share, at_most_alone, expected) in [(0.05, 0.83, 0.93..0.97), (0.02, 0.8, 0.95..0.995)] {
            let (alone, together) = held(share);
            assert!(alone < at_most_alone && expected.contains(&together), "{share}: {alone} {together}");
        }
    }

    /// Share of 48 × 48 pixels of mean 1 whose interval of 95 % holds it, by each alone and together, when `share` of the samples make all.
    fn held(share: f32) -> (f64, f64) {
        let (size, blocks, of_block) = (48, 8, 8);
        let mut rng = Stream::from_key(7, 0);
        let pixel = |_| {
            let bright = 1.0 / f64::from(share * of_block as f32);
            let means: Vec<f64> =
                (0..blocks).map(|_| (0..of_block).filter(|_| rng.next_f32() < share).count() as f64 * bright).collect();
            let mean = means.iter().sum::<f64>() / f64::from(blocks);
            let square = means.iter().map(|m| (m - mean) * (m - mean)).sum::<f64>();
            gray(mean, square / f64::from(blocks * (blocks - 1)), f64::from(blocks * of_block))
        };
        let pixels: Vec<Pixel> = (0..size * size).map(pixel).collect();
        let found = variances(&pixels, size as usize);
        let held = |variance: &dyn Fn(usize) -> f64| {
            let holds = |i: &usize| (pixels[*i].value[0] - 1.0).abs() <= 1.96 * variance(*i).sqrt();
            (0..pixels.len()).filter(holds).count() as f64 / pixels.len() as f64
        };
        (held(&|i| pixels[i].variance[0]), held(&|i| found[i][0]))
    }
}

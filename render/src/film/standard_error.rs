//! The error of each pixel, by what its blocks differ and by what those of the pixels around it do.
//!
//! A few blocks know the variance of a pixel badly, and worst where it matters: a pixel that has had no rare bright sample shows too little
//! of both light and variance, so that its interval is narrow where it should be wide. Pixels around it see the same light with other
//! samples, so their variances are averaged, as filters of noisy images do (Rousselle et al. 2012, §4: "Adaptive rendering with non-local
//! means filtering").

use rayon::prelude::*;

/// Pixels around one that are asked, to each side.
const RADIUS: usize = 2;
/// Pixels are alike whose difference is at most so many of its standard errors: those across an edge are not.
const ALIKE: f64 = 1.5;

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
/// alike in the square around it, over the pixel's own samples; infinite where none of them is finite.
///
/// # Panics
/// When `pixels` are not whole rows.
pub(super) fn variances(pixels: &[Pixel], width: usize) -> Vec<[f64; 3]> {
    assert!(width > 0 && pixels.len().is_multiple_of(width), "whole rows");
    let height = pixels.len() / width;
    let near = |at: usize, end: usize| at.saturating_sub(RADIUS)..(at + RADIUS + 1).min(end);
    let one = |i: usize| {
        let (own, [x, y]) = (&pixels[i], [i % width, i / width]);
        let (mut sum, mut count) = ([0.0; 3], 0.0);
        for row in near(y, height) {
            for other in &pixels[row * width..][near(x, width)] {
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
        // 3 × 3 pixels are all within reach of each other.
        let mut pixels = vec![gray(1.0, 0.04, 2.0); 9];
        pixels[4] = gray(1.1, 0.01, 4.0);
        let found = variances(&pixels, 3);
        let of_sample = (8.0 * 0.08 + 0.04) / 9.0;
        for (i, v) in found.iter().enumerate() {
            let samples = if i == 4 { 4.0 } else { 2.0 };
            v.iter().for_each(|v| assert!((v - of_sample / samples).abs() < 1e-15, "{i}: {v}"));
        }
    }

    #[test]
    fn an_edge_is_not_crossed() {
        let row = |x: usize| if x < 5 { gray(1.0, 0.01, 1.0) } else { gray(2.0, 0.64, 1.0) };
        let pixels: Vec<Pixel> = (0..40).map(|i| row(i % 10)).collect();
        // They differ by 1, of which the standard error is 0.81: alike. With a tenth of that they are not.
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

    /// Rare bright samples: one in 50, of which a pixel has 64 in eight blocks. By itself it is sure of itself far too often.
    #[test]
    fn intervals_hold_where_tails_are_heavy() {
        let (size, blocks, of_block) = (48, 8, 8);
        let mut rng = Stream::from_key(7, 0);
        let pixel = |_| {
            let means: Vec<f64> = (0..blocks)
                .map(|_| (0..of_block).filter(|_| rng.next_f32() < 0.02).count() as f64 * 50.0 / f64::from(of_block))
                .collect();
            let mean = means.iter().sum::<f64>() / f64::from(blocks);
            let square = means.iter().map(|m| (m - mean) * (m - mean)).sum::<f64>();
            gray(mean, square / f64::from(blocks * (blocks - 1)), f64::from(blocks * of_block))
        };
        let pixels: Vec<Pixel> = (0..size * size).map(pixel).collect();
        let held = |variance: &dyn Fn(usize) -> f64| {
            let holds = |i: &usize| (pixels[*i].value[0] - 1.0).abs() <= 1.96 * variance(*i).sqrt();
            (0..pixels.len()).filter(holds).count() as f64 / pixels.len() as f64
        };
        let (alone, found) = (held(&|i| pixels[i].variance[0]), variances(&pixels, size));
        let together = held(&|i| found[i][0]);
        assert!(alone < 0.8 && (0.93..0.98).contains(&together), "{alone} {together}");
    }
}

//! Errors between images: relative MSE, MSE, RMSE, bias, and a false-colour picture of where they are.
//!
//! relMSE = mean((a − r)² / (r² + 0.01)) over pixels and channels, as the literature on Monte Carlo rendering uses it
//! (Rousselle et al. 2011, with ε = 0.01); sums are in double precision and in pixel order.

use super::relative::bounded;
use crate::error::ImageError;
use crate::math::{Rgb, ops};

/// Keeps the relative error finite where the reference is black.
pub const EPSILON: f64 = 0.01;
/// Share of the pixels, those with the largest error, that the trimmed error leaves out.
pub const TRIMMED_SHARE: f64 = 0.001;

/// How an image differs from its reference. Errors are over the red, green and blue of every compared pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// mean((a − r)² / (r² + 0.01)).
    pub relative_mse: f64,
    /// The same without the worst 0.1 % of the pixels.
    pub trimmed_relative_mse: f64,
    /// In the measure of the error that a render states of itself: root of the mean of e²/(1 + e²), e = |a − r| / max(|r|, mean of r).
    pub relative_error: f64,
    /// mean((a − r)²).
    pub mse: f64,
    /// √MSE.
    pub rmse: f64,
    /// mean(a)/mean(r) − 1; `None` where the reference is black.
    pub bias: Option<f64>,
    /// Mean of the image.
    pub mean: f64,
    /// Mean of the reference.
    pub reference_mean: f64,
    /// Pixels compared: those where the reference is finite.
    pub pixels: usize,
    /// Values of the image that are NaN or infinite; they count as 0.
    pub non_finite: usize,
    /// mean over channels of (a − r)² / (r² + 0.01) for each pixel, 0 where the reference is not finite.
    pub pixel_errors: Vec<f64>,
}

/// Compares `image` with `reference`, both `width × height` pixels row by row.
///
/// # Errors
/// [`ImageError::Shape`] when the sizes differ, or nothing can be compared.
pub fn compare(image: (usize, usize, &[Rgb]), reference: (usize, usize, &[Rgb])) -> Result<Comparison, ImageError> {
    let ((aw, ah, a), (rw, rh, r)) = (image, reference);
    if (aw, ah) != (rw, rh) || a.len() != r.len() {
        return Err(ImageError::Shape(format!("{aw} × {ah} pixels against {rw} × {rh} of the reference")));
    }
    let mut sums = Sums::default();
    let mut compared = Vec::with_capacity(a.len());
    let pixel_errors: Vec<f64> = a
        .iter()
        .zip(r)
        .map(|(&a, &r)| {
            let error = sums.add(a, r);
            compared.extend(error);
            error.unwrap_or(0.0)
        })
        .collect();
    if compared.is_empty() {
        return Err(ImageError::Shape("no pixel of the reference is finite".into()));
    }
    let values = 3.0 * compared.len() as f64;
    let (mean, reference_mean) = (sums.image / values, sums.reference / values);
    Ok(Comparison {
        relative_mse: sums.relative / compared.len() as f64,
        trimmed_relative_mse: trimmed_mean(&mut compared),
        relative_error: relative_error(a, r, reference_mean.abs()),
        mse: sums.squared / values,
        rmse: (sums.squared / values).sqrt(),
        bias: (reference_mean != 0.0).then(|| mean / reference_mean - 1.0),
        mean,
        reference_mean,
        pixels: compared.len(),
        non_finite: sums.non_finite,
        pixel_errors,
    })
}

#[derive(Default)]
struct Sums {
    image: f64,
    reference: f64,
    squared: f64,
    relative: f64,
    non_finite: usize,
}

impl Sums {
    /// Adds one pixel; its relative squared error, or `None` where the reference says nothing.
    fn add(&mut self, a: Rgb, r: Rgb) -> Option<f64> {
        self.non_finite += a.to_array().iter().filter(|v| !v.is_finite()).count();
        if !r.is_finite() {
            return None;
        }
        let mut relative = 0.0;
        for [a, r] in channels(a, r) {
            let squared = (a - r) * (a - r);
            self.image += a;
            self.reference += r;
            self.squared += squared;
            relative += squared / (r * r + EPSILON) / 3.0;
        }
        self.relative += relative;
        Some(relative)
    }
}

/// The values of image and reference, of each channel; those of the image that are not finite count as 0.
fn channels(a: Rgb, r: Rgb) -> [[f64; 2]; 3] {
    let (a, r) = (a.to_array(), r.to_array());
    [0, 1, 2].map(|c| [if a[c].is_finite() { f64::from(a[c]) } else { 0.0 }, f64::from(r[c])])
}

/// See [`Comparison::relative_error`]; `floor` is the reference's mean, ≥ 0.
fn relative_error(image: &[Rgb], reference: &[Rgb], floor: f64) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (&a, &r) in image.iter().zip(reference).filter(|(_, r)| r.is_finite()) {
        for [a, r] in channels(a, r) {
            let worth = r.abs().max(floor);
            sum += bounded((a - r) * (a - r), worth * worth);
            count += 1.0;
        }
    }
    f64::sqrt(sum / count)
}

/// Mean of `errors` without the largest [`TRIMMED_SHARE`] of them; sorts them.
fn trimmed_mean(errors: &mut [f64]) -> f64 {
    errors.sort_unstable_by(f64::total_cmp);
    let keep = ((errors.len() as f64 * (1.0 - TRIMMED_SHARE)).floor() as usize).max(1);
    errors.iter().take(keep).sum::<f64>() / keep as f64
}

/// Stops of the false-colour scale: relative error √(pixel relMSE) and its sRGB colour; logarithmic between stops.
pub const LEGEND: [(f64, [u8; 3], &str); 7] = [
    (0.001, [8, 8, 40], "black"),
    (0.003, [50, 40, 160], "blue"),
    (0.01, [0, 130, 190], "cyan"),
    (0.03, [30, 160, 60], "green"),
    (0.1, [240, 220, 40], "yellow"),
    (0.3, [220, 40, 30], "red"),
    (1.0, [255, 255, 255], "white"),
];

/// The false-colour picture of `comparison`: RGB, 8 bits a channel, three bytes a pixel; scale as in [`LEGEND`].
pub fn false_color(comparison: &Comparison) -> Vec<u8> {
    comparison.pixel_errors.iter().flat_map(|&e| scale_color(e.sqrt())).collect()
}

fn scale_color(error: f64) -> [u8; 3] {
    let mut below = LEGEND[0];
    if error <= below.0 {
        return below.1;
    }
    for stop in LEGEND {
        if error < stop.0 {
            let t = ops::ln64(error / below.0) / ops::ln64(stop.0 / below.0);
            let mix = |i: usize| {
                let (a, b) = (f64::from(below.1[i]), f64::from(stop.1[i]));
                (a + (b - a) * t).round() as u8
            };
            return [mix(0), mix(1), mix(2)];
        }
        below = stop;
    }
    below.1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn errors(a: &[Rgb], r: &[Rgb]) -> Comparison {
        compare((a.len(), 1, a), (r.len(), 1, r)).unwrap()
    }

    #[test]
    fn figures_by_hand() {
        // (a − r)²: .25, 0, 1; r² + ε: 1.01, .01, 4.01.
        let c = errors(&[Rgb::new(1.5, 0.0, 1.0)], &[Rgb::new(1.0, 0.0, 2.0)]);
        let expected = (0.25 / 1.01 + 1.0 / 4.01) / 3.0;
        assert!((c.relative_mse - expected).abs() < 1e-15);
        // Relative to the mean of 1, or to more: .5, 0, .5.
        assert!((c.relative_error - (0.4f64 / 3.0).sqrt()).abs() < 1e-15);
        assert!((c.mse - 1.25 / 3.0).abs() < 1e-15);
        assert!((c.rmse * c.rmse - c.mse).abs() < 1e-15);
        assert!((c.bias.unwrap() - (2.5 / 3.0 - 1.0)).abs() < 1e-15);
    }

    #[test]
    fn trimming_leaves_out_the_worst_thousandth() {
        let r = vec![Rgb::WHITE; 2000];
        let mut a = vec![Rgb::splat(1.1); 2000];
        a[7] = Rgb::splat(1e6);
        a[1999] = Rgb::splat(1e3);
        let c = errors(&a, &r);
        let e = f64::from(1.1f32) - 1.0;
        assert!((c.trimmed_relative_mse - e * e / 1.01).abs() < 1e-12);
        assert!(c.relative_mse > 1e8);
    }

    #[test]
    fn what_is_not_finite_is_counted() {
        let nan = f32::NAN;
        let c = errors(&[Rgb::new(nan, 1.0, 1.0), Rgb::WHITE], &[Rgb::WHITE, Rgb::new(1.0, nan, 1.0)]);
        assert_eq!((c.non_finite, c.pixels), (1, 1));
        assert!((c.relative_mse - 1.0 / 1.01 / 3.0).abs() < 1e-15);
        // Wrong by all it is worth: half.
        assert!((c.relative_error - (0.5f64 / 3.0).sqrt()).abs() < 1e-15);
    }

    #[test]
    fn black_reference_has_no_bias_and_sizes_must_agree() {
        assert_eq!(errors(&[Rgb::WHITE], &[Rgb::BLACK]).bias, None);
        let two = [Rgb::WHITE; 2];
        let message = compare((2, 1, &two), (1, 2, &two)).unwrap_err().to_string();
        assert!(message.contains("2 × 1") && message.contains("1 × 2"), "{message}");
    }

    #[test]
    fn false_colour_runs_through_its_stops() {
        for (error, color, _) in LEGEND {
            assert_eq!(scale_color(error), color);
        }
        assert_eq!(scale_color(0.0), LEGEND[0].1);
        assert_eq!(scale_color(f64::INFINITY), [255, 255, 255]);
        // Half-way on the logarithmic scale.
        assert_eq!(scale_color((0.1f64 * 0.3).sqrt()), [230, 130, 35]);
    }
}

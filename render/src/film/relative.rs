//! How wrong a pixel is, relative to what it is worth.
//!
//! An image's relative error is the root of the mean over pixels and channels of e²/(1 + e²), where e is the error of the pixel relative to
//! its value, or to the mean of the image where that is greater. Small errors count as they are; a pixel that is wrong by far more than it is
//! worth counts as wholly wrong, 100 %, and no more. Without that bound one firefly, or one sample that half saw a lamp, decides the figure of
//! an image: its mean over seeds is made by the few that had one, so none of the others can state it.

/// e²/(1 + e²) of an error whose square is `square` at a pixel that is worth the root of `worth` (≥ 0), with the sign of `square`: in [−1, 1].
/// Products of independent estimates of an error stand for its square and may be negative.
pub(super) fn bounded(square: f64, worth: f64) -> f64 {
    // Neither an infinite variance nor a product that is too large for f64 becomes NaN.
    if square == 0.0 { 0.0 } else { square.signum() / (1.0 + worth / square.abs()) }
}

#[cfg(test)]
mod tests {
    use super::bounded;

    #[test]
    fn small_errors_count_as_they_are_and_large_ones_as_one() {
        assert!((bounded(1e-4, 4.0) / 0.25e-4 - 1.0).abs() < 1e-4);
        assert_eq!(bounded(4.0, 4.0), 0.5);
        assert!((bounded(1e12, 4.0) - 1.0).abs() < 1e-11);
        assert_eq!(bounded(-4.0, 4.0), -0.5);
    }

    #[test]
    fn it_is_finite_at_all_scales() {
        assert_eq!(bounded(0.0, 0.0), 0.0);
        assert_eq!(bounded(1.0, 0.0), 1.0);
        assert_eq!(bounded(f64::INFINITY, 1.0), 1.0);
        assert_eq!(bounded(f64::MIN_POSITIVE, f64::MAX), 0.0);
    }
}

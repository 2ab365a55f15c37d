//! Russian roulette (Arvo and Kirk 1990): ends paths without changing the mean.

/// Bounces before which only a path's own throughput decides.
const FREE_BOUNCES: u32 = 32;
/// How slowly the cap falls beyond them.
const CAP_START: f32 = 64.0;

/// Upper bound on the survival probability at `bounce` (0 for the first), below 1 after [`FREE_BOUNCES`].
///
/// The product of 1 − 2/(n + 64) falls as n⁻², so that even in a box of perfect mirrors a path ends after a bounded mean
/// number of bounces, while for every albedo a < 1 the variance Σ a²ⁿ n² stays finite.
#[inline]
pub fn survival_cap(bounce: u32) -> f32 {
    if bounce < FREE_BOUNCES { 1.0 } else { 1.0 - 2.0 / ((bounce - FREE_BOUNCES) as f32 + CAP_START) }
}

/// Survival probability of a camera path: its throughput's largest channel, kept in [`min`, cap].
///
/// `throughput` is relative to the path's start (a perfect white path has 1).
#[inline]
pub fn camera_survival(throughput_max: f32, bounce: u32) -> f32 {
    const MINIMUM: f32 = 0.05;
    if bounce < 2 {
        // The first bounces carry most of what a pixel shows.
        return 1.0;
    }
    throughput_max.clamp(MINIMUM, survival_cap(bounce))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn perfect_mirrors_end_in_bounded_mean_length() {
        let (mut alive, mut mean) = (1.0f64, 0.0);
        for n in 0..1_000_000 {
            alive *= f64::from(survival_cap(n));
            mean += alive;
        }
        assert!(mean < 110.0, "mean length {mean}");
        assert!(alive < 1e-8);
    }
}

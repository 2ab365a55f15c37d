//! Comparing means of few independent results: Welch's t-test (Welch 1947), with Student's distribution, not the normal one.

use crate::chi_square::ln_gamma;

/// Mean of independent, equally distributed results, and what is known of its error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mean {
    /// The mean.
    pub value: f64,
    /// Its squared standard error.
    pub variance: f64,
    /// Degrees of freedom of `variance`.
    pub degrees: f64,
}

impl Mean {
    /// Of at least two results.
    ///
    /// # Panics
    /// For fewer.
    pub fn of(results: impl IntoIterator<Item = f64>) -> Self {
        let results: Vec<f64> = results.into_iter().collect();
        assert!(results.len() > 1, "one result says nothing of its error");
        let n = results.len() as f64;
        let value = results.iter().sum::<f64>() / n;
        let variance = results.iter().map(|r| (r - value).powi(2)).sum::<f64>() / (n - 1.0) / n;
        Mean { value, variance, degrees: n - 1.0 }
    }

    /// a · self + b · other, for independent means; degrees of freedom after Satterthwaite (1946).
    pub fn combined(self, a: f64, other: Mean, b: f64) -> Self {
        let (v, w) = (a * a * self.variance, b * b * other.variance);
        let variance = v + w;
        let degrees = if variance > 0.0 {
            variance * variance / (v * v / self.degrees + w * w / other.degrees)
        } else {
            self.degrees.min(other.degrees)
        };
        Mean { value: a * self.value + b * other.value, variance, degrees }
    }

    /// Standard error.
    pub fn sigma(self) -> f64 {
        self.variance.sqrt()
    }

    /// The value over its standard error; 0 for 0/0.
    pub fn t(self) -> f64 {
        if self.value == 0.0 { 0.0 } else { self.value / self.sigma() }
    }

    /// Probability of a |t| at least as large if the expectation is 0.
    pub fn p_value(self) -> f64 {
        student_two_sided(self.t(), self.degrees)
    }
}

/// Probability of |T| ≥ |t| for Student's distribution with `degrees` > 0 degrees of freedom: I_x(ν/2, 1/2) with
/// x = ν/(ν + t²) (Abramowitz and Stegun 26.7.1 and 26.5.27).
pub fn student_two_sided(t: f64, degrees: f64) -> f64 {
    if t.is_nan() {
        return 0.0;
    }
    if t.is_infinite() {
        return 0.0;
    }
    let (a, b, x) = (0.5 * degrees, 0.5, degrees / (degrees + t * t));
    let ln_front = ln_gamma(a + b) - ln_gamma(a) - ln_gamma(b) + a * x.ln() + b * (-x).ln_1p();
    // The fraction converges fast below (a + 1)/(a + b + 2); above, I_x(a, b) = 1 − I_{1−x}(b, a).
    if x < (a + 1.0) / (a + b + 2.0) {
        ln_front.exp() * beta_fraction(a, b, x) / a
    } else {
        1.0 - ln_front.exp() * beta_fraction(b, a, 1.0 - x) / b
    }
}

/// The continued fraction of the incomplete beta function (Abramowitz and Stegun 26.5.8) by Lentz's method.
fn beta_fraction(a: f64, b: f64, x: f64) -> f64 {
    const TINY: f64 = 1e-300;
    let away = |v: f64| if v.abs() < TINY { TINY } else { v };
    let mut c = 1.0;
    let mut d = 1.0 / away(1.0 - (a + b) * x / (a + 1.0));
    let mut f = d;
    for m in 1..500 {
        let m = f64::from(m);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        for step in [even, odd] {
            d = 1.0 / away(1.0 + step * d);
            c = away(1.0 + step / c);
            f *= c * d;
        }
        if (c * d - 1.0).abs() < 1e-14 {
            break;
        }
    }
    f
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Quantiles of the usual tables, and the closed forms for one and two degrees of freedom.
    #[test]
    fn p_values_match_the_tables() {
        for (t, degrees, p) in [
            (2.228, 10.0, 0.05),
            (3.169, 10.0, 0.01),
            (4.587, 10.0, 0.001),
            (2.776, 4.0, 0.05),
            (2.042, 30.0, 0.05),
            (1.960, 1e6, 0.05),
        ] {
            let ours = student_two_sided(t, degrees);
            assert!((ours / p - 1.0).abs() < 2e-3, "t = {t}, ν = {degrees}: {ours} instead of {p}");
        }
        for t in [0.01f64, 0.7, 3.0, 40.0] {
            let cauchy = 1.0 - 2.0 / std::f64::consts::PI * t.atan();
            assert!((student_two_sided(t, 1.0) - cauchy).abs() < 1e-12);
            assert!((student_two_sided(-t, 2.0) - (1.0 - t / (2.0 + t * t).sqrt())).abs() < 1e-12);
        }
        assert_eq!(student_two_sided(0.0, 7.0), 1.0);
        assert_eq!(student_two_sided(f64::INFINITY, 7.0), 0.0);
    }

    #[test]
    fn means_and_their_combinations_by_hand() {
        let a = Mean::of([1.0, 2.0, 3.0, 6.0]);
        // Squared deviations 4 + 1 + 0 + 9.
        assert_eq!((a.value, a.variance, a.degrees), (3.0, 14.0 / 3.0 / 4.0, 3.0));
        let d = a.combined(1.0, a, -1.0);
        assert_eq!((d.value, d.variance), (0.0, 2.0 * a.variance));
        assert!((d.degrees - 6.0).abs() < 1e-12);
        assert_eq!(a.combined(2.0, Mean::of([5.0, 5.0]), 1.0).value, 11.0);
    }
}

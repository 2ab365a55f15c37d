//! The radius of each round of a progressive method (Knaus and Zwicker 2011).

/// Radius of `round` (from 0) when round 0 has `first` > 0: r²ᵢ₊₁ = r²ᵢ (i + α)/(i + 1) with i = round + 1 and α in (0, 1)
/// (eq. 20, there with i from 1). Falls as round^((α − 1)/2); with that the bias of the mean over rounds vanishes and its
/// variance too (§4).
///
/// Computed in f64, in O(round) operations: no round needs another's result.
pub fn radius_of_round(first: f32, alpha: f32, round: u32) -> f32 {
    let alpha = f64::from(alpha);
    let shrink = (1..=round).fold(1.0f64, |p, i| p * ((f64::from(i) + alpha) / (f64::from(i) + 1.0)));
    (f64::from(first) * shrink.sqrt()) as f32
}

/// For rounds 0, 1, … what their blur is in proportion to, that of round 0 being 1.
///
/// The bias falls as r² where the irradiance is smooth and as r along its edges (Silverman 1986, §3.3; Schjøth 2009). The edges of
/// focused light have by far the most of it, and r overstates the rest rather than understate them.
pub fn blur_of_rounds(alpha: f32) -> impl Iterator<Item = f64> {
    let alpha = f64::from(alpha);
    let shrink = move |squared: &mut f64, i: u32| {
        let now = *squared;
        *squared *= (f64::from(i) + alpha) / (f64::from(i) + 1.0);
        Some(now.sqrt())
    };
    (1..).scan(1.0, shrink)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_rounds_by_hand_and_the_rate_far_out() {
        let alpha = 0.5f32;
        assert_eq!(radius_of_round(2.0, alpha, 0), 2.0);
        let expected = 2.0 * (1.5f64 / 2.0 * 2.5 / 3.0).sqrt();
        assert!((f64::from(radius_of_round(2.0, alpha, 2)) - expected).abs() < 1e-6);
        // r ∝ n^((α − 1)/2): a factor 16 in rounds is a factor 16^(−1/4) = 1/2 in the radius.
        let ratio = radius_of_round(1.0, alpha, 16_000) / radius_of_round(1.0, alpha, 1_000);
        assert!((ratio - 0.5).abs() < 1e-3, "{ratio}");
    }

    #[test]
    fn blur_falls_with_the_radius() {
        for (round, blur) in blur_of_rounds(0.5).take(200).enumerate().step_by(50) {
            let r = f64::from(radius_of_round(1.0, 0.5, round as u32));
            assert!((blur / r - 1.0).abs() < 1e-5, "{round}: {blur} {r}");
        }
    }

    #[test]
    fn it_never_grows_and_never_vanishes() {
        let mut last = f32::INFINITY;
        for round in 0..2_000 {
            let r = radius_of_round(1e-3, 0.01, round);
            assert!(r > 0.0 && r <= last);
            last = r;
        }
    }
}

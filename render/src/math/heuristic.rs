//! Multiple importance sampling weights (Veach 1997, §9.2), as ratios so that no pdf product overflows.

/// Power heuristic with β = 2 for one sample of each of two techniques; `pdf` is that of the technique used.
///
/// Both pdfs ≥ 0 in the same measure. An infinite `pdf` (Dirac) gives 1.
#[inline]
pub fn power(pdf: f32, other_pdf: f32) -> f32 {
    if other_pdf == 0.0 || pdf == f32::INFINITY {
        return 1.0;
    }
    if pdf == 0.0 || other_pdf == f32::INFINITY {
        return 0.0;
    }
    let ratio = other_pdf / pdf;
    1.0 / (1.0 + ratio * ratio)
}

/// Balance heuristic for one sample of each of two techniques.
#[inline]
pub fn balance(pdf: f32, other_pdf: f32) -> f32 {
    if other_pdf == 0.0 || pdf == f32::INFINITY {
        return 1.0;
    }
    if pdf == 0.0 || other_pdf == f32::INFINITY {
        return 0.0;
    }
    1.0 / (1.0 + other_pdf / pdf)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_one_and_survive_extremes() {
        for a in [1e-38f32, 1e-20, 1.0, 1e20, 3e38] {
            for b in [1e-38f32, 1e-20, 1.0, 1e20, 3e38] {
                for h in [power, balance] {
                    let s = h(a, b) + h(b, a);
                    assert!((s - 1.0).abs() < 1e-6, "{a} {b} {s}");
                }
            }
        }
        assert_eq!(power(f32::INFINITY, 1.0), 1.0);
        assert_eq!(power(1.0, f32::INFINITY), 0.0);
    }
}

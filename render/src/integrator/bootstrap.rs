//! The bootstrap of Metropolis light transport: independent paths whose mean fixes the image's brightness, and from which
//! the chains start (Veach and Guibas 1997, §5.1; Kelemen et al. 2002).

/// Luminances of independent paths, numbered from 0, and the choice among them in proportion.
#[derive(Clone, Debug, PartialEq)]
pub struct Bootstrap {
    weights: Vec<f32>,
    /// Sums up to and including each weight, in f64 and in order.
    cumulative: Vec<f64>,
    /// Sum of the squares of the weights over their mean.
    relative_squares: f64,
    /// Weights that were not finite.
    non_finite: u64,
}

impl Bootstrap {
    /// From the luminances of all bootstrap paths in order; negative and not finite ones count as 0.
    pub fn new(mut weights: Vec<f32>) -> Self {
        let mut non_finite = 0;
        for w in &mut weights {
            non_finite += u64::from(!w.is_finite());
            *w = if w.is_finite() { w.max(0.0) } else { 0.0 };
        }
        let mut sum = 0.0;
        let cumulative: Vec<f64> = weights
            .iter()
            .map(|&w| {
                sum += f64::from(w);
                sum
            })
            .collect();
        let mean = sum / weights.len().max(1) as f64;
        let square = |&w: &f32| f64::from(w) / mean * (f64::from(w) / mean);
        let relative_squares = if mean > 0.0 { weights.iter().map(square).sum() } else { 0.0 };
        Bootstrap { weights, cumulative, relative_squares, non_finite }
    }
    /// The luminances.
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }
    /// Paths whose luminance was not finite.
    pub fn non_finite(&self) -> u64 {
        self.non_finite
    }
    /// Sum of the luminances.
    pub fn sum(&self) -> f64 {
        self.cumulative.last().copied().unwrap_or(0.0)
    }
    /// Mean of the luminances; 0 without paths.
    pub fn mean(&self) -> f64 {
        self.sum() / self.weights.len().max(1) as f64
    }
    /// Sum of the squares of the luminances over their mean; 0 where all are black.
    pub fn relative_squares(&self) -> f64 {
        self.relative_squares
    }
    /// The path that `u` in [0, 1) chooses in proportion to its luminance; `None` when all are black.
    pub fn sample(&self, u: f64) -> Option<u64> {
        let sum = self.sum();
        if sum <= 0.0 {
            return None;
        }
        let index = self.cumulative.partition_point(|&c| c <= u * sum).min(self.weights.len() - 1);
        // Rounding may lead past the last path that is not black.
        let lit = self.weights[..=index].iter().rposition(|&w| w > 0.0);
        lit.or_else(|| self.weights.iter().position(|&w| w > 0.0)).map(|i| i as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_chosen_in_proportion() {
        let b = Bootstrap::new(vec![0.0, 1.0, 0.0, 3.0, f32::NAN, -2.0]);
        assert_eq!((b.sum(), b.non_finite()), (4.0, 1));
        let n = 4000;
        let third = (0..n).filter(|i| b.sample((f64::from(*i) + 0.5) / f64::from(n)) == Some(3)).count();
        assert_eq!(third, 3000);
        assert_eq!((b.sample(0.0), b.sample(1.0 - 1e-16)), (Some(1), Some(3)));
        assert_eq!(Bootstrap::new(vec![0.0; 3]).sample(0.5), None);
        assert_eq!(Bootstrap::new(Vec::new()).sample(0.5), None);
    }
}

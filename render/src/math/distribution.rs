//! Discrete distributions.

/// Draws index `i` with probability `weight[i] / Σ weight` in constant time (Walker 1977; Vose 1991).
#[derive(Clone, Debug)]
pub struct AliasTable {
    /// Acceptance threshold and alias of each bin.
    bins: Vec<(f32, u32)>,
    pmf: Vec<f32>,
}

impl AliasTable {
    /// Builds the table; weights that are negative or not finite count as 0. `None` when all weights are 0.
    pub fn new(weights: &[f64]) -> Option<Self> {
        let clean = |w: f64| if w.is_finite() && w > 0.0 { w } else { 0.0 };
        // Scaling by the largest weight first keeps the sum finite.
        let largest = weights.iter().map(|&w| clean(w)).fold(0.0, f64::max);
        if largest == 0.0 {
            return None;
        }
        let n = weights.len();
        let sum: f64 = weights.iter().map(|&w| clean(w) / largest).sum();
        let p: Vec<f64> = weights.iter().map(|&w| clean(w) / largest / sum).collect();
        let mut scaled: Vec<f64> = p.iter().map(|q| q * n as f64).collect();
        let (mut small, mut large): (Vec<usize>, Vec<usize>) = (0..n).partition(|&i| scaled[i] < 1.0);
        let mut bins = vec![(1.0f32, 0u32); n];
        while let (Some(s), Some(l)) = (small.pop(), large.last().copied()) {
            bins[s] = (scaled[s] as f32, l as u32);
            scaled[l] = (scaled[l] + scaled[s]) - 1.0;
            if scaled[l] < 1.0 {
                large.pop();
                small.push(l);
            }
        }
        let fallback = (0..n).max_by(|&a, &b| p[a].total_cmp(&p[b])).unwrap_or(0);
        for i in small.into_iter().chain(large) {
            // Left over by rounding; a bin of weight 0 must still never be drawn.
            bins[i] = if p[i] > 0.0 { (1.0, i as u32) } else { (0.0, fallback as u32) };
        }
        Some(AliasTable { bins, pmf: p.iter().map(|&q| q as f32).collect() })
    }

    /// Number of entries.
    pub fn len(&self) -> usize {
        self.pmf.len()
    }
    /// Whether there are no entries (never true for a built table).
    pub fn is_empty(&self) -> bool {
        self.pmf.is_empty()
    }
    /// Probability of index `i`.
    #[inline]
    pub fn pmf(&self, i: usize) -> f32 {
        self.pmf[i]
    }
    /// Index drawn by `u` in [0, 1), its probability, and what is left of `u`: uniform in [0, 1) given the index, so that the
    /// stratification of `u` is handed on to what is drawn next.
    #[inline]
    pub fn sample_with_rest(&self, u: f64) -> (usize, f32, f64) {
        let x = u * self.bins.len() as f64;
        let bin = (x as usize).min(self.bins.len() - 1);
        let (threshold, alias) = self.bins[bin];
        let (threshold, fraction) = (f64::from(threshold), (x - bin as f64).min(1.0));
        let (i, rest) = if fraction < threshold {
            (bin, fraction / threshold)
        } else {
            (alias as usize, (fraction - threshold) / (1.0 - threshold))
        };
        (i, self.pmf[i], rest)
    }
    /// Index drawn by `u` in [0, 1), and its probability.
    #[inline]
    pub fn sample(&self, u: f32) -> (usize, f32) {
        let x = u * self.bins.len() as f32;
        let bin = (x as usize).min(self.bins.len() - 1);
        let (threshold, alias) = self.bins[bin];
        let i = if x - (bin as f32) < threshold { bin } else { alias as usize };
        (i, self.pmf[i])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_in_proportion_even_at_extreme_ratios() {
        let w = [1e300, 0.0, 3e300, 1e-300, 4e300];
        let t = AliasTable::new(&w).unwrap();
        let n = 800_000;
        let mut counts = [0u32; 5];
        for i in 0..n {
            counts[t.sample((i as f32 + 0.5) / n as f32).0] += 1;
        }
        assert_eq!(counts[1], 0);
        for (i, expect) in [(0, 0.125), (2, 0.375), (4, 0.5)] {
            assert!((f64::from(counts[i]) / f64::from(n) - expect).abs() < 1e-4, "{i}: {}", counts[i]);
        }
        assert!(AliasTable::new(&[0.0, f64::NAN]).is_none());
        assert!(AliasTable::new(&[]).is_none());
    }

    #[test]
    fn what_is_left_of_the_number_is_uniform_for_every_index() {
        let weights = [1.0, 0.0, 5.0, 2.5, 0.3];
        let table = AliasTable::new(&weights).unwrap();
        let (n, bins) = (400_000, 8);
        let mut counts = [[0u32; 8]; 5];
        for k in 0..n {
            let (i, pmf, rest) = table.sample_with_rest((f64::from(k) + 0.5) / f64::from(n));
            assert!((0.0..=1.0).contains(&rest));
            assert_eq!(pmf, table.pmf(i));
            counts[i][((rest * f64::from(bins)) as usize).min(7)] += 1;
        }
        for (i, row) in counts.iter().enumerate() {
            // An even grid of numbers: each piece of a bin's range is off by at most one count at either end, and at most five
            // bins lead to an index.
            let expect = weights[i] / 8.8 * f64::from(n) / f64::from(bins);
            assert!(row.iter().all(|&c| (f64::from(c) - expect).abs() <= 11.0), "{i}: {row:?}, not {expect}");
        }
    }
}

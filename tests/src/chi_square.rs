//! Pearson's chi² test for sampling routines, after pbrt's `bsdfs_test.cpp`: cells that expect little are pooled, and
//! the significance is corrected for the number of tests (Šidák 1967).

use glam::{DVec3, Vec3};
use std::f64::consts::PI;

/// Cells that expect fewer counts than this are pooled before they enter the statistic.
pub const MIN_EXPECTED: f64 = 5.0;

/// Outcome of a test.
#[derive(Clone, Copy, Debug)]
pub struct ChiSquare {
    /// Σ (observed − expected)²/expected over cells and pools.
    pub statistic: f64,
    /// Cells and pools, less one.
    pub degrees: usize,
    /// Probability of a statistic at least as large if the counts follow the expectation.
    pub p_value: f64,
}

/// Most halvings of a cell in [`SphereGrid::integrate`].
const MAX_DEPTH: u32 = 7;
/// Share of all counts that may fall where nothing is expected: directions on a boundary, rounded to its far side.
const MAX_IMPOSSIBLE: f64 = 1e-4;

/// Compares counts with expectations; both sum to about the number of samples. More than 1e-4 of the counts where
/// nothing at all is expected give the p-value 0.
pub fn chi_square(observed: &[f64], expected: &[f64]) -> ChiSquare {
    assert_eq!(observed.len(), expected.len());
    let mut cells: Vec<(f64, f64)> = expected.iter().copied().zip(observed.iter().copied()).collect();
    cells.sort_by(|a, b| a.0.total_cmp(&b.0));
    let nowhere: f64 = cells.iter().filter(|c| c.0 == 0.0).map(|c| c.1).sum();
    let impossible = nowhere > MAX_IMPOSSIBLE * observed.iter().sum::<f64>();
    let (mut statistic, mut terms, mut pool) = (0.0, 0usize, (0.0, 0.0));
    for (i, &(e, o)) in cells.iter().enumerate() {
        pool = (pool.0 + e, pool.1 + o);
        // Whatever is left when too little remains for another pool joins the last one.
        let rest: f64 = if e > MIN_EXPECTED { f64::INFINITY } else { cells[i + 1..].iter().map(|c| c.0).sum() };
        if pool.0 > MIN_EXPECTED && (rest > MIN_EXPECTED || i + 1 == cells.len()) {
            statistic += (pool.1 - pool.0).powi(2) / pool.0;
            terms += 1;
            pool = (0.0, 0.0);
        }
    }
    let degrees = terms.saturating_sub(1);
    let p_value = match (impossible, degrees) {
        (true, _) => 0.0,
        // One cell or none: nothing to compare.
        (false, 0) => 1.0,
        (false, n) => upper_gamma(n as f64 / 2.0, statistic / 2.0),
    };
    ChiSquare { statistic, degrees, p_value }
}

/// Significance of one of `tests` independent tests such that all pass with probability 1 − `significance`.
pub fn sidak(significance: f64, tests: usize) -> f64 {
    -((-significance).ln_1p() / tests as f64).exp_m1()
}

/// Regularised upper incomplete gamma function Q(a, x), a > 0, x ≥ 0 (Abramowitz and Stegun 6.5.29 and 6.5.31).
pub fn upper_gamma(a: f64, x: f64) -> f64 {
    let scale = (a * x.ln() - x - ln_gamma(a)).exp();
    if x <= 0.0 {
        return 1.0;
    }
    if x < a + 1.0 {
        let (mut term, mut sum, mut n) = (1.0 / a, 1.0 / a, a);
        while term > sum * 1e-16 {
            n += 1.0;
            term *= x / n;
            sum += term;
        }
        return 1.0 - sum * scale;
    }
    // Lentz's continued fraction.
    let (mut b, mut c) = (x + 1.0 - a, 1e300);
    let (mut d, mut i) = (1.0 / b, 1.0);
    let mut h = d;
    loop {
        let an = -i * (i - a);
        b += 2.0;
        d = 1.0 / (an * d + b);
        c = b + an / c;
        h *= d * c;
        i += 1.0;
        if (d * c - 1.0).abs() < 1e-15 || i > 1e5 {
            return scale * h;
        }
    }
}

/// ln Γ(x) for x > 0 (Stirling's series after shifting x above 10; error below 1e-13).
pub(crate) fn ln_gamma(x: f64) -> f64 {
    let (mut x, mut shift) = (x, 0.0);
    while x < 10.0 {
        shift -= x.ln();
        x += 1.0;
    }
    let r = 1.0 / (x * x);
    let series = (1.0 / 12.0 - r * (1.0 / 360.0 - r * (1.0 / 1260.0 - r * (1.0 / 1680.0 - r / 1188.0)))) / x;
    shift + (x - 0.5) * x.ln() - x + 0.5 * (2.0 * PI).ln() + series
}

/// Cells over the sphere of directions, finest around `axis`: azimuth, and s = t/(1 + t) with t = tan(θ/2)/`scale`.
#[derive(Clone, Copy, Debug)]
pub struct SphereGrid {
    x: DVec3,
    y: DVec3,
    z: DVec3,
    scale: f64,
    rows: usize,
    columns: usize,
    min_depth: u32,
}

impl SphereGrid {
    /// A grid of `rows` × `columns` cells around `axis`; half of the rows lie within tan(θ/2) < `scale`.
    pub fn new(axis: Vec3, scale: f64, rows: usize, columns: usize) -> Self {
        let z = axis.as_dvec3().normalize();
        let (x, y) = z.any_orthonormal_pair();
        SphereGrid { x, y, z, scale, rows, columns, min_depth: 1 }
    }
    /// Halves every cell at least `depth` times before the quadrature may stop: for densities with thin supports.
    pub fn with_min_depth(self, depth: u32) -> Self {
        SphereGrid { min_depth: depth, ..self }
    }
    /// Number of cells.
    pub fn len(&self) -> usize {
        self.rows * self.columns
    }
    /// Never.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// The cell of a direction.
    pub fn cell(&self, w: Vec3) -> usize {
        let w = w.as_dvec3();
        let (x, y, z) = (w.dot(self.x), w.dot(self.y), w.dot(self.z));
        let r = (x * x + y * y).sqrt();
        // tan(θ/2) = sinθ/(1 + cosθ).
        let t = r / (r.hypot(z) + z).max(1e-300) / self.scale;
        let s = if t.is_finite() { t / (1.0 + t) } else { 1.0 };
        let phi = y.atan2(x) / (2.0 * PI) + 0.5;
        let at = |v: f64, n: usize| ((v * n as f64) as usize).min(n - 1);
        at(s, self.rows) * self.columns + at(phi, self.columns)
    }
    /// Integral of `pdf` over each cell, by adaptive Gauss–Legendre quadrature to about 1e-6.
    pub fn integrate(&self, pdf: &dyn Fn(Vec3) -> f64) -> Vec<f64> {
        let density = |s: f64, v: f64| {
            let t = self.scale * s / (1.0 - s);
            let (cos, sin) = ((1.0 - t * t) / (1.0 + t * t), 2.0 * t / (1.0 + t * t));
            let phi = 2.0 * PI * (v - 0.5);
            let w = self.x * (sin * phi.cos()) + self.y * (sin * phi.sin()) + self.z * cos;
            // dω = sinθ dθ dφ, θ = 2 atan t.
            let jacobian = sin * 2.0 / (1.0 + t * t) * self.scale / (1.0 - s).powi(2) * 2.0 * PI;
            pdf(w.as_vec3()) * jacobian
        };
        let (h, k) = (1.0 / self.rows as f64, 1.0 / self.columns as f64);
        let mut cells = Vec::with_capacity(self.len());
        for row in 0..self.rows {
            for column in 0..self.columns {
                let (s, v) = (row as f64 * h, column as f64 * k);
                let whole = gauss(&density, s, v, h, k);
                // The outermost rows span most angles when the scale is small: look twice before stopping there.
                let depth = self.min_depth + if row + 2 >= self.rows { 3 } else { 0 };
                cells.push(adaptive(&density, [s, v, h, k], whole, MAX_DEPTH, MAX_DEPTH.saturating_sub(depth)));
            }
        }
        cells
    }
}

/// Product Gauss–Legendre rule of 4 × 4 points on [s, s + h] × [v, v + k].
fn gauss(f: &dyn Fn(f64, f64) -> f64, s: f64, v: f64, h: f64, k: f64) -> f64 {
    const NODES: [(f64, f64); 4] = [
        (0.069_431_844_202_973_7, 0.173_927_422_568_727),
        (0.330_009_478_207_572, 0.326_072_577_431_273),
        (0.669_990_521_792_428, 0.326_072_577_431_273),
        (0.930_568_155_797_026, 0.173_927_422_568_727),
    ];
    let mut sum = 0.0;
    for (x, wx) in NODES {
        for (y, wy) in NODES {
            sum += wx * wy * f(s + h * x, v + k * y);
        }
    }
    sum * h * k
}

/// Halves the cell [s, v, h, k] until the rule agrees with itself; `depth` levels remain, those above `free` are forced.
fn adaptive(f: &dyn Fn(f64, f64) -> f64, [s, v, h, k]: [f64; 4], whole: f64, depth: u32, free: u32) -> f64 {
    let (h, k) = (h / 2.0, k / 2.0);
    let corners = [(s, v), (s + h, v), (s, v + k), (s + h, v + k)];
    let parts = corners.map(|(a, b)| gauss(f, a, b, h, k));
    let sum: f64 = parts.iter().sum();
    let settled = depth <= free && (sum - whole).abs() <= 1e-6 + 1e-4 * sum.abs();
    if depth == 0 || settled {
        return sum;
    }
    corners.iter().zip(parts).map(|(&(a, b), p)| adaptive(f, [a, b, h, k], p, depth - 1, free)).sum()
}

/// Tests a sampling routine against its pdf: `count` calls of `sample` (`None`: no direction), where `pdf` integrates to
/// the probability of a direction, so that failures are counted in a cell of their own.
pub fn test_directions(
    grid: &SphereGrid,
    count: usize,
    mut sample: impl FnMut() -> Option<Vec3>,
    pdf: impl Fn(Vec3) -> f64,
) -> ChiSquare {
    let mut expected: Vec<f64> = grid.integrate(&pdf).iter().map(|p| p * count as f64).collect();
    let total: f64 = expected.iter().sum();
    assert!(total <= count as f64 * (1.0 + 1e-3), "the pdf integrates to {}", total / count as f64);
    // Quadrature is good to about 1e-4 of the whole: less than that is no failure probability.
    let missing = count as f64 - total;
    expected.push(if missing > 2e-4 * count as f64 { missing } else { 0.0 });
    let mut observed = vec![0.0; expected.len()];
    let mut failures = 0.0;
    for _ in 0..count {
        match sample() {
            Some(w) => observed[grid.cell(w)] += 1.0,
            None => failures += 1.0,
        }
    }
    let last = expected.len() - 1;
    observed[last] = failures;
    if expected[last] == 0.0 {
        assert!(failures < 4e-4 * count as f64 + 5.0, "{failures} of {count} samples fail unexpectedly");
        observed[last] = 0.0;
    }
    chi_square(&observed, &expected)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Quantiles of the chi² distribution from tables (Abramowitz and Stegun, table 26.8).
    #[test]
    fn p_values_match_the_tables() {
        for (degrees, x, p) in [
            (1.0, 3.84146, 0.05),
            (1.0, 10.8276, 0.001),
            (2.0, 5.99146, 0.05),
            (10.0, 18.3070, 0.05),
            (10.0, 29.5883, 0.001),
            (100.0, 124.342, 0.05),
            (30.0, 14.9535, 0.99),
        ] {
            let got = upper_gamma(degrees / 2.0, x / 2.0);
            assert!((got / p - 1.0).abs() < 1e-4, "{degrees} {x}: {got} {p}");
        }
        // Γ(½) = √π, Γ(11) = 10!.
        assert!((ln_gamma(0.5) - PI.sqrt().ln()).abs() < 1e-12);
        assert!((ln_gamma(11.0) - 3_628_800f64.ln()).abs() < 1e-11);
        assert!((sidak(0.01, 1) - 0.01).abs() < 1e-15 && (sidak(0.01, 100) - 1.005e-4).abs() < 1e-7);
    }

    #[test]
    fn small_cells_are_pooled_and_impossible_ones_reported() {
        let r = chi_square(&[1.0, 2.0, 3.0, 100.0], &[2.0, 2.0, 2.0, 100.0]);
        assert_eq!(r.degrees, 1);
        assert_eq!(r.statistic, 0.0);
        assert_eq!(chi_square(&[1.0, 99.0, 100.0], &[0.0, 100.0, 100.0]).p_value, 0.0);
    }

    /// A wrong pdf must fail, the right one pass: uniform directions against 1/(4π) and against a pdf 2 % off to a side.
    #[test]
    fn the_test_can_fail() {
        use gatherlight_render::math::{Purpose, Stream, warp};
        let grid = SphereGrid::new(Vec3::new(0.3, -0.5, 0.8), 1.0, 16, 16);
        for (tilt, passes) in [(0.0, true), (0.02, false)] {
            let mut s = Stream::new(1, Purpose::Test, 0, 0);
            let pdf = |w: Vec3| (1.0 + tilt * f64::from(w.x)) / (4.0 * PI);
            let r = test_directions(&grid, 1_000_000, || Some(warp::uniform_sphere(s.next_2d())), pdf);
            assert_eq!(r.p_value > 1e-4, passes, "{r:?}");
        }
    }

    #[test]
    fn a_narrow_lobe_is_integrated() {
        // Uniform cone of half-angle 1e-3: the pdf is a step, 1/(2π(1 − cos)).
        let (axis, theta) = (Vec3::new(0.1, 0.7, -0.2).normalize(), 1e-3f64);
        let height = 1.0 / (4.0 * PI * (theta / 2.0).sin().powi(2));
        let grid = SphereGrid::new(axis, 5e-4, 16, 8);
        let inside = |w: Vec3| w.cross(axis).length() < theta as f32 && w.dot(axis) > 0.0;
        let total: f64 = grid.integrate(&|w| if inside(w) { height } else { 0.0 }).iter().sum();
        assert!((total - 1.0).abs() < 2e-3, "{total}");
    }
}

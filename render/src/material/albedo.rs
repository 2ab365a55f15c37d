//! Directional albedo of the GGX reflection lobe with Schlick's reflectance: E(cosθ) = f0·A(cosθ, α) + f90·B(cosθ, α).
//!
//! The split into A and B is Karis's (2013, "Real Shading in Unreal Engine 4"). A smooth coat has the closed form
//! A = 1 − (1 − cosθ)⁵, B = (1 − cosθ)⁵; a rough one a table, computed on first use by deterministic quadrature.

use super::fresnel::schlick_weight;
use super::microfacet::{masking_over_cosine, sample_visible_normal, visibility};
use crate::math::ops::safe_sqrt;
use glam::Vec3;
use std::sync::OnceLock;

/// Grid points along the cosine, uniform in [0, 1].
const COSINES: usize = 64;
/// Grid points along the perceptual roughness √α, uniform in [0, 1].
const ROUGHNESSES: usize = 33;
/// Quadrature points a table entry, along each of two dimensions.
const QUADRATURE: usize = 24;

/// The pair (A, B): an albedo is f0·A + f90·B.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Split {
    /// Share of the reflectance at normal incidence.
    pub a: f32,
    /// Share of the reflectance at grazing incidence.
    pub b: f32,
}

impl Split {
    #[inline]
    fn lerp(self, o: Split, t: f32) -> Split {
        Split { a: self.a + (o.a - self.a) * t, b: self.b + (o.b - self.b) * t }
    }
}

struct Table {
    /// `entries[roughness][cosine]`.
    entries: Vec<[Split; COSINES]>,
    /// Cosine-weighted means 2∫E μ dμ of the interpolated rows.
    means: Vec<Split>,
}

/// (A, B) for cosine `cos_o` in [0, 1] and `alpha` in [0, 1]; `alpha` = 0 is the smooth lobe.
#[inline]
pub fn directional(cos_o: f32, alpha: f32) -> Split {
    if alpha == 0.0 {
        let b = schlick_weight(cos_o);
        return Split { a: 1.0 - b, b };
    }
    let t = table();
    let (row, fr) = cell(alpha.sqrt(), ROUGHNESSES);
    let (col, fc) = cell(cos_o, COSINES);
    let at = |r: usize| t.entries[r][col].lerp(t.entries[r][col + 1], fc);
    at(row).lerp(at(row + 1), fr)
}

/// Cosine-weighted mean of [`directional`] over the hemisphere: 2∫E μ dμ.
#[inline]
pub fn mean(alpha: f32) -> Split {
    if alpha == 0.0 {
        // 2∫(1 − μ)⁵ μ dμ = 1/21.
        return Split { a: 20.0 / 21.0, b: 1.0 / 21.0 };
    }
    let t = table();
    let (row, fr) = cell(alpha.sqrt(), ROUGHNESSES);
    t.means[row].lerp(t.means[row + 1], fr)
}

/// Cell index and fraction of `x` in [0, 1] on a grid of `n` points.
#[inline]
fn cell(x: f32, n: usize) -> (usize, f32) {
    let scaled = x.clamp(0.0, 1.0) * (n - 1) as f32;
    let i = (scaled as usize).min(n - 2);
    (i, scaled - i as f32)
}

fn table() -> &'static Table {
    static TABLE: OnceLock<Table> = OnceLock::new();
    TABLE.get_or_init(|| {
        let entries: Vec<_> = (0..ROUGHNESSES)
            .map(|r| {
                let roughness = r as f32 / (ROUGHNESSES - 1) as f32;
                std::array::from_fn(|c| integrate(c as f32 / (COSINES - 1) as f32, roughness * roughness))
            })
            .collect();
        let means = entries.iter().map(row_mean).collect();
        Table { entries, means }
    })
}

/// 2∫E μ dμ of a piecewise linear row, exactly.
fn row_mean(row: &[Split; COSINES]) -> Split {
    let h = 1.0 / (COSINES - 1) as f64;
    let integral = |f: &dyn Fn(usize) -> f64| -> f64 {
        (0..COSINES - 1)
            .map(|i| {
                let (m0, m1) = (i as f64 * h, (i + 1) as f64 * h);
                let (e0, e1) = (f(i), f(i + 1));
                // ∫ of the product of two linear functions over a cell.
                h / 6.0 * (2.0 * m0 * e0 + m0 * e1 + m1 * e0 + 2.0 * m1 * e1)
            })
            .sum::<f64>()
            * 2.0
    };
    Split { a: integral(&|i| f64::from(row[i].a)) as f32, b: integral(&|i| f64::from(row[i].b)) as f32 }
}

/// Quadrature over visible normals: the weight of a sampled reflection is F·G2/G1.
fn integrate(cos_o: f32, alpha: f32) -> Split {
    if alpha == 0.0 {
        return directional(cos_o, 0.0);
    }
    // At exactly grazing incidence the lobe is a limit; stay just above it.
    let c = cos_o.max(1e-4);
    let wo = Vec3::new(safe_sqrt(1.0 - c * c), 0.0, c);
    let (mut a, mut b) = (0.0f64, 0.0f64);
    for i in 0..QUADRATURE * QUADRATURE {
        let u = [(i % QUADRATURE) as f32 + 0.5, (i / QUADRATURE) as f32 + 0.5].map(|v| v * (1.0 / QUADRATURE as f32));
        let m = sample_visible_normal(wo, alpha, u);
        let wi = m * (2.0 * wo.dot(m)) - wo;
        if wi.z <= 0.0 {
            continue;
        }
        let weight = 4.0 * visibility(c, wi.z, alpha) * wi.z / masking_over_cosine(c, alpha);
        let s = schlick_weight(wo.dot(m));
        a += f64::from(weight * (1.0 - s));
        b += f64::from(weight * s);
    }
    let n = (QUADRATURE * QUADRATURE) as f64;
    Split { a: (a / n) as f32, b: (b / n) as f32 }
}

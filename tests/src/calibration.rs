//! Whether the error that a render states is its real one: many seeds of one job, against the truth.

use crate::single;
use gatherlight_render::film::{Film, Noise};
use gatherlight_render::import::SceneBundle;
use gatherlight_render::job::PreparedJob;
use gatherlight_render::settings::{Layer, RenderSettings};

/// What many seeds showed.
#[derive(Clone, Copy, Debug)]
pub struct Calibration {
    /// Share of the pixels and channels whose 95 % interval, 1.96 standard errors to each side, holds the mean of the other seeds.
    pub coverage: f64,
    /// Root mean square over seeds of the stated relative standard error, over the real one, by the spread of the seeds.
    pub noise: f64,
    /// The same of the stated total error (noise and bias), over the real one, by a reference; `None` without one.
    pub total: Option<f64>,
    /// Stated relative standard error.
    pub stated_noise: f64,
    /// Stated relative bias; 0 where none is stated.
    pub stated_bias: f64,
    /// Real relative error against the reference.
    pub real_total: Option<f64>,
    /// The same without a bound on what a pixel counts.
    pub unbounded: Option<f64>,
}

/// One seed's image with what it says of itself.
struct Image {
    values: Vec<f64>,
    errors: Vec<f64>,
    noise: f64,
    bias: f64,
}

fn channels(film: &Film, first: usize) -> Vec<f64> {
    film.pixels.chunks_exact(film.channels.len()).flat_map(|p| &p[first..first + 3]).map(|&v| f64::from(v)).collect()
}

fn render(bundle: &SceneBundle, settings: &RenderSettings) -> Image {
    let settings = RenderSettings { layers: vec![Layer::StandardError], ..settings.clone() };
    let job = PreparedJob::prepare(bundle, &settings).unwrap_or_else(|e| panic!("{e}"));
    let sums = single::accumulate(&job);
    let noise = sums.noise().map_or(f64::INFINITY, |n: Noise| n.relative);
    let bias = sums.bias().map_or(0.0, |b| b.relative);
    let film = sums.finish();
    let errors = film.channels.offset(Layer::StandardError).expect("asked for");
    Image { values: channels(&film, 0), errors: channels(&film, errors), noise, bias }
}

/// Square of `a − b` relative to `b`, or to the mean of `b` where that is greater, of each value.
fn relative_squares(a: &[f64], b: &[f64]) -> Vec<f64> {
    let floor = b.iter().sum::<f64>() / b.len() as f64;
    a.iter().zip(b).map(|(a, b)| ((a - b) / b.abs().max(floor)).powi(2)).collect()
}

/// Root of the mean of e² / (1 + e²): no value counts as more than wholly wrong.
fn bounded_error(squares: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = squares.len() as f64;
    (squares.map(|s| s / (1.0 + s)).sum::<f64>() / n).sqrt()
}

fn root_mean_square(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = values.len() as f64;
    (values.map(|v| v * v).sum::<f64>() / n).sqrt()
}

/// Renders `seeds` ≥ 3 times; `reference` has the image's pixels and channels.
pub fn calibrate(
    bundle: &SceneBundle,
    settings: &RenderSettings,
    seeds: u64,
    reference: Option<&[f64]>,
) -> Calibration {
    let images: Vec<Image> =
        (0..seeds).map(|seed| render(bundle, &RenderSettings { seed: 1 + seed, ..settings.clone() })).collect();
    let (n, count) = (seeds as f64, images[0].values.len());
    let sum: Vec<f64> = (0..count).map(|i| images.iter().map(|m| m.values[i]).sum()).collect();
    // The mean of the others has an error of its own.
    let factor = 1.96 * (1.0 + 1.0 / (n - 1.0)).sqrt();
    let covered = |m: &Image| {
        let holds = |i: &usize| (m.values[*i] - (sum[*i] - m.values[*i]) / (n - 1.0)).abs() <= factor * m.errors[*i];
        (0..count).filter(holds).count()
    };
    let mean: Vec<f64> = sum.iter().map(|s| s / n).collect();
    // The mean has a share in each image, so they differ from it by less than from the truth.
    let spread = |m: &Image| bounded_error(relative_squares(&m.values, &mean).into_iter().map(|s| s * n / (n - 1.0)));
    let stated_noise = root_mean_square(images.iter().map(|m| m.noise));
    let stated_total = root_mean_square(images.iter().map(|m| m.noise.hypot(m.bias)));
    let over_seeds = |r: &[f64], error: &dyn Fn(Vec<f64>) -> f64| {
        root_mean_square(images.iter().map(|m| error(relative_squares(&m.values, r))))
    };
    let real_total = reference.map(|r| over_seeds(r, &|s| bounded_error(s.into_iter())));
    let mean_square = |s: Vec<f64>| (s.iter().sum::<f64>() / s.len() as f64).sqrt();
    Calibration {
        coverage: images.iter().map(covered).sum::<usize>() as f64 / (n * count as f64),
        noise: stated_noise / root_mean_square(images.iter().map(spread)),
        total: real_total.map(|r| stated_total / r),
        stated_noise,
        stated_bias: root_mean_square(images.iter().map(|m| m.bias)),
        real_total,
        unbounded: reference.map(|r| over_seeds(r, &mean_square)),
    }
}

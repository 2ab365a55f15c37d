//! Whether two estimators show the same light: z-tests over blocks of an image and independent seeds.

use crate::single::render_description;
use gatherlight_render::film::Film;
use gatherlight_render::scene::description::SceneDescription;
use gatherlight_render::settings::RenderSettings;

/// Blocks along each side of the image.
const BLOCKS: u32 = 4;

/// Means over the image's 4 × 4 blocks and over the whole image, all channels, one row a seed.
pub fn block_means(scene: &SceneDescription, settings: &RenderSettings, seeds: u64) -> Vec<Vec<f64>> {
    block_means_of(settings, seeds, |settings| render_description(scene.clone(), settings))
}

/// The same of what `render` makes of the settings with each seed.
pub fn block_means_of(
    settings: &RenderSettings,
    seeds: u64,
    render: impl Fn(&RenderSettings) -> Film,
) -> Vec<Vec<f64>> {
    let seed = |seed| RenderSettings { seed: settings.seed + seed, ..settings.clone() };
    (0..seeds).map(|s| blocks(&render(&seed(s)))).collect()
}

fn blocks(film: &Film) -> Vec<f64> {
    let (width, height) = (film.grid.width, film.grid.height);
    let mut sums = vec![(0.0, 0.0); (BLOCKS * BLOCKS) as usize];
    for y in 0..height {
        for x in 0..width {
            let sum: f64 = film.pixel(x, y)[..3].iter().map(|&v| f64::from(v)).sum();
            let block = &mut sums[(y * BLOCKS / height * BLOCKS + x * BLOCKS / width) as usize];
            *block = (block.0 + sum, block.1 + 3.0);
        }
    }
    let whole = sums.iter().fold((0.0, 0.0), |w, b| (w.0 + b.0, w.1 + b.1));
    sums.iter().chain([&whole]).map(|(sum, n)| sum / n).collect()
}

/// Mean and squared standard error of column `i`.
pub fn column(rows: &[Vec<f64>], i: usize) -> (f64, f64) {
    let n = rows.len() as f64;
    let mean = rows.iter().map(|r| r[i]).sum::<f64>() / n;
    let variance = rows.iter().map(|r| (r[i] - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, variance / n)
}

/// z-test per block and of the whole over `seeds` (≥ 12) seeds a side. With 17 means and 11 degrees of freedom a side |t| < 4.6 holds for
/// all of them with probability above 0.999 when the means are equal (Šidák). `bias` is the share of the value that the
/// estimators may differ by beyond noise: 0 for two unbiased ones. A block whose joint standard error exceeds `noise` of
/// its value fails too, since it would see nothing.
///
/// # Panics
/// When they differ, or are too noisy.
pub fn assert_agree(
    name: &str,
    scene: &SceneDescription,
    [one, other]: [&RenderSettings; 2],
    seeds: u64,
    bias: f64,
    noise: f64,
) {
    let means = [one, other].map(|s| block_means(scene, s, seeds));
    assert_same(name, [one, other].map(|s| s.method.name()), &means, bias, noise);
}

/// The same test of block means that are there already, of two estimators with these names.
///
/// # Panics
/// When they differ, or are too noisy.
pub fn assert_same(name: &str, names: [&str; 2], [a, b]: &[Vec<Vec<f64>>; 2], bias: f64, noise: f64) {
    for i in 0..a[0].len() {
        let ((ma, va), (mb, vb)) = (column(a, i), column(b, i));
        let sigma = (va + vb).sqrt();
        if ma == mb && sigma == 0.0 {
            // Both know it exactly: black, or a light seen directly.
            continue;
        }
        let shown = format!(
            "{name}, block {i}: {} {ma:.5}, {} {mb:.5}, {:+.2} σ (σ = {:.2} %)",
            names[0],
            names[1],
            (ma - mb) / sigma,
            100.0 * sigma / mb
        );
        println!("{shown}");
        assert!((ma - mb).abs() <= 4.6 * sigma + bias * mb.abs(), "{shown}");
        assert!(sigma <= noise * mb, "too noisy to see anything: {shown}");
    }
}

//! What the accumulator does with single pixels.

use crate::film::sample_map::SampleMap;
use crate::film::{ChannelSet, Film, LightImage};
use crate::settings::Layer;
use rayon::prelude::*;

/// How many samples each pixel has.
#[derive(Clone, Copy)]
pub(super) struct Counts<'a>(pub(super) Option<&'a SampleMap>);

impl Counts<'_> {
    /// Those of pixel `i` when there are `even` of each, were all pixels alike.
    #[inline]
    pub(super) fn at(self, i: usize, even: u64) -> f64 {
        self.0.map_or(even, |map| map.samples(i, even)) as f64
    }
}

/// Layers that are means over hits: their sums are weighted by the share of hits, the alpha of the round.
fn is_per_hit(layer: Layer) -> bool {
    matches!(layer, Layer::Albedo | Layer::Normal | Layer::Depth | Layer::Position)
}

/// Σ w (x − m)² from Σ w x² and Σ w x, with Σ w = `samples`.
pub(super) fn between(squares: f64, values: f64, samples: f64) -> f64 {
    (squares - values * values / samples).max(0.0)
}

/// The middle one of |value| in the 3 × 3 pixels around (x, y): what a pixel is worth when it is a lucky one.
pub(super) fn median_around(value: impl Fn(usize) -> f64, [width, height]: [usize; 2], [x, y]: [usize; 2]) -> f64 {
    let mut near = [0.0f64; 9];
    for (i, v) in near.iter_mut().enumerate() {
        let (x, y) = ((x + i % 3).saturating_sub(1).min(width - 1), (y + i / 3).saturating_sub(1).min(height - 1));
        *v = value(y * width + x).abs();
    }
    near.sort_unstable_by(f64::total_cmp);
    near[4]
}

/// Adds a pixel of a round to its sums, see [`super::Sums::values`].
pub(super) fn add_pixel(sum: &mut [f64], pixel: &[f32], weight: f64, channels: &ChannelSet) {
    for (s, &v) in sum[..4].iter_mut().zip(pixel) {
        *s += weight * f64::from(v);
    }
    let mut at = 4;
    for &layer in channels.layers() {
        let end = at + layer.width();
        let weight = match layer {
            // A pixel that hit nothing has an infinite depth, which counts nothing.
            _ if is_per_hit(layer) => weight * f64::from(pixel[3]),
            Layer::Variance => weight - 1.0,
            Layer::Samples => 1.0,
            _ => weight,
        };
        if weight > 0.0 {
            sum[at..end].iter_mut().zip(&pixel[at..end]).for_each(|(s, &v)| *s += weight * f64::from(v));
        }
        at = end;
    }
}

/// The pixel that its sums make; `squares` are [`super::Sums::of_rounds`].
pub(super) fn mean_pixel(
    pixel: &mut [f32],
    sum: &[f64],
    squares: &[f64],
    [samples, rounds]: [f64; 2],
    channels: &ChannelSet,
) {
    let samples = samples.max(1.0);
    for (p, s) in pixel[..4].iter_mut().zip(sum) {
        *p = (s / samples) as f32;
    }
    let mut at = 4;
    for &layer in channels.layers() {
        let end = at + layer.width();
        for (c, (p, s)) in pixel[at..end].iter_mut().zip(&sum[at..end]).enumerate() {
            *p = match layer {
                Layer::Depth if sum[3] == 0.0 => f32::INFINITY,
                _ if is_per_hit(layer) => (s / if sum[3] > 0.0 { sum[3] } else { 1.0 }) as f32,
                // Within rounds and between them (Chan et al. 1979).
                Layer::Variance => {
                    let between = if rounds > 1.0 { between(squares[c], sum[c], samples) } else { 0.0 };
                    ((s + between) / (samples - 1.0).max(1.0)) as f32
                }
                Layer::Samples => *s as f32,
                _ => (s / samples) as f32,
            };
        }
        at = end;
    }
}

/// Adds plane 0 of `light` times `scale` to the colour.
pub(super) fn add_light(film: &mut Film, light: &LightImage, scale: f64) {
    let (width, n) = (film.grid.width, film.channels.len());
    film.pixels.par_chunks_exact_mut(n).enumerate().for_each(|(i, pixel)| {
        let value = light.value(0, i as u32 % width, i as u32 / width);
        for (p, v) in pixel[..3].iter_mut().zip(value) {
            *p = (f64::from(*p) + v * scale) as f32;
        }
    });
}

//! The film in the making: the tiles and the light images of all rounds become one film, and its noise is known.

use super::light_image::Mutations;
use super::{Bias, Blur, ChannelSet, Film, LightImage, Tile, TileError, TileGrid};
use crate::settings::Layer;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

mod restart;

/// Collects the tiles of a job's rounds, one round after the other.
///
/// The tiles of a round may come in any order. When all are there, the round is closed: its image, with what was splatted
/// in it, is added to sums in f64, in round order. A job of one round keeps nothing beyond its film.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Accumulator {
    /// The round in the making.
    film: Film,
    /// Camera samples a pixel, chains or independent rounds of each round: its weight in the mean.
    weights: Vec<u32>,
    /// Rounds in each block, between which the noise is told.
    blocks: Vec<u32>,
    closed: u32,
    /// Follows the blur of the rounds, where they have any.
    blur: Option<Blur>,
    brightness: Brightness,
    /// Of all closed rounds.
    mutations: Mutations,
    /// Sums over the closed rounds; `None` for one round.
    sums: Option<Sums>,
    /// Whether the film gets a layer of it.
    standard_error: bool,
    /// Sum of the light images, where they have more planes than the image itself.
    light: Option<LightImage>,
}

/// Sums over rounds.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Sums {
    /// In pixel and channel order: Σ w x, but Σ w α x of layers that are means over hits, Σ (w − 1) x of variances, and Σ x of
    /// counts.
    values: Vec<f64>,
    /// Of the blocks compared, whose weight is W and whose mean colour is y: Σ W y².
    squares: Vec<f64>,
    /// Blocks compared: before one that is larger than those before it, all of them become one. So they are alike, and the early ones, which
    /// are small and have few chances of rare bright samples, do not decide.
    compared: u32,
    /// Weight of the last whole block.
    last_weight: f64,
    /// Of the block in the making: Σ w x of the colour.
    block: Vec<f64>,
    /// Its weight so far.
    block_weight: f64,
    /// Rounds of it so far.
    block_rounds: u32,
    /// Whole blocks.
    blocks: u32,
    /// Of all rounds, Σ w x² of the colour, for the variance of the samples; empty where nobody asks.
    of_rounds: Vec<f64>,
}

impl Sums {
    /// Variance of the mean of channel `c` of pixel `i` with `channels` channels over `samples`; `of_all` is the relative variance of the
    /// brightness.
    fn variance_of_mean(&self, [i, c]: [usize; 2], channels: usize, samples: f64, of_all: f64) -> f64 {
        let value = self.values[i * channels + c];
        // The block in the making counts in the mean, but not in its error's estimate.
        let whole = value - self.block[i * 3 + c];
        let between = between(self.squares[i * 3 + c], whole, samples - self.block_weight);
        let mean = value / samples;
        between / (f64::from(self.compared) - 1.0) / samples + of_all * mean * mean
    }
}

/// What all pixels of an image are multiplied with, and how well it is known.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Brightness {
    /// The factor.
    pub factor: f64,
    /// Its variance over its square.
    pub relative_variance: f64,
}

impl Default for Brightness {
    /// Exactly 1.
    fn default() -> Self {
        Brightness { factor: 1.0, relative_variance: 0.0 }
    }
}

/// How far an image is from its expectation, by what its rounds differ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Root of the mean over pixels and channels of the variance of the mean, in radiance.
    pub standard_error: f64,
    /// The same with each pixel's variance divided by the square of its value, or of the image's mean where that is greater: a lamp
    /// that is seen does not outweigh all else, and dark pixels count as they are seen. Infinite for a black image with noise.
    pub relative: f64,
}

impl Accumulator {
    /// Waits for as many rounds (≥ 1) as there are `weights`, each of which is a block.
    pub fn new(grid: TileGrid, channels: ChannelSet, weights: Vec<u32>) -> Self {
        let blocks = vec![1; weights.len()];
        Self::in_blocks(grid, channels, weights, blocks)
    }

    /// Waits for as many rounds (≥ 1) as there are `weights`, in blocks of so many rounds.
    pub fn in_blocks(grid: TileGrid, channels: ChannelSet, weights: Vec<u32>, blocks: Vec<u32>) -> Self {
        let film = Film::new(grid.width, grid.height, channels);
        let values = film.pixels.len();
        let pixels = values / film.channels.len();
        let has_variance = film.channels.layers().contains(&Layer::Variance);
        let sums = || Sums {
            values: vec![0.0; values],
            squares: vec![0.0; pixels * 3],
            compared: 0,
            last_weight: 0.0,
            block: vec![0.0; pixels * 3],
            block_weight: 0.0,
            block_rounds: 0,
            blocks: 0,
            of_rounds: vec![0.0; if has_variance { pixels * 3 } else { 0 }],
        };
        let (brightness, mutations) = (Brightness::default(), Mutations::default());
        Accumulator {
            sums: (weights.len() > 1).then(sums),
            weights,
            blocks,
            closed: 0,
            blur: None,
            brightness,
            mutations,
            standard_error: false,
            light: None,
            film,
        }
    }

    /// Its rounds are blurred, those of each block on average by so much of the first one: [`Accumulator::bias`] will be known.
    pub fn with_blur(self, widths: Vec<f64>) -> Self {
        let pixels = self.film.grid.width as usize * self.film.grid.height as usize;
        Accumulator { blur: Some(Blur::new(pixels, widths)), ..self }
    }
    /// Its film will have the layer [`Layer::StandardError`].
    pub fn with_standard_error(self) -> Self {
        Accumulator { standard_error: true, ..self }
    }

    /// Adds a tile of the round in the making.
    ///
    /// # Errors
    /// When there is no such tile, its size is wrong, it is there already, or it is of another round; nothing is then changed.
    pub fn insert(&mut self, round: u32, tile: &Tile) -> Result<(), TileError> {
        if round != self.closed || round as usize >= self.weights.len() {
            return Err(TileError::Repeated(tile.index));
        }
        self.film.insert(tile)
    }

    /// Whether all tiles of the round in the making are there.
    pub fn is_round_complete(&self) -> bool {
        self.film.is_complete()
    }
    /// Blocks between which the noise is told: it has one degree of freedom less.
    pub fn compared_blocks(&self) -> u32 {
        self.sums.as_ref().map_or(0, |s| s.compared)
    }
    /// Rounds closed.
    pub fn closed_rounds(&self) -> u32 {
        self.closed
    }
    /// What the chains of the closed rounds did.
    pub fn mutations(&self) -> &Mutations {
        &self.mutations
    }
    /// What the image will be multiplied with.
    pub fn set_brightness(&mut self, brightness: Brightness) {
        self.brightness = brightness;
    }
    /// Camera samples a pixel, chains or independent rounds of the closed rounds.
    pub fn samples(&self) -> u64 {
        self.weights.iter().take(self.closed as usize).map(|&w| u64::from(w)).sum()
    }

    /// Closes the round in the making, on the current rayon pool; `light` is what was splatted in it, the sum over its camera
    /// samples.
    pub fn close(&mut self, light: Option<&LightImage>) {
        let Some(&weight) = self.weights.get(self.closed as usize) else { return };
        if let Some(light) = light {
            add_light(&mut self.film, light, 1.0 / f64::from(weight));
            if light.planes() > 1 {
                match &mut self.light {
                    None => self.light = Some(light.clone()),
                    // Of one job, so never mismatched.
                    Some(sum) => drop(sum.add(light)),
                }
            }
        }
        self.add_round(weight);
    }

    /// Closes a round that came as a light image alone: its plane 0 times `scale`, and alpha from plane 1 in its
    /// [`LightImage::unit`], or opaque where it has none. Other channels are black.
    pub fn close_splatted(&mut self, light: &LightImage, scale: f64) {
        let Some(&weight) = self.weights.get(self.closed as usize) else { return };
        let (width, n) = (self.film.grid.width, self.film.channels.len());
        let (unit, alpha) = (f64::from(light.unit()), light.planes() > 1);
        self.film.pixels.par_chunks_exact_mut(n).enumerate().for_each(|(i, pixel)| {
            let (x, y) = (i as u32 % width, i as u32 / width);
            let color = light.value(0, x, y).map(|v| (v * scale) as f32);
            pixel[..3].copy_from_slice(&color);
            pixel[3] = if alpha { (light.value(1, x, y)[0] / unit * scale) as f32 } else { 1.0 };
        });
        self.film.fill();
        self.mutations.add(light.mutations());
        self.add_round(weight);
    }

    /// Adds the round in the making, which is complete, to the sums.
    fn add_round(&mut self, weight: u32) {
        self.closed += 1;
        let samples = self.samples() as f64;
        let Some(sums) = &mut self.sums else { return };
        let rounds_of_block = self.blocks.get(sums.blocks as usize).copied().unwrap_or(u32::MAX);
        sums.block_weight += f64::from(weight);
        sums.block_rounds += 1;
        let ends_block = sums.block_rounds >= rounds_of_block;
        let (channels, n) = (&self.film.channels, self.film.channels.len());
        let (row, width) = (self.film.grid.width as usize * n, self.film.grid.width as usize);
        let (block_weight, weight) = (sums.block_weight, f64::from(weight));
        let before = samples - block_weight;
        let joins = ends_block && sums.compared > 1 && block_weight > sums.last_weight;
        let lines = self.film.pixels.par_chunks(row).zip(sums.values.par_chunks_mut(row));
        let of_rounds = sums.of_rounds.par_chunks_exact_mut(3).zip(self.film.pixels.par_chunks(n));
        of_rounds.for_each(|(squares, pixel)| {
            squares.iter_mut().zip(pixel).for_each(|(s, &v)| *s += weight * f64::from(v) * f64::from(v));
        });
        let blocks = sums.block.par_chunks_mut(width * 3).zip(sums.squares.par_chunks_mut(width * 3));
        lines.zip(blocks).for_each(|((line, sums), (block, squares))| {
            let blocks = block.chunks_exact_mut(3).zip(squares.chunks_exact_mut(3));
            for ((pixel, sum), (block, squares)) in line.chunks_exact(n).zip(sums.chunks_exact_mut(n)).zip(blocks) {
                add_pixel(sum, pixel, weight, channels);
                for c in 0..3 {
                    block[c] += weight * f64::from(pixel[c]);
                    let others = sum[c] - block[c];
                    if joins {
                        squares[c] = others * others / before;
                    }
                    if ends_block {
                        squares[c] += block[c] * block[c] / block_weight;
                    }
                }
            }
        });
        if ends_block && let Some(blur) = &mut self.blur {
            let value = |i: usize, c: usize| sums.block[i * 3 + c] / block_weight;
            blur.add(sums.blocks, block_weight, value);
        }
        if ends_block {
            sums.compared = if joins { 2 } else { sums.compared + 1 };
            sums.last_weight = block_weight;
            (sums.blocks, sums.block_weight, sums.block_rounds) = (sums.blocks + 1, 0.0, 0);
            sums.block.fill(0.0);
        }
        self.film.empty();
    }

    /// Mean of the values of all pixels and channels of the closed rounds.
    fn mean_value(&self) -> Option<f64> {
        let (sums, samples) = (self.sums.as_ref()?, self.samples() as f64);
        let (n, row) = (self.film.channels.len(), self.film.grid.width as usize);
        // Rows are summed by themselves and then in order: the same bits for any number of threads.
        let rows = sums.values.par_chunks(row * n);
        let totals: Vec<f64> =
            rows.map(|r| r.chunks_exact(n).map(|v| v[..3].iter().sum::<f64>()).sum::<f64>() / samples).collect();
        Some((totals.iter().sum::<f64>() / (sums.squares.len() as f64).max(1.0)).abs())
    }

    /// Whether its rounds are blurred, so that there is a bias.
    pub fn is_blurred(&self) -> bool {
        self.blur.is_some()
    }

    /// The bias of the mean of the closed rounds, where they are blurred and there are enough.
    pub fn bias(&self) -> Option<Bias> {
        self.blur.as_ref()?.bias(self.mean_value()?)
    }

    /// The noise of the mean of the closed rounds, by what its blocks differ; `None` for fewer than two, or for
    /// Markov chains of fewer mutations than pixels.
    pub fn noise(&self) -> Option<Noise> {
        let sums = self.sums.as_ref()?;
        let (samples, n) = (self.samples() as f64, self.film.channels.len());
        // Chains that have not even had a step for each pixel do not know what they have not seen.
        let pixels = u64::from(self.film.grid.width) * u64::from(self.film.grid.height);
        let unseen = self.mutations.total() > 0 && self.mutations.total() < pixels;
        if sums.compared < 2 || unseen {
            return None;
        }
        let size = [self.film.grid.width as usize, self.film.grid.height as usize];
        let (mean, of_all) = (self.mean_value()?, self.brightness.relative_variance);
        let row = |y: usize| {
            let mut total = [0.0; 2];
            for (x, c) in (0..size[0]).flat_map(|x| (0..3).map(move |c| (x, c))) {
                let variance = sums.variance_of_mean([y * size[0] + x, c], n, samples, of_all);
                if variance > 0.0 {
                    // The square of the true value is v² − variance in the mean: a rare bright sample is no excuse for its own
                    // noise. Not all of the variance is taken off, so that a single pixel has no more than twice its value.
                    let own = sums.values[(y * size[0] + x) * n + c] / samples;
                    let own = own * own - 0.75 * variance;
                    let near = median_around(&sums.values, size, n, [x, y], c) / samples;
                    total = [total[0] + variance, total[1] + variance / own.max(near * near).max(mean * mean)];
                }
            }
            total
        };
        let rows: Vec<[f64; 2]> = (0..size[1]).into_par_iter().map(row).collect();
        let total = rows.iter().fold([0.0; 2], |sum, r| [sum[0] + r[0], sum[1] + r[1]]);
        let count = (sums.squares.len() as f64).max(1.0);
        let [absolute, relative] = total.map(|sum| (sum / count).sqrt());
        Some(Noise { standard_error: absolute * self.brightness.factor, relative })
    }

    /// The film over the closed rounds: their mean, weighted by their samples, times the brightness; and the layers of the light
    /// images.
    pub fn finish(mut self) -> Film {
        let (samples, rounds) = (self.samples() as f64, self.closed);
        let sums = self.sums.take();
        if let Some(sums) = &sums {
            let n = self.film.channels.len();
            let channels = self.film.channels.clone();
            let pixels = self.film.pixels.par_chunks_mut(n).zip(sums.values.par_chunks(n));
            let squares = &sums.of_rounds;
            pixels.enumerate().for_each(|(i, (pixel, sum))| {
                let squares = squares.get(i * 3..i * 3 + 3).unwrap_or(&[0.0; 3]);
                mean_pixel(pixel, sum, squares, [samples, f64::from(rounds)], &channels);
            });
        }
        if self.brightness != Brightness::default() {
            let (n, factor) = (self.film.channels.len(), self.brightness.factor);
            let colors = self.film.pixels.par_chunks_mut(n).flat_map_iter(|pixel| &mut pixel[..3]);
            colors.for_each(|v| *v = (f64::from(*v) * factor) as f32);
        }
        if self.standard_error {
            let (n, width) = (ChannelSet::of_tiles(self.film.channels.layers()).len(), self.film.grid.width as usize);
            let Brightness { factor, relative_variance } = self.brightness;
            self.film.append(Layer::StandardError, |x, y, pixel| {
                let i = y as usize * width + x as usize;
                pixel.extend((0..3).map(|c| match &sums {
                    Some(sums) if sums.compared > 1 => {
                        let variance = sums.variance_of_mean([i, c], n, samples, relative_variance);
                        (factor * variance.sqrt()) as f32
                    }
                    _ => f32::INFINITY,
                }));
            });
        }
        if let Some(light) = self.light.take() {
            self.film.append(Layer::Strategies, |x, y, pixel| {
                for plane in 1..light.planes() {
                    pixel.extend(light.value(plane, x, y).map(|v| (v / samples) as f32));
                }
            });
        }
        self.film.fill();
        self.film
    }
}

/// Layers that are means over hits: their sums are weighted by the share of hits, the alpha of the round.
fn is_per_hit(layer: Layer) -> bool {
    matches!(layer, Layer::Albedo | Layer::Normal | Layer::Depth | Layer::Position)
}

/// Σ w (x − m)² from Σ w x² and Σ w x, with Σ w = `samples`.
fn between(squares: f64, values: f64, samples: f64) -> f64 {
    (squares - values * values / samples).max(0.0)
}

/// The middle one of |value| of channel `c` in the 3 × 3 pixels around (x, y): what a pixel is worth when it is a lucky one.
fn median_around(values: &[f64], [width, height]: [usize; 2], n: usize, [x, y]: [usize; 2], c: usize) -> f64 {
    let mut near = [0.0f64; 9];
    for (i, v) in near.iter_mut().enumerate() {
        let (x, y) = ((x + i % 3).saturating_sub(1).min(width - 1), (y + i / 3).saturating_sub(1).min(height - 1));
        *v = values[(y * width + x) * n + c].abs();
    }
    near.sort_unstable_by(f64::total_cmp);
    near[4]
}

fn add_pixel(sum: &mut [f64], pixel: &[f32], weight: f64, channels: &ChannelSet) {
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

fn mean_pixel(pixel: &mut [f32], sum: &[f64], squares: &[f64], [samples, rounds]: [f64; 2], channels: &ChannelSet) {
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

fn add_light(film: &mut Film, light: &LightImage, scale: f64) {
    let (width, n) = (film.grid.width, film.channels.len());
    film.pixels.par_chunks_exact_mut(n).enumerate().for_each(|(i, pixel)| {
        let value = light.value(0, i as u32 % width, i as u32 / width);
        for (p, v) in pixel[..3].iter_mut().zip(value) {
            *p = (f64::from(*p) + v * scale) as f32;
        }
    });
}

#[cfg(test)]
mod tests;

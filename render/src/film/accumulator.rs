//! The film in the making: the tiles and the light images of all rounds become one film, and its noise is known.

mod pixels;
mod restart;

use super::light_image::Mutations;
use super::relative::bounded;
use super::sample_map::{Pilot, SampleMap};
use super::standard_error;
use super::{Bias, Blur, ChannelSet, Film, LightImage, MapError, Tile, TileError, TileGrid};
use crate::settings::Layer;
use pixels::{Counts, add_light, add_pixel, between, mean_pixel, median_around};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

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
    /// Of maps that all rounds read.
    map_errors: Vec<MapError>,
    brightness: Brightness,
    /// Of all closed rounds.
    mutations: Mutations,
    /// Sums over the closed rounds; `None` for one round.
    sums: Option<Sums>,
    /// Whether the film gets a layer of it.
    standard_error: bool,
    /// Sum of the light images, where they have more planes than the image itself.
    light: Option<LightImage>,
    /// Rounds after which it is decided where the samples of the others go.
    pilot: Option<u32>,
    /// What was decided.
    sample_map: Option<SampleMap>,
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
    /// Samples, were all pixels alike, before the last whole block and after it.
    last: [u64; 2],
    /// Of all rounds, Σ w x² of the colour, for the variance of the samples; empty where nobody asks.
    of_rounds: Vec<f64>,
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

impl Brightness {
    /// What it adds to the variance of a pixel of that value, before it is multiplied with the factor.
    fn variance(self, value: f64) -> f64 {
        self.relative_variance * value * value
    }
}

/// How far an image is from its expectation, by what its rounds differ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Root of the mean over pixels and channels of the variance of the mean, in radiance.
    pub standard_error: f64,
    /// The same with each pixel's variance relative to the square of its value, or of the image's mean where that is greater: a lamp
    /// that is seen does not outweigh all else, and dark pixels count as they are seen. At most 1 of each pixel (`film/relative.rs`), of
    /// a black image with noise, too.
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
            last: [0; 2],
            of_rounds: vec![0.0; if has_variance { pixels * 3 } else { 0 }],
        };
        let (brightness, mutations) = (Brightness::default(), Mutations::default());
        Accumulator {
            sums: (weights.len() > 1).then(sums),
            weights,
            blocks,
            closed: 0,
            blur: None,
            map_errors: Vec::new(),
            brightness,
            mutations,
            standard_error: false,
            light: None,
            pilot: None,
            sample_map: None,
            film,
        }
    }

    /// Its rounds are blurred, those of each block on average by so much of the first one: [`Accumulator::bias`] will be known.
    pub fn with_blur(self, widths: Vec<f64>) -> Self {
        let pixels = self.film.grid.width as usize * self.film.grid.height as usize;
        Accumulator { blur: Some(Blur::new(pixels, widths)), ..self }
    }
    /// After so many rounds it is decided where the samples of the others go: [`Accumulator::sample_map`].
    pub fn with_pilot(self, rounds: u32) -> Self {
        Accumulator { pilot: Some(rounds), ..self }
    }
    /// Its film will have the layer [`Layer::StandardError`].
    pub fn with_standard_error(self) -> Self {
        Accumulator { standard_error: true, ..self }
    }

    /// Takes note of the error of a map that all rounds read.
    pub fn add_map_error(&mut self, error: Option<MapError>) {
        self.map_errors.extend(error);
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
    /// Where the samples of the rounds after the pilot go, once that is closed.
    pub fn sample_map(&self) -> Option<&SampleMap> {
        self.sample_map.as_ref()
    }
    /// Camera samples a pixel (on average), chains or independent rounds of the closed rounds.
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
        let before_round = self.samples();
        self.closed += 1;
        let samples = self.samples();
        let Some(sums) = &mut self.sums else { return };
        let rounds_of_block = self.blocks.get(sums.blocks as usize).copied().unwrap_or(u32::MAX);
        sums.block_weight += f64::from(weight);
        sums.block_rounds += 1;
        let ends_block = sums.block_rounds >= rounds_of_block;
        let joins = ends_block && sums.compared > 1 && sums.block_weight > sums.last_weight;
        let before_block = sums.last[1];
        let counts = Counts(self.sample_map.as_ref());
        let (channels, n) = (&self.film.channels, self.film.channels.len());
        let of_rounds = sums.of_rounds.par_chunks_exact_mut(3).zip(self.film.pixels.par_chunks(n));
        of_rounds.enumerate().for_each(|(i, (squares, pixel))| {
            let weight = counts.at(i, samples) - counts.at(i, before_round);
            squares.iter_mut().zip(pixel).for_each(|(s, &v)| *s += weight * f64::from(v) * f64::from(v));
        });
        let (row, width) = (self.film.grid.width as usize * n, self.film.grid.width as usize);
        let lines = self.film.pixels.par_chunks(row).zip(sums.values.par_chunks_mut(row));
        let blocks = sums.block.par_chunks_mut(width * 3).zip(sums.squares.par_chunks_mut(width * 3));
        lines.zip(blocks).enumerate().for_each(|(y, ((line, sums), (block, squares)))| {
            let blocks = block.chunks_exact_mut(3).zip(squares.chunks_exact_mut(3));
            let pixels = line.chunks_exact(n).zip(sums.chunks_exact_mut(n));
            for (x, ((pixel, sum), (block, squares))) in pixels.zip(blocks).enumerate() {
                let [before_block, before_round, samples] =
                    [before_block, before_round, samples].map(|even| counts.at(y * width + x, even));
                let weight = samples - before_round;
                add_pixel(sum, pixel, weight, channels);
                for c in 0..3 {
                    block[c] += weight * f64::from(pixel[c]);
                    let others = sum[c] - block[c];
                    if joins {
                        squares[c] = others * others / before_block;
                    }
                    if ends_block && samples > before_block {
                        squares[c] += block[c] * block[c] / (samples - before_block);
                    }
                }
            }
        });
        if ends_block {
            if let Some(blur) = &mut self.blur {
                let value = |i: usize, c: usize| sums.block[i * 3 + c] / sums.block_weight;
                blur.add(sums.blocks, sums.block_weight, value);
            }
            sums.compared = if joins { 2 } else { sums.compared + 1 };
            sums.last_weight = sums.block_weight;
            sums.last = [before_block, samples];
            (sums.blocks, sums.block_weight, sums.block_rounds) = (sums.blocks + 1, 0.0, 0);
            sums.block.fill(0.0);
        }
        self.film.empty();
        if self.pilot == Some(self.closed) {
            self.sample_map = self.decide();
        }
    }

    /// Where the samples of the rounds to come go, by what the closed ones differ: as for the noise by few large blocks, in which the
    /// samples are as well stratified as may be.
    fn decide(&self) -> Option<SampleMap> {
        let (sums, n, closed) = (self.sums.as_ref()?, self.film.channels.len(), self.closed as usize);
        let (samples, whole) = (self.samples() as f64, sums.last[1] as f64);
        let degrees = (f64::from(sums.compared) - 1.0).max(1.0);
        let pixel = |i: usize| {
            [0, 1, 2].map(|c| {
                let sum = sums.values[i * n + c];
                let of_blocks = sum - sums.block[i * 3 + c];
                [sum / samples, between(sums.squares[i * 3 + c], of_blocks, whole) / degrees]
            })
        };
        let pixels: Vec<_> = (0..sums.squares.len() / 3).into_par_iter().map(pixel).collect();
        let later = &self.weights[closed.min(self.weights.len())..];
        // The last block may be what is left, and smaller.
        let whole = later.split_last().map_or(later, |(_, whole)| if whole.is_empty() { later } else { whole });
        Some(SampleMap::decide(&Pilot {
            samples: self.samples() as u32,
            of: self.weights.iter().map(|&w| u64::from(w)).sum(),
            least_block: whole.iter().copied().min()?,
            width: self.film.grid.width as usize,
            pixels: &pixels,
        }))
    }

    /// Mean of the values of all pixels and channels of the closed rounds.
    fn mean_value(&self) -> Option<f64> {
        let (sums, samples, counts) = (self.sums.as_ref()?, self.samples(), self.counts());
        let (n, row) = (self.film.channels.len(), self.film.grid.width as usize);
        // Rows are summed by themselves and then in order: the same bits for any number of threads.
        let mean = |(y, values): (usize, &[f64])| {
            let pixels = values.chunks_exact(n).enumerate();
            pixels.map(|(x, v)| v[..3].iter().sum::<f64>() / counts.at(y * row + x, samples)).sum::<f64>()
        };
        let totals: Vec<f64> = sums.values.par_chunks(row * n).enumerate().map(mean).collect();
        Some((totals.iter().sum::<f64>() / (sums.squares.len() as f64).max(1.0)).abs())
    }

    fn counts(&self) -> Counts<'_> {
        Counts(self.sample_map.as_ref())
    }

    /// Variance of the mean of channel `c` of pixel `i`, by what its blocks differ, so without the brightness; infinite where nothing can be
    /// compared.
    fn variance_between(&self, sums: &Sums, [i, c]: [usize; 2]) -> f64 {
        let (n, counts) = (self.film.channels.len(), self.counts());
        let [before_last, whole, samples] = [sums.last[0], sums.last[1], self.samples()].map(|even| counts.at(i, even));
        // A small last block may have nothing of this pixel.
        let compared = sums.compared - u32::from(before_last == whole);
        if compared < 2 {
            return f64::INFINITY;
        }
        let value = sums.values[i * n + c];
        // The block in the making counts in the mean, but not in its error's estimate.
        let between = between(sums.squares[i * 3 + c], value - sums.block[i * 3 + c], whole);
        between / (f64::from(compared) - 1.0) / samples
    }

    /// Whether its rounds are blurred, so that there is a bias.
    pub fn is_blurred(&self) -> bool {
        self.blur.is_some() || !self.map_errors.is_empty()
    }

    /// The bias of the mean of the closed rounds, where they are blurred and there are enough.
    pub fn bias(&self) -> Option<Bias> {
        if let Some(blur) = &self.blur {
            return blur.bias(self.mean_value()?);
        }
        let [_, [absolute, relative]] = self.map_roots(self.mean_value()?)?;
        Some(Bias { absolute, relative })
    }

    /// Noise and bias, in radiance and relative, that maps bring into all rounds: of several the root of their sum of squares.
    fn map_roots(&self, mean: f64) -> Option<[[f64; 2]; 2]> {
        let (sums, samples, counts) = (self.sums.as_ref()?, self.samples(), self.counts());
        let (n, size) = (self.film.channels.len(), [self.film.grid.width as usize, self.film.grid.height as usize]);
        let value = |i: usize, c: usize| sums.values[i * n + c] / counts.at(i, samples);
        let scale = |i: usize, c: usize| {
            let near = median_around(|i| value(i, c), size, [i % size[0], i / size[0]]);
            value(i, c).abs().max(near).max(mean)
        };
        let roots = self.map_errors.iter().map(|e| e.roots(scale));
        roots.reduce(|a, b| [0, 1].map(|i| [0, 1].map(|j| root_of_squares(a[i][j], b[i][j]))))
    }

    /// The noise of the mean of the closed rounds, by what its blocks differ; `None` for fewer than two, or for
    /// Markov chains of fewer mutations than pixels.
    pub fn noise(&self) -> Option<Noise> {
        let sums = self.sums.as_ref()?;
        let (samples, n) = (self.samples(), self.film.channels.len());
        // Chains that have not even had a step for each pixel do not know what they have not seen.
        let pixels = u64::from(self.film.grid.width) * u64::from(self.film.grid.height);
        let unseen = self.mutations.total() > 0 && self.mutations.total() < pixels;
        if sums.compared < 2 || unseen {
            return None;
        }
        let size = [self.film.grid.width as usize, self.film.grid.height as usize];
        let (mean, counts) = (self.mean_value()?, self.counts());
        let value = |i: usize, c: usize| sums.values[i * n + c] / counts.at(i, samples);
        let row = |y: usize| {
            let mut total = [0.0; 2];
            for (x, c) in (0..size[0]).flat_map(|x| (0..3).map(move |c| (x, c))) {
                let own = value(y * size[0] + x, c);
                let variance = self.variance_between(sums, [y * size[0] + x, c]) + self.brightness.variance(own);
                if variance > 0.0 {
                    // The square of the true value is v² − variance in the mean: a rare bright sample is no excuse for its own noise, and a
                    // pixel that has only one is worth what those around it are.
                    let own = own * own - variance;
                    let near = median_around(|i| value(i, c), size, [x, y]);
                    let worth = own.max(near * near).max(mean * mean);
                    total = [total[0] + variance, total[1] + bounded(variance, worth)];
                }
            }
            total
        };
        let rows: Vec<[f64; 2]> = (0..size[1]).into_par_iter().map(row).collect();
        let total = rows.iter().fold([0.0; 2], |sum, r| [sum[0] + r[0], sum[1] + r[1]]);
        let count = (sums.squares.len() as f64).max(1.0);
        let [absolute, relative] = total.map(|sum| (sum / count).sqrt());
        let [of_maps, _] = self.map_roots(mean).unwrap_or_default();
        let standard_error = root_of_squares(absolute, of_maps[0]) * self.brightness.factor;
        Some(Noise { standard_error, relative: root_of_squares(relative, of_maps[1]) })
    }

    /// The film over the closed rounds: their mean, weighted by their samples, times the brightness; and the layers of the light
    /// images.
    pub fn finish(mut self) -> Film {
        let (samples, rounds) = (self.samples(), f64::from(self.closed));
        let errors = self.standard_error.then(|| self.standard_errors());
        if let Some(sums) = self.sums.take() {
            let (n, counts) = (self.film.channels.len(), Counts(self.sample_map.as_ref()));
            let channels = self.film.channels.clone();
            let pixels = self.film.pixels.par_chunks_mut(n).zip(sums.values.par_chunks(n));
            let squares = &sums.of_rounds;
            pixels.enumerate().for_each(|(i, (pixel, sum))| {
                let squares = squares.get(i * 3..i * 3 + 3).unwrap_or(&[0.0; 3]);
                mean_pixel(pixel, sum, squares, [counts.at(i, samples), rounds], &channels);
            });
        }
        if self.brightness != Brightness::default() {
            let (n, factor) = (self.film.channels.len(), self.brightness.factor);
            let colors = self.film.pixels.par_chunks_mut(n).flat_map_iter(|pixel| &mut pixel[..3]);
            colors.for_each(|v| *v = (f64::from(*v) * factor) as f32);
        }
        if let Some(errors) = errors {
            let width = self.film.grid.width as usize;
            self.film.append(Layer::StandardError, |x, y, pixel| pixel.extend(errors[y as usize * width + x as usize]));
        }
        if let Some(light) = self.light.take() {
            self.film.append(Layer::Strategies, |x, y, pixel| {
                for plane in 1..light.planes() {
                    pixel.extend(light.value(plane, x, y).map(|v| (v / samples as f64) as f32));
                }
            });
        }
        self.film.fill();
        self.film
    }

    /// The standard error of each pixel's channels.
    fn standard_errors(&self) -> Vec<[f32; 3]> {
        let width = self.film.grid.width as usize;
        let Some(sums) = self.sums.as_ref().filter(|s| s.compared > 1) else {
            return vec![[f32::INFINITY; 3]; width * self.film.grid.height as usize];
        };
        let (n, counts, samples) = (self.film.channels.len(), self.counts(), self.samples());
        let pixel = |i: usize| {
            let samples = counts.at(i, samples);
            standard_error::Pixel {
                value: [0, 1, 2].map(|c| sums.values[i * n + c] / samples),
                variance: [0, 1, 2].map(|c| self.variance_between(sums, [i, c])),
                samples,
            }
        };
        let pixels: Vec<_> = (0..sums.squares.len() / 3).into_par_iter().map(pixel).collect();
        let (brightness, found) = (self.brightness, standard_error::variances(&pixels, width));
        let error = |(pixel, variance): (&standard_error::Pixel, [f64; 3])| {
            [0, 1, 2].map(|c| (brightness.factor * (variance[c] + brightness.variance(pixel.value[c])).sqrt()) as f32)
        };
        pixels.iter().zip(found).map(error).collect()
    }
}

/// Of errors that are independent of each other. No platform's `hypot`, whose last bit differs.
fn root_of_squares(a: f64, b: f64) -> f64 {
    (a * a + b * b).sqrt()
}

#[cfg(test)]
mod tests;

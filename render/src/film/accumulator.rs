//! The film in the making: the tiles and the light images of all rounds become one film, and its noise is known.

use super::{ChannelSet, Film, LightImage, Tile, TileError, TileGrid};
use crate::settings::Layer;
use rayon::prelude::*;

/// Collects the tiles of a job's rounds, one round after the other.
///
/// The tiles of a round may come in any order. When all are there, the round is closed: its image, with what was splatted
/// in it, is added to sums in f64, in round order. A job of one round keeps nothing beyond its film.
#[derive(Clone, Debug)]
pub struct Accumulator {
    /// The round in the making.
    film: Film,
    /// Camera samples a pixel of each round: its weight in the mean.
    weights: Vec<u32>,
    closed: u32,
    /// Sums over the closed rounds; `None` for one round.
    sums: Option<Sums>,
    /// Sum of the light images, where they have more planes than the image itself.
    light: Option<LightImage>,
}

/// Sums over rounds.
#[derive(Clone, Debug)]
struct Sums {
    /// In pixel and channel order: Σ w x, but Σ w α x of layers that are means over hits, Σ (w − 1) x of variances, and Σ x of
    /// counts.
    values: Vec<f64>,
    /// Σ w x² of the colour.
    squares: Vec<f64>,
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
    /// Waits for the tiles of as many rounds (≥ 1) as there are `weights`.
    pub fn new(grid: TileGrid, channels: ChannelSet, weights: Vec<u32>) -> Self {
        let film = Film::new(grid.width, grid.height, channels);
        let values = film.pixels.len();
        let pixels = values / film.channels.len();
        let sums = || Sums { values: vec![0.0; values], squares: vec![0.0; pixels * 3] };
        Accumulator { sums: (weights.len() > 1).then(sums), weights, closed: 0, light: None, film }
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
    /// Camera samples a pixel of the closed rounds.
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
        self.closed += 1;
        let Some(sums) = &mut self.sums else { return };
        let (channels, n) = (&self.film.channels, self.film.channels.len());
        let (row, width) = (self.film.grid.width as usize * n, self.film.grid.width as usize);
        let lines = self.film.pixels.par_chunks(row).zip(sums.values.par_chunks_mut(row));
        lines.zip(sums.squares.par_chunks_mut(width * 3)).for_each(|((line, sums), squares)| {
            for ((pixel, sum), squares) in
                line.chunks_exact(n).zip(sums.chunks_exact_mut(n)).zip(squares.chunks_exact_mut(3))
            {
                add_pixel(sum, squares, pixel, f64::from(weight), channels);
            }
        });
        self.film.empty();
    }

    /// The noise of the mean of the closed rounds; `None` for fewer than two.
    ///
    /// Rounds share their quasi-random sequences, so they differ by more than independent ones would: the noise is not
    /// understated.
    pub fn noise(&self) -> Option<Noise> {
        let (sums, rounds) = (self.sums.as_ref()?, f64::from(self.closed));
        let samples = self.samples() as f64;
        let n = self.film.channels.len();
        if self.closed < 2 {
            return None;
        }
        let row = self.film.grid.width as usize;
        let rows = || sums.values.par_chunks(row * n).zip(sums.squares.par_chunks(row * 3));
        let count = (sums.squares.len() as f64).max(1.0);
        // Rows are summed by themselves and then in order: the same bits for any number of threads.
        let in_order = |rows: Vec<[f64; 2]>| rows.iter().fold([0.0; 2], |sum, r| [sum[0] + r[0], sum[1] + r[1]]);
        let totals = rows().map(|(values, _)| {
            let total: f64 = values.chunks_exact(n).map(|v| v[..3].iter().sum::<f64>()).sum();
            [total / samples, 0.0]
        });
        let mean = (in_order(totals.collect())[0] / count).abs();
        let variances = rows().map(|(values, squares)| {
            let pixels = values.chunks_exact(n).zip(squares.chunks_exact(3));
            pixels.fold([0.0; 2], |mut sums, (values, squares)| {
                for c in 0..3 {
                    let variance = between(squares[c], values[c], samples) / (rounds - 1.0) / samples;
                    if variance > 0.0 {
                        sums[0] += variance;
                        let value = (values[c] / samples).abs().max(mean);
                        sums[1] += variance / (value * value);
                    }
                }
                sums
            })
        });
        let [absolute, relative] = in_order(variances.collect()).map(|sum| (sum / count).sqrt());
        Some(Noise { standard_error: absolute, relative })
    }

    /// The film of whole rounds that came as a light image: colour in plane 0, alpha in plane 1 in its
    /// [`LightImage::unit`], both summed over `rounds`. Other channels are black.
    pub fn finish_rounds(mut self, light: &LightImage, rounds: u64) -> Film {
        let (width, n) = (self.film.grid.width, self.film.channels.len());
        let scale = 1.0 / rounds.max(1) as f64;
        let unit = f64::from(light.unit());
        for (i, pixel) in self.film.pixels.chunks_exact_mut(n).enumerate() {
            let (x, y) = (i as u32 % width, i as u32 / width);
            let color = light.value(0, x, y).map(|v| (v * scale) as f32);
            pixel[..3].copy_from_slice(&color);
            pixel[3] = (light.value(1, x, y)[0] / unit * scale) as f32;
        }
        self.film.fill();
        self.film
    }

    /// The film of a light image alone: its plane 0 times `scale`, opaque. Other channels are black.
    pub fn finish_opaque(mut self, light: &LightImage, scale: f64) -> Film {
        let n = self.film.channels.len();
        self.film.pixels.chunks_exact_mut(n).for_each(|pixel| pixel[3] = 1.0);
        add_light(&mut self.film, light, scale);
        self.film.fill();
        self.film
    }

    /// The film over the closed rounds: their mean, weighted by their samples; and the layers of the light images.
    pub fn finish(mut self) -> Film {
        let (samples, rounds) = (self.samples() as f64, self.closed);
        if let Some(sums) = self.sums.take() {
            let n = self.film.channels.len();
            let channels = self.film.channels.clone();
            let pixels = self.film.pixels.par_chunks_mut(n).zip(sums.values.par_chunks(n));
            pixels.zip(sums.squares.par_chunks(3)).for_each(|((pixel, sum), squares)| {
                mean_pixel(pixel, sum, squares, [samples, f64::from(rounds)], &channels);
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

fn add_pixel(sum: &mut [f64], squares: &mut [f64], pixel: &[f32], weight: f64, channels: &ChannelSet) {
    for (s, &v) in sum[..4].iter_mut().zip(pixel) {
        *s += weight * f64::from(v);
    }
    for (s, &v) in squares.iter_mut().zip(pixel) {
        *s += weight * f64::from(v) * f64::from(v);
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
mod tests {
    use super::*;
    use crate::math::Rgb;

    const GRID: TileGrid = TileGrid { width: 20, height: 5 };

    fn tile(index: u32, channels: &ChannelSet, value: impl Fn(usize) -> f32) -> Tile {
        let rect = GRID.rect(index).unwrap();
        let n = (rect.width * rect.height) as usize * channels.len();
        Tile { index, pixels: (0..n).map(|i| value(i % channels.len())).collect(), non_finite: 0, rays: 0 }
    }

    /// A round whose every pixel has these channels.
    fn round(a: &mut Accumulator, number: u32, pixel: &[f32], light: Option<&LightImage>) {
        let channels = a.film.channels.clone();
        for t in [1, 0] {
            assert!(!a.is_round_complete());
            a.insert(number, &tile(t, &channels, |c| pixel[c])).unwrap();
        }
        assert!(a.is_round_complete());
        a.close(light);
    }

    #[test]
    fn rounds_are_averaged_and_hits_weigh() {
        let channels = ChannelSet::new(&[Layer::Depth, Layer::Variance, Layer::Samples]);
        let mut a = Accumulator::new(GRID, channels, vec![1; 2]);
        // Colour 1 with a hit at depth 5, then colour 3 without one.
        round(&mut a, 0, &[1.0, 1.0, 1.0, 1.0, 5.0, 0.0, 0.0, 0.0, 1.0], None);
        assert_eq!(a.noise(), None);
        round(&mut a, 1, &[3.0, 3.0, 3.0, 0.0, f32::INFINITY, 0.0, 0.0, 0.0, 1.0], None);
        assert_eq!((a.closed_rounds(), a.samples()), (2, 2));
        // The variance of two samples is 2, that of their mean 1.
        assert_eq!(a.noise(), Some(Noise { standard_error: 1.0, relative: 0.5 }));
        let film = a.finish();
        assert!(film.is_complete());
        assert_eq!(film.pixel(19, 4), [2.0, 2.0, 2.0, 0.5, 5.0, 2.0, 2.0, 2.0, 2.0]);
    }

    /// Samples 1, 2 | 3 | 4, 5, 9, folded by rounds, against all at once: mean 4, variance 8.
    #[test]
    fn rounds_of_several_samples_weigh_by_their_number() {
        let channels = ChannelSet::new(&[Layer::Variance, Layer::Samples]);
        let mut a = Accumulator::new(GRID, channels, vec![2, 1, 3]);
        for (number, (mean, variance, n)) in [(1.5, 0.5, 2.0), (3.0, 0.0, 1.0), (6.0, 7.0, 3.0)].into_iter().enumerate()
        {
            round(&mut a, number as u32, &[mean, mean, mean, 1.0, variance, variance, variance, n], None);
        }
        // Between the rounds: 2 · 2.5² + 1 + 3 · 2² = 25.5, over 2 degrees of freedom and 6 samples.
        assert!((a.noise().unwrap().standard_error - (25.5f64 / 2.0 / 6.0).sqrt()).abs() < 1e-12);
        assert_eq!(a.finish().pixel(0, 0), [4.0, 4.0, 4.0, 1.0, 8.0, 8.0, 8.0, 6.0]);
    }

    #[test]
    fn a_tile_out_of_turn_is_refused() {
        let channels = ChannelSet::new(&[]);
        let mut a = Accumulator::new(GRID, channels.clone(), vec![1; 2]);
        let t = tile(0, &channels, |_| 1.0);
        assert_eq!(a.insert(1, &t), Err(TileError::Repeated(0)));
        a.insert(0, &t).unwrap();
        assert_eq!(a.insert(0, &t), Err(TileError::Repeated(0)));
        a.insert(0, &tile(1, &channels, |_| 1.0)).unwrap();
        a.close(None);
        assert_eq!(a.insert(0, &t), Err(TileError::Repeated(0)));
        assert!(matches!(a.insert(1, &Tile { pixels: vec![], ..t.clone() }), Err(TileError::Size { .. })));
        a.insert(1, &t).unwrap();
        a.insert(1, &tile(1, &channels, |_| 1.0)).unwrap();
        a.close(None);
        assert_eq!(a.insert(2, &t), Err(TileError::Repeated(0)));
        assert_eq!(a.insert(0, &Tile { index: 9, ..t }), Err(TileError::Repeated(9)));
    }

    #[test]
    fn light_images_count_by_the_samples_of_their_round() {
        let mut light = LightImage::new(GRID, 1, 1.0);
        light.splat(0, 19, 4, Rgb::splat(8.0));
        let mut a = Accumulator::new(GRID, ChannelSet::new(&[]), vec![4]);
        round(&mut a, 0, &[1.0; 4], Some(&light));
        let film = a.finish();
        assert_eq!(film.pixel(19, 4), [3.0, 3.0, 3.0, 1.0]);
        assert_eq!(film.pixel(18, 4), [1.0; 4]);
        let mut a = Accumulator::new(GRID, ChannelSet::new(&[]), vec![2, 2]);
        round(&mut a, 0, &[1.0; 4], Some(&light));
        round(&mut a, 1, &[1.0; 4], None);
        // One pixel of 100 has 5 and 1: variance 4 of its mean.
        assert!((a.noise().unwrap().standard_error - 0.2).abs() < 1e-12);
        assert_eq!(a.finish().pixel(19, 4), [3.0, 3.0, 3.0, 1.0]);
    }
}

//! The film in the making: tiles of all rounds and the light image become one film.

use super::{ChannelSet, Film, LightImage, Tile, TileError, TileGrid};
use crate::settings::Layer;

/// Collects the tiles of a job's rounds.
///
/// The tiles of one round may come in any order, but a tile of round r only after the same tile of round r − 1: sums are
/// folded in round order, in f64. A job of one round keeps nothing beyond its film.
#[derive(Clone, Debug)]
pub struct Accumulator {
    film: Film,
    rounds: u32,
    /// Rounds that each tile has.
    filled: Vec<u32>,
    /// Sums over rounds, in pixel and channel order; `None` for one round.
    sums: Option<Vec<f64>>,
    /// Σ x² of the colour over rounds, where the variance is asked for.
    squares: Option<Vec<f64>>,
}

impl Accumulator {
    /// Waits for `rounds` (≥ 1) tiles at each place.
    pub fn new(grid: TileGrid, channels: ChannelSet, rounds: u32) -> Self {
        let film = Film::new(grid.width, grid.height, channels);
        let values = film.pixels.len();
        let several = rounds > 1;
        let pixels = values / film.channels.len();
        let squares = several && film.channels.offset(Layer::Variance).is_some();
        Accumulator {
            rounds,
            filled: vec![0; grid.len() as usize],
            sums: several.then(|| vec![0.0; values]),
            squares: squares.then(|| vec![0.0; pixels * 3]),
            film,
        }
    }

    /// Adds a tile of `round`.
    ///
    /// # Errors
    /// When there is no such tile, its size is wrong, or it is not the next round's there; nothing is then changed.
    pub fn insert(&mut self, round: u32, tile: &Tile) -> Result<(), TileError> {
        let Some(&filled) = self.filled.get(tile.index as usize) else { return Err(TileError::Outside(tile.index)) };
        if round != filled || round >= self.rounds {
            return Err(TileError::Repeated(tile.index));
        }
        match &mut self.sums {
            None => self.film.insert(tile)?,
            Some(sums) => {
                let channels = &self.film.channels;
                let rows = self.film.rows(tile)?;
                for (at, line) in rows {
                    add_row(&mut sums[at..at + line.len()], line, channels);
                    if let Some(squares) = &mut self.squares {
                        let n = channels.len();
                        let colors = line.chunks_exact(n).flat_map(|p| &p[..3]);
                        let places = squares[at / n * 3..].iter_mut();
                        places.zip(colors).for_each(|(s, &v)| *s += f64::from(v) * f64::from(v));
                    }
                }
            }
        }
        self.filled[tile.index as usize] += 1;
        Ok(())
    }

    /// Rounds that every tile has.
    pub fn complete_rounds(&self) -> u32 {
        self.filled.iter().copied().min().unwrap_or(0)
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

    /// The film over the rounds done: the mean of the tiles, plus plane 0 of the light image times `light_scale`.
    pub fn finish(mut self, light: Option<(&LightImage, f64)>) -> Film {
        let rounds = self.complete_rounds();
        if let Some(sums) = &self.sums {
            let n = self.film.channels.len();
            let channels = self.film.channels.clone();
            for (i, (pixel, sum)) in self.film.pixels.chunks_exact_mut(n).zip(sums.chunks_exact(n)).enumerate() {
                let squares = self.squares.as_ref().map(|s| &s[i * 3..i * 3 + 3]);
                mean_pixel(pixel, sum, squares, rounds, &channels);
            }
        }
        if let Some((image, scale)) = light {
            add_light(&mut self.film, image, scale);
        }
        self.film.fill();
        self.film
    }
}

/// Layers that are means over hits: their sums are weighted by the share of hits, the alpha of the round.
fn is_per_hit(layer: Layer) -> bool {
    matches!(layer, Layer::Albedo | Layer::Normal | Layer::Depth | Layer::Position)
}

fn add_row(sums: &mut [f64], line: &[f32], channels: &ChannelSet) {
    let n = channels.len();
    for (sum, pixel) in sums.chunks_exact_mut(n).zip(line.chunks_exact(n)) {
        for (s, &v) in sum[..4].iter_mut().zip(pixel) {
            *s += f64::from(v);
        }
        let mut at = 4;
        for &layer in channels.layers() {
            let end = at + layer.width();
            // A pixel that hit nothing has an infinite depth, which counts nothing.
            let weight = if is_per_hit(layer) { f64::from(pixel[3]) } else { 1.0 };
            if weight > 0.0 {
                sum[at..end].iter_mut().zip(&pixel[at..end]).for_each(|(s, &v)| *s += weight * f64::from(v));
            }
            at = end;
        }
    }
}

fn mean_pixel(pixel: &mut [f32], sum: &[f64], squares: Option<&[f64]>, rounds: u32, channels: &ChannelSet) {
    let rounds = f64::from(rounds.max(1));
    for (p, s) in pixel[..4].iter_mut().zip(sum) {
        *p = (s / rounds) as f32;
    }
    let mut at = 4;
    for &layer in channels.layers() {
        let end = at + layer.width();
        for (c, (p, s)) in pixel[at..end].iter_mut().zip(&sum[at..end]).enumerate() {
            *p = match layer {
                Layer::Depth if sum[3] == 0.0 => f32::INFINITY,
                _ if is_per_hit(layer) => (s / if sum[3] > 0.0 { sum[3] } else { 1.0 }) as f32,
                // One sample a round: the variance of the samples is that of the rounds.
                Layer::Variance => {
                    let mean = sum[c] / rounds;
                    let second = squares.map_or(0.0, |q| q[c] / rounds);
                    ((second - mean * mean).max(0.0) * rounds / (rounds - 1.0).max(1.0)) as f32
                }
                Layer::Samples => *s as f32,
                _ => (s / rounds) as f32,
            };
        }
        at = end;
    }
}

fn add_light(film: &mut Film, light: &LightImage, scale: f64) {
    let (width, n) = (film.grid.width, film.channels.len());
    for (i, pixel) in film.pixels.chunks_exact_mut(n).enumerate() {
        let value = light.value(0, i as u32 % width, i as u32 / width);
        for (p, v) in pixel[..3].iter_mut().zip(value) {
            *p = (f64::from(*p) + v * scale) as f32;
        }
    }
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

    #[test]
    fn rounds_are_averaged_and_hits_weigh() {
        let channels = ChannelSet::new(&[Layer::Depth, Layer::Variance, Layer::Samples]);
        let mut a = Accumulator::new(GRID, channels.clone(), 2);
        // Colour 1 with a hit at depth 5, then colour 3 without one.
        let first = [1.0, 1.0, 1.0, 1.0, 5.0, 0.0, 0.0, 0.0, 1.0];
        let second = [3.0, 3.0, 3.0, 0.0, f32::INFINITY, 0.0, 0.0, 0.0, 1.0];
        for t in [1, 0] {
            a.insert(0, &tile(t, &channels, |c| first[c])).unwrap();
        }
        for t in [0, 1] {
            a.insert(1, &tile(t, &channels, |c| second[c])).unwrap();
        }
        assert_eq!(a.complete_rounds(), 2);
        let film = a.finish(None);
        assert!(film.is_complete());
        assert_eq!(film.pixel(19, 4), [2.0, 2.0, 2.0, 0.5, 5.0, 2.0, 2.0, 2.0, 2.0]);
    }

    #[test]
    fn a_tile_out_of_turn_is_refused() {
        let channels = ChannelSet::new(&[]);
        let mut a = Accumulator::new(GRID, channels.clone(), 2);
        let t = tile(0, &channels, |_| 1.0);
        assert_eq!(a.insert(1, &t), Err(TileError::Repeated(0)));
        a.insert(0, &t).unwrap();
        assert_eq!(a.insert(0, &t), Err(TileError::Repeated(0)));
        assert!(matches!(a.insert(1, &Tile { pixels: vec![], ..t.clone() }), Err(TileError::Size { .. })));
        a.insert(1, &t).unwrap();
        assert_eq!(a.insert(2, &t), Err(TileError::Repeated(0)));
        assert_eq!(a.insert(0, &Tile { index: 9, ..t }), Err(TileError::Outside(9)));
    }

    #[test]
    fn the_light_image_is_added_once_scaled() {
        let channels = ChannelSet::new(&[]);
        let mut a = Accumulator::new(GRID, channels.clone(), 1);
        (0..2).for_each(|t| a.insert(0, &tile(t, &channels, |_| 1.0)).unwrap());
        let mut light = LightImage::new(GRID, 1, 1.0);
        light.splat(0, 19, 4, Rgb::splat(8.0));
        let film = a.finish(Some((&light, 0.25)));
        assert_eq!(film.pixel(19, 4), [3.0, 3.0, 3.0, 1.0]);
        assert_eq!(film.pixel(18, 4), [1.0; 4]);
    }
}

//! Tiles: the unit of the gather pass.

use super::ChannelSet;
use crate::settings::{Layer, TILE_SIZE};
use serde::{Deserialize, Serialize};

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileRect {
    /// Left column.
    pub x: u32,
    /// Top row.
    pub y: u32,
    /// Columns, ≥ 1.
    pub width: u32,
    /// Rows, ≥ 1.
    pub height: u32,
}

/// How an image is cut into tiles, row by row from the top left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TileGrid {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
}

impl TileGrid {
    /// Number of tiles.
    pub fn len(&self) -> u32 {
        self.width.div_ceil(TILE_SIZE) * self.height.div_ceil(TILE_SIZE)
    }
    /// No tile (never for a valid image).
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// Rectangle of tile `index`; `None` when there is no such tile.
    pub fn rect(&self, index: u32) -> Option<TileRect> {
        if index >= self.len() {
            return None;
        }
        let across = self.width.div_ceil(TILE_SIZE);
        let (x, y) = (index % across * TILE_SIZE, index / across * TILE_SIZE);
        Some(TileRect { x, y, width: TILE_SIZE.min(self.width - x), height: TILE_SIZE.min(self.height - y) })
    }
}

/// The finished pixels of one tile.
#[derive(Clone, Debug, PartialEq)]
pub struct Tile {
    /// Index in the grid.
    pub index: u32,
    /// Pixel by pixel, row by row, each with [`ChannelSet::len`] floats in channel order.
    pub pixels: Vec<f32>,
    /// Samples left out because they were not finite.
    pub non_finite: u64,
    /// Rays traced.
    pub rays: u64,
}

/// The whole image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Film {
    /// How it is cut.
    pub grid: TileGrid,
    /// What each pixel holds.
    pub channels: ChannelSet,
    /// Row by row from the top, [`ChannelSet::len`] floats a pixel.
    pub pixels: Vec<f32>,
    filled: Vec<bool>,
}

/// Why a tile was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TileError {
    /// No such tile.
    #[error("tile {0} is outside the image")]
    Outside(u32),
    /// The tile is already there.
    #[error("tile {0} arrived twice")]
    Repeated(u32),
    /// The pixel array has the wrong length.
    #[error("tile {index} has {actual} floats, expected {expected}")]
    Size {
        /// The tile.
        index: u32,
        /// Floats received.
        actual: usize,
        /// Floats expected.
        expected: usize,
    },
}

impl Film {
    /// A black image that waits for its tiles.
    pub fn new(width: u32, height: u32, channels: ChannelSet) -> Self {
        let grid = TileGrid { width, height };
        Film {
            grid,
            pixels: vec![0.0; width as usize * height as usize * channels.len()],
            filled: vec![false; grid.len() as usize],
            channels,
        }
    }
    /// Copies a tile into its place.
    ///
    /// # Errors
    /// When there is no such tile, it is already there, or its size is wrong; the film is then unchanged.
    pub fn insert(&mut self, tile: &Tile) -> Result<(), TileError> {
        let rows = self.rows(tile)?;
        if std::mem::replace(&mut self.filled[tile.index as usize], true) {
            return Err(TileError::Repeated(tile.index));
        }
        for (at, line) in rows {
            self.pixels[at..at + line.len()].copy_from_slice(line);
        }
        Ok(())
    }
    /// The rows of a tile, each with the place of its first float in [`Film::pixels`].
    ///
    /// # Errors
    /// When there is no such tile, or its size is wrong.
    fn rows<'t>(&self, tile: &'t Tile) -> Result<impl Iterator<Item = (usize, &'t [f32])> + use<'t>, TileError> {
        let rect = self.grid.rect(tile.index).ok_or(TileError::Outside(tile.index))?;
        let n = self.channels.len();
        let expected = rect.width as usize * rect.height as usize * n;
        if tile.pixels.len() != expected {
            return Err(TileError::Size { index: tile.index, actual: tile.pixels.len(), expected });
        }
        let (row, width) = (rect.width as usize * n, self.grid.width as usize);
        let place = move |y: usize| ((rect.y as usize + y) * width + rect.x as usize) * n;
        Ok(tile.pixels.chunks_exact(row).enumerate().map(move |(y, line)| (place(y), line)))
    }
    /// Waits for all tiles anew.
    pub(super) fn empty(&mut self) {
        self.filled.fill(false);
    }
    /// Counts every tile as there.
    pub(super) fn fill(&mut self) {
        self.filled.fill(true);
    }
    /// Adds `layer`, whose channels at pixel (x, y) are appended to the pixel's by `write`. It must come after the layers there
    /// are, in their order.
    pub fn append(&mut self, layer: Layer, mut write: impl FnMut(u32, u32, &mut Vec<f32>)) {
        let (n, width) = (self.channels.len(), self.grid.width);
        let mut layers = self.channels.layers().to_vec();
        layers.push(layer);
        self.channels = ChannelSet::new(&layers);
        let mut pixels = Vec::with_capacity(self.pixels.len() / n * self.channels.len());
        for (i, pixel) in self.pixels.chunks_exact(n).enumerate() {
            pixels.extend_from_slice(pixel);
            write(i as u32 % width, i as u32 / width, &mut pixels);
        }
        self.pixels = pixels;
    }
    /// Whether every tile is there.
    pub fn is_complete(&self) -> bool {
        self.filled.iter().all(|&f| f)
    }
    /// The floats of pixel (x, y), in channel order.
    pub fn pixel(&self, x: u32, y: u32) -> &[f32] {
        let n = self.channels.len();
        let at = (y as usize * self.grid.width as usize + x as usize) * n;
        &self.pixels[at..at + n]
    }
}

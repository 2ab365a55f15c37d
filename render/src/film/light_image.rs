//! The light image: radiance that may land on any pixel (light paths that meet the lens, Markov chains, whole rounds),
//! summed exactly.
//!
//! Sums are in fixed point, 128 bits a value, so addition is exact and associative: the sum of all splats has the same
//! bits however the work was cut and in whatever order the parts are added. That makes `reduce` over the cluster
//! deterministic without an order (compare Demmel and Nguyen 2015, "Parallel Reproducible Summation").
//!
//! Memory is held in blocks of one tile each, made when something lands on them.

use super::TileGrid;
use crate::math::Rgb;
use crate::settings::TILE_SIZE;
use serde::{Deserialize, Serialize};

/// Bits of a value below the scale: values under 2⁻⁵⁶ of it are rounded to nearest.
const BITS_BELOW: i32 = 56;
/// Bits above it: a splat beyond 2⁴⁸ times the scale is refused. 23 bits remain for the number of splats of a pixel.
const BITS_ABOVE: i32 = 48;
/// Values of one block and plane: three channels of each pixel of a whole tile.
pub const BLOCK_VALUES: usize = (TILE_SIZE * TILE_SIZE) as usize * 3;

/// Exact sums of splats: `planes` RGB images, all in scene units of radiance times the number of samples.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightImage {
    grid: TileGrid,
    planes: u32,
    /// Exponent of the least bit: a stored integer n stands for n · 2^quantum.
    quantum: i32,
    /// By plane, then by tile; each [`BLOCK_VALUES`] long, row by row of a whole tile.
    blocks: Vec<Option<Box<[i128]>>>,
    /// Splats left out because they were not finite or beyond the range.
    non_finite: u64,
    /// Rays traced for it.
    rays: u64,
    mutations: Mutations,
}

/// What Markov chains did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Mutations {
    /// Large steps.
    pub large: u64,
    /// Of them, accepted ones.
    pub large_accepted: u64,
    /// Small steps.
    pub small: u64,
    /// Of them, accepted ones.
    pub small_accepted: u64,
    /// Σ over large steps of the proposal's luminance over the bootstrap's mean, in 2⁻⁶⁴.
    pub large_luminance: u128,
    /// Σ over large steps of its square, in 2⁻³².
    pub large_luminance_squared: u128,
}

impl Mutations {
    /// Adds what other chains did.
    pub fn add(&mut self, other: &Mutations) {
        self.large = self.large.saturating_add(other.large);
        self.large_accepted = self.large_accepted.saturating_add(other.large_accepted);
        self.small = self.small.saturating_add(other.small);
        self.small_accepted = self.small_accepted.saturating_add(other.small_accepted);
        self.large_luminance = self.large_luminance.saturating_add(other.large_luminance);
        self.large_luminance_squared = self.large_luminance_squared.saturating_add(other.large_luminance_squared);
    }
    /// Sum over the large steps of the proposal's luminance over the bootstrap's mean.
    pub fn large_sum(&self) -> f64 {
        self.large_luminance as f64 / power_of_two(64)
    }
    /// Sum over the large steps of its square.
    pub fn large_squares(&self) -> f64 {
        self.large_luminance_squared as f64 / power_of_two(32)
    }
    /// Shares of the large and the small steps that were accepted; 0 where there were none.
    pub fn acceptance(&self) -> [f64; 2] {
        [(self.large_accepted, self.large), (self.small_accepted, self.small)].map(|(a, n)| a as f64 / n.max(1) as f64)
    }
    /// All steps.
    pub fn total(&self) -> u64 {
        self.large + self.small
    }
}

/// Why two light images cannot be added.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("light images of different size, planes or scale")]
pub struct Mismatch;

impl LightImage {
    /// A black image. `scale` is the magnitude of the scene's light (its total power, say): the range kept exactly is
    /// 2⁻⁵⁶ … 2⁴⁸ times it. `planes` ≥ 1; plane 0 is the image itself.
    pub fn new(grid: TileGrid, planes: u32, scale: f32) -> Self {
        LightImage {
            grid,
            planes: planes.max(1),
            quantum: quantum_of(scale),
            blocks: vec![None; (grid.len() * planes.max(1)) as usize],
            non_finite: 0,
            rays: 0,
            mutations: Mutations::default(),
        }
    }
    /// How the image is cut.
    pub fn grid(&self) -> TileGrid {
        self.grid
    }
    /// Number of RGB planes.
    pub fn planes(&self) -> u32 {
        self.planes
    }
    /// The power of two that the scale was rounded down to: a value that is exact whatever the scale, for planes that hold
    /// no radiance.
    pub fn unit(&self) -> f32 {
        power_of_two(self.quantum + BITS_BELOW) as f32
    }
    /// Exponent of the least bit.
    pub fn quantum(&self) -> i32 {
        self.quantum
    }
    /// Splats left out.
    pub fn non_finite(&self) -> u64 {
        self.non_finite
    }
    /// Rays traced for it.
    pub fn rays(&self) -> u64 {
        self.rays
    }
    /// Counts rays.
    pub fn add_rays(&mut self, rays: u64) {
        self.rays += rays;
    }
    /// What the Markov chains that splatted on it did.
    pub fn mutations(&self) -> &Mutations {
        &self.mutations
    }
    /// Counts a mutation; `luminance` is the proposal's over the bootstrap's mean.
    pub fn count_mutation(&mut self, large: bool, accepted: bool, luminance: f64) {
        let one = if large {
            // Not finite ones become 0 or the most there is, and are counted as such elsewhere.
            let large_luminance = (luminance * power_of_two(64)) as u128;
            let large_luminance_squared = (luminance * luminance * power_of_two(32)) as u128;
            let large_accepted = u64::from(accepted);
            Mutations { large: 1, large_accepted, large_luminance, large_luminance_squared, ..Mutations::default() }
        } else {
            Mutations { small: 1, small_accepted: u64::from(accepted), ..Mutations::default() }
        };
        self.add_mutations(&one);
    }
    /// Counts mutations.
    pub fn add_mutations(&mut self, mutations: &Mutations) {
        self.mutations.add(mutations);
    }
    /// Counts splats that were left out elsewhere.
    pub fn add_non_finite(&mut self, count: u64) {
        self.non_finite += count;
    }

    /// Adds `value` to pixel (x, y) of `plane`; a pixel outside the image is ignored.
    #[inline]
    pub fn splat(&mut self, plane: u32, x: u32, y: u32, value: Rgb) {
        if x >= self.grid.width || y >= self.grid.height || plane >= self.planes || value.is_black() {
            return;
        }
        let limit = power_of_two(self.quantum + BITS_BELOW + BITS_ABOVE);
        let [r, g, b] = value.to_array().map(f64::from);
        // Also false for NaN.
        let within = r.abs() <= limit && g.abs() <= limit && b.abs() <= limit;
        if !within {
            self.non_finite += 1;
            return;
        }
        let scale = power_of_two(-self.quantum);
        let across = self.grid.width.div_ceil(TILE_SIZE);
        let block = plane * self.grid.len() + y / TILE_SIZE * across + x / TILE_SIZE;
        let at = (y % TILE_SIZE * TILE_SIZE + x % TILE_SIZE) as usize * 3;
        let values = self.blocks[block as usize].get_or_insert_with(|| vec![0; BLOCK_VALUES].into());
        for (sum, v) in values[at..at + 3].iter_mut().zip([r, g, b]) {
            *sum = sum.saturating_add((v * scale).round_ties_even() as i128);
        }
    }

    /// Adds another light image of the same job; exact, so the order does not matter.
    ///
    /// # Errors
    /// When size, planes or scale differ; nothing is then added.
    pub fn add(&mut self, other: &LightImage) -> Result<(), Mismatch> {
        if (self.grid, self.planes, self.quantum) != (other.grid, other.planes, other.quantum) {
            return Err(Mismatch);
        }
        for (mine, theirs) in self.blocks.iter_mut().zip(&other.blocks) {
            let Some(theirs) = theirs else { continue };
            match mine {
                None => *mine = Some(theirs.clone()),
                Some(mine) => mine.iter_mut().zip(theirs).for_each(|(a, b)| *a = a.saturating_add(*b)),
            }
        }
        self.non_finite += other.non_finite;
        self.rays += other.rays;
        self.mutations.add(&other.mutations);
        Ok(())
    }

    /// Sum at pixel (x, y) of `plane`.
    #[inline]
    pub fn value(&self, plane: u32, x: u32, y: u32) -> [f64; 3] {
        let across = self.grid.width.div_ceil(TILE_SIZE);
        let block = plane * self.grid.len() + y / TILE_SIZE * across + x / TILE_SIZE;
        let at = (y % TILE_SIZE * TILE_SIZE + x % TILE_SIZE) as usize * 3;
        let Some(Some(values)) = self.blocks.get(block as usize) else { return [0.0; 3] };
        let unit = power_of_two(self.quantum);
        std::array::from_fn(|c| values[at + c] as f64 * unit)
    }

    /// The blocks that something landed on: number (plane · tiles + tile) and values, in order.
    pub fn blocks(&self) -> impl Iterator<Item = (u32, &[i128])> {
        self.blocks.iter().enumerate().filter_map(|(i, b)| b.as_deref().map(|b| (i as u32, b)))
    }
    /// Puts a block in place, for decoders. `false` when there is no such block, it is there already, or its length is not
    /// [`BLOCK_VALUES`].
    pub fn insert_block(&mut self, number: u32, values: Box<[i128]>) -> bool {
        match self.blocks.get_mut(number as usize) {
            Some(slot @ None) if values.len() == BLOCK_VALUES => {
                *slot = Some(values);
                true
            }
            _ => false,
        }
    }
    /// Bytes held by its blocks.
    pub fn memory_bytes(&self) -> u64 {
        self.blocks().count() as u64 * Self::block_bytes()
    }
    /// Bytes of one block.
    pub const fn block_bytes() -> u64 {
        (BLOCK_VALUES * size_of::<i128>()) as u64
    }
}

/// Exponent of the least bit for light of magnitude `scale`; any finite scale ≥ 0 is fine.
fn quantum_of(scale: f32) -> i32 {
    // The biased exponent of an f64 is exact for every f32, subnormal ones included.
    let exponent = ((f64::from(scale).to_bits() >> 52) & 0x7ff) as i32 - 1023;
    exponent.clamp(-126, 127) - BITS_BELOW
}

/// 2^`exponent` for −1022 ≤ exponent ≤ 1023.
#[inline]
fn power_of_two(exponent: i32) -> f64 {
    f64::from_bits(((exponent + 1023) as u64) << 52)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{Purpose, Stream, ops};

    const GRID: TileGrid = TileGrid { width: 40, height: 17 };

    fn random_splats(n: usize) -> Vec<(u32, u32, Rgb)> {
        let mut s = Stream::new(1, Purpose::Test, 0, 0);
        (0..n)
            .map(|_| {
                let magnitude = ops::exp(-20.0 + 40.0 * s.next_f32());
                let v = Rgb::new(magnitude, magnitude * s.next_f32(), -magnitude * s.next_f32());
                ((s.next_f32() * 40.0) as u32, (s.next_f32() * 17.0) as u32, v)
            })
            .collect()
    }

    #[test]
    fn any_partition_and_order_gives_the_same_bits() {
        let splats = random_splats(20_000);
        let image = |splats: &[(u32, u32, Rgb)]| {
            let mut i = LightImage::new(GRID, 1, 3.0);
            splats.iter().for_each(|&(x, y, v)| i.splat(0, x, y, v));
            i
        };
        let whole = image(&splats);
        for parts in [2, 7, 100] {
            let mut sum = LightImage::new(GRID, 1, 3.0);
            splats.chunks(splats.len() / parts).rev().for_each(|c| sum.add(&image(c)).unwrap());
            assert_eq!(sum, whole);
        }
    }

    #[test]
    fn sums_are_exact_where_floats_are_not() {
        let mut i = LightImage::new(GRID, 2, 1.0);
        i.splat(1, 3, 4, Rgb::splat(1e9));
        (0..1000).for_each(|_| i.splat(1, 3, 4, Rgb::splat(0.5)));
        i.splat(1, 3, 4, Rgb::splat(-1e9));
        assert_eq!(i.value(1, 3, 4), [500.0; 3]);
        assert_eq!(i.value(0, 3, 4), [0.0; 3]);
        assert_eq!(i.blocks().count(), 1);
    }

    #[test]
    fn every_scale_has_its_range_and_what_is_beyond_is_counted() {
        for scale in [0.0f32, 1.2e-38, 1e-30, 1.0, 1e20, f32::MAX] {
            let mut i = LightImage::new(GRID, 1, scale);
            assert!(i.unit().is_normal() && (scale == 0.0 || (0.5..=1.0).contains(&(i.unit() / scale))), "{scale}");
            i.splat(0, 0, 0, Rgb::splat(scale));
            let got = i.value(0, 0, 0)[0];
            assert!((got - f64::from(scale)).abs() <= 1e-12 * f64::from(scale), "{scale} {got}");
        }
        let mut i = LightImage::new(GRID, 1, 1.0);
        for bad in [f32::NAN, f32::INFINITY, 1e15] {
            i.splat(0, 0, 0, Rgb::splat(bad));
        }
        i.splat(0, 40, 0, Rgb::WHITE);
        assert_eq!((i.non_finite(), i.blocks().count()), (3, 0));
    }

    #[test]
    fn images_of_different_jobs_are_not_added() {
        let a = LightImage::new(GRID, 1, 1.0);
        for b in [LightImage::new(GRID, 2, 1.0), LightImage::new(GRID, 1, 4.0)] {
            assert_eq!(a.clone().add(&b), Err(Mismatch));
        }
    }
}

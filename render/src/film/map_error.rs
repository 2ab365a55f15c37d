//! What is known of the error that a photon map brings into an image, at some of its pixels.

use super::relative::bounded;
use serde::{Deserialize, Serialize};

/// Products of independent measurements at some pixels: single ones may be negative, their mean is the mean square of an error.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MapError {
    /// The pixels, row by row.
    pub pixels: Vec<u32>,
    /// Of each pixel and channel, the square of the noise that the map's photons make, radiance².
    pub noise: Vec<[f64; 3]>,
    /// The square of the bias that its gather radius makes.
    pub bias: Vec<[f64; 3]>,
}

impl MapError {
    /// Roots of the means of noise and bias over pixels and channels, in radiance and relative, of each pixel at most 1, to what `scale` says of pixel and channel;
    /// 0 where the mean is negative: too little to be seen.
    pub(super) fn roots(&self, scale: impl Fn(usize, usize) -> f64) -> [[f64; 2]; 2] {
        [&self.noise, &self.bias].map(|squares| {
            let mut sums = [0.0; 2];
            for (&pixel, square) in self.pixels.iter().zip(squares) {
                for (c, &square) in square.iter().enumerate() {
                    let scale = scale(pixel as usize, c);
                    sums = [sums[0] + square, sums[1] + bounded(square, scale * scale)];
                }
            }
            sums.map(|sum| (sum / (3 * self.pixels.len()).max(1) as f64).max(0.0).sqrt())
        })
    }
}

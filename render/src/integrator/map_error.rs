//! The error of reading one set of photon maps in all passes, which no difference between passes shows.
//!
//! The photons of a map are two halves, by the hash of their numbers. What a camera sample would see with either half alone are two
//! independent estimates of the same light (a random half of a Poisson process and its rest are independent), so a quarter of the square
//! of their difference has the variance of the whole map's estimate as its expectation. Camera samples add noise of their own to the
//! difference, which is told from passes already: two independent samples, multiplied, leave only what the map makes.
//!
//! Blur grows with the square of the gather radius, to leading order (Silverman 1986, §4.2): an estimate from the nearer half of the
//! area has half of it, so twice the difference of both is the bias. One half of the photons tells it for one camera sample, the other
//! half for the other one; in their product noise has no part.

use super::photon_map::{GatherSettings, PhotonGather, Query, Reading};
use crate::film::map_error::MapError;
use crate::math::rng::mix64;
use crate::math::sobol::Sampler;
use crate::math::{Purpose, Rgb};
use crate::photon::estimate::{Gather, irradiance_by};
use crate::photon::map::PhotonMaps;
use crate::photon::precomputed;
use crate::photon::query::NeighbourBuffer;
use crate::scene::surfaces::Any;
use crate::scene::{Camera, Scene};
use crate::settings::RenderSettings;
use rayon::prelude::*;

/// One pixel is looked at for so many camera samples of the image: a small share of the work.
const SAMPLES_PER_PIXEL: u64 = 64;
/// Fewest and most pixels looked at.
const PIXELS: [u64; 2] = [256, 4096];
/// Most final-gather rays of a pixel; and how many times fewer pixels there are with them.
const FINAL_GATHER: u32 = 4;

/// Half of a map's photons, within the usual radius or within half of its area.
#[derive(Clone, Copy)]
struct Half {
    /// 0 or 1.
    number: u64,
    is_inner: bool,
}

impl Reading for Half {
    fn irradiance(&self, at: Query<'_>, buffer: &mut NeighbourBuffer) -> Rgb {
        let mut gather = *at.gather;
        if self.is_inner {
            gather = Gather { k: gather.k / 2, max_radius_squared: 0.5 * gather.max_radius_squared, ..gather };
        }
        let weight = |i: u32| if mix64(!u64::from(i)) >> 63 == self.number { 2.0 } else { 0.0 };
        irradiance_by(at.map, at.position, at.normal, &gather, buffer, weight).irradiance
    }
    fn precomputed(&self, at: Query<'_>, buffer: &mut NeighbourBuffer) -> Rgb {
        self.irradiance(Query { gather: &precomputed::effective(at.gather), ..at }, buffer)
    }
}

/// Looks at some pixels through `maps`, of which only one is there, on the current rayon pool.
pub fn measure(scene: &Scene, camera: &Camera, settings: &RenderSettings, maps: &PhotonMaps) -> MapError {
    let mut gather = GatherSettings::new(settings, maps, &scene.space);
    gather.final_gather = if maps.global.is_some() { gather.final_gather.min(FINAL_GATHER) } else { 0 };
    let pixels = u64::from(settings.width) * u64::from(settings.height);
    let wanted = (pixels * u64::from(settings.samples) / SAMPLES_PER_PIXEL).clamp(PIXELS[0], PIXELS[1]);
    let count = (wanted / u64::from(gather.final_gather.max(1))).min(pixels);
    let place = |i: u64| {
        // Somewhere in its stretch of the image, so that no pattern of rows and columns comes of it.
        let stretch = |i: u64| i * pixels / count;
        stretch(i) + mix64(i) % (stretch(i + 1) - stretch(i)).max(1)
    };
    let one = |i: u64| {
        let pixel = place(i);
        let pass = |number, is_inner, sample| {
            let reading = Half { number, is_inner };
            let mut pass =
                PhotonGather { scene, maps, settings: gather, reading, surfaces: Any, buffer: NeighbourBuffer::new() };
            let mut sampler = Sampler::new(settings.seed, Purpose::MapError, sample, pixel, 0);
            let [dx, dy] = sampler.next_2d();
            let [x, y] = [pixel % u64::from(settings.width), pixel / u64::from(settings.width)];
            let found = pass.trace(camera.ray(x as f32 + dx, y as f32 + dy), &mut sampler);
            (found.indirect + found.caustic).to_array().map(f64::from)
        };
        let whole = [0, 1].map(|sample| [0, 1].map(|half| pass(half, false, sample)));
        // One half of the photons for one sample, the other half for the other.
        let inner = [0, 1].map(|i| pass(i, true, i as u32));
        let per_channel =
            |value: &dyn Fn(usize) -> f64| [0, 1, 2].map(|c| Some(value(c)).filter(|v| v.is_finite()).unwrap_or(0.0));
        let noise = per_channel(&|c| {
            let [first, second] = [0, 1].map(|s: usize| whole[s][0][c] - whole[s][1][c]);
            0.25 * first * second
        });
        let bias = per_channel(&|c| {
            let [first, second] = [0, 1].map(|i: usize| 2.0 * (whole[i][i][c] - inner[i][c]));
            first * second
        });
        (pixel as u32, noise, bias)
    };
    let found: Vec<_> = (0..count).into_par_iter().map(one).collect();
    let mut error = MapError::default();
    for (pixel, noise, bias) in found {
        error.pixels.push(pixel);
        error.noise.push(noise);
        error.bias.push(bias);
    }
    error
}

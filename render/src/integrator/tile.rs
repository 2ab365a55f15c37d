//! The pixel and sample loop of one tile.

use super::Sample;
use crate::film::{ChannelSet, SampleMap, Tile, TileRect};
use crate::geometry::Ray;
use crate::math::sobol::Sampler;
use crate::math::{Purpose, Rgb};
use crate::scene::{Camera, SceneSpace};
use crate::settings::{Layer, RenderSettings};
use glam::Vec3;
use std::ops::Range;

/// Which camera sample of the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleId {
    /// Number of the pixel, row by row from the top left.
    pub pixel: u64,
    /// Number of the sample in its pixel.
    pub sample: u32,
}

/// Which camera samples of each pixel.
#[derive(Clone, Debug)]
pub struct Samples<'a> {
    /// Their numbers, were all pixels alike.
    pub even: Range<u32>,
    /// How they are not.
    pub map: Option<&'a SampleMap>,
}

impl Samples<'_> {
    #[inline]
    fn of(&self, pixel: u64) -> Range<u32> {
        self.map.map_or_else(|| self.even.clone(), |map| map.range(pixel as usize, &self.even))
    }
}

impl From<Range<u32>> for Samples<'_> {
    fn from(even: Range<u32>) -> Self {
        Samples { even, map: None }
    }
}

/// Renders the pixels of `rect` (tile `index`): `trace` gives the radiance of each camera sample. See [`render_numbered`].
#[allow(clippy::too_many_arguments)] // what a pixel depends on, spelled out
pub fn render(
    index: u32,
    rect: TileRect,
    settings: &RenderSettings,
    camera: &Camera,
    space: &SceneSpace,
    samples: Samples<'_>,
    mut trace: impl FnMut(Ray, &mut Sampler) -> Sample,
) -> Tile {
    render_numbered(index, rect, settings, camera, space, samples, |_, ray, sampler| trace(ray, sampler))
}

/// Renders camera samples `samples` of the pixels of `rect` (tile `index`): `trace` gives the radiance of each.
///
/// Samples of a pixel are folded in index order in f64; a sample that is not finite is counted and left out.
#[allow(clippy::too_many_arguments)] // what a pixel depends on, spelled out
pub fn render_numbered(
    index: u32,
    rect: TileRect,
    settings: &RenderSettings,
    camera: &Camera,
    space: &SceneSpace,
    samples: Samples<'_>,
    mut trace: impl FnMut(SampleId, Ray, &mut Sampler) -> Sample,
) -> Tile {
    let channels = ChannelSet::of_tiles(&settings.layers);
    let mut tile = Tile {
        index,
        pixels: Vec::with_capacity(rect.width as usize * rect.height as usize * channels.len()),
        non_finite: 0,
        rays: 0,
    };
    for y in rect.y..rect.y + rect.height {
        for x in rect.x..rect.x + rect.width {
            let pixel = u64::from(y) * u64::from(settings.width) + u64::from(x);
            let mut sums = PixelSums::default();
            for s in samples.of(pixel) {
                let mut sampler = Sampler::new(settings.seed, Purpose::Camera, 0, pixel, u64::from(s));
                let [dx, dy] = sampler.next_2d();
                let id = SampleId { pixel, sample: s };
                let sample = trace(id, camera.ray(x as f32 + dx, y as f32 + dy), &mut sampler);
                tile.rays += u64::from(sample.rays);
                tile.non_finite += u64::from(!sums.add(&sample, camera));
            }
            sums.write(&channels, space, &mut tile.pixels);
        }
    }
    tile
}

/// Running sums of one pixel's samples.
#[derive(Default)]
struct PixelSums {
    count: u32,
    hits: u32,
    parts: [[f64; 3]; 3],
    /// Mean and sum of squared differences of the radiance (Welford 1962).
    mean: [f64; 3],
    squares: [f64; 3],
    albedo: [f64; 3],
    normal: [f64; 3],
    position: [f64; 3],
    depth: f64,
}

impl PixelSums {
    /// Adds a sample; `false` when it is not finite and was left out.
    fn add(&mut self, sample: &Sample, camera: &Camera) -> bool {
        let radiance = sample.radiance();
        if !radiance.is_finite() {
            return false;
        }
        self.count += 1;
        for (sum, part) in self.parts.iter_mut().zip([sample.direct, sample.indirect, sample.caustic]) {
            accumulate(sum, part.to_array());
        }
        for (c, value) in radiance.to_array().into_iter().enumerate() {
            let delta = f64::from(value) - self.mean[c];
            self.mean[c] += delta / f64::from(self.count);
            self.squares[c] += delta * (f64::from(value) - self.mean[c]);
        }
        if let Some(first) = &sample.first {
            self.hits += 1;
            accumulate(&mut self.albedo, first.albedo.to_array());
            accumulate(&mut self.normal, first.normal.to_array());
            accumulate(&mut self.position, first.position.to_array());
            self.depth += f64::from(camera.depth(first.position));
        }
        true
    }

    fn write(&self, channels: &ChannelSet, space: &SceneSpace, out: &mut Vec<f32>) {
        let n = f64::from(self.count.max(1));
        let per_hit = |sum: [f64; 3]| sum.map(|v| v / f64::from(self.hits.max(1)));
        let [direct, indirect, caustic] = self.parts.map(|p| p.map(|v| (v / n) as f32));
        let radiance: Rgb = Rgb::from([0, 1, 2].map(|c| {
            // Summed in f64 before rounding once, so that the parts add up to the whole.
            ((self.parts[0][c] + self.parts[1][c] + self.parts[2][c]) / n) as f32
        }));
        out.extend(radiance.to_array());
        out.push((f64::from(self.hits) / n) as f32);
        for layer in channels.layers() {
            match layer {
                Layer::Direct => out.extend(direct),
                Layer::Indirect => out.extend(indirect),
                Layer::Caustic => out.extend(caustic),
                Layer::Albedo => out.extend(per_hit(self.albedo).map(|v| v as f32)),
                Layer::Normal => out.extend(per_hit(self.normal).map(|v| v as f32)),
                Layer::Depth => out.push(self.depth_in_world(space)),
                Layer::Position => out.extend(self.position_in_world(space)),
                Layer::Variance => out.extend(self.squares.map(|s| (s / (n - 1.0).max(1.0)) as f32)),
                Layer::Samples => out.push(self.count as f32),
                // Not of tiles.
                Layer::StandardError | Layer::Strategies => {}
            }
        }
    }

    /// Mean distance along the axis in world units; infinite where nothing was hit.
    fn depth_in_world(&self, space: &SceneSpace) -> f32 {
        if self.hits == 0 {
            return f32::INFINITY;
        }
        (self.depth / f64::from(self.hits) / space.scale) as f32
    }

    fn position_in_world(&self, space: &SceneSpace) -> [f32; 3] {
        if self.hits == 0 {
            return [0.0; 3];
        }
        let p = self.position.map(|v| (v / f64::from(self.hits)) as f32);
        space.to_world(Vec3::from_array(p)).as_vec3().to_array()
    }
}

fn accumulate(sum: &mut [f64; 3], value: [f32; 3]) {
    for (s, v) in sum.iter_mut().zip(value) {
        *s += f64::from(v);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn settings(layers: &[Layer]) -> RenderSettings {
        RenderSettings { width: 2, height: 1, samples: 4, layers: layers.to_vec(), ..Default::default() }
    }

    fn unit() -> (Camera, SceneSpace) {
        let space = SceneSpace { center: DVec3::ZERO, scale: 1.0, radius: 1.0 };
        let d = crate::scene::camera::framing_camera(DVec3::splat(-1.0), DVec3::splat(1.0));
        (Camera::new(&d, &space, 2, 1), space)
    }

    #[test]
    fn samples_that_are_not_finite_are_counted_and_left_out() {
        let (camera, space) = unit();
        let calls = std::cell::Cell::new(0);
        let rect = TileRect { x: 0, y: 0, width: 2, height: 1 };
        let s = settings(&[Layer::Variance, Layer::Samples]);
        let tile = render(0, rect, &s, &camera, &space, (0..4).into(), |_, _| {
            calls.set(calls.get() + 1);
            let v = if calls.get() == 3 { f32::NAN } else { calls.get() as f32 };
            Sample { direct: Rgb::splat(v), ..Default::default() }
        });
        assert_eq!(tile.non_finite, 1);
        // Pixel 0: 1, 2, 4 → mean 7/3, variance 7/3, 3 samples. Pixel 1: 5, 6, 7, 8 → 6.5, 5/3, 4.
        let close = |a: f32, b: f32| assert!((a - b).abs() < 1e-6, "{a} {b}");
        close(tile.pixels[0], 7.0 / 3.0);
        close(tile.pixels[4], 7.0 / 3.0);
        close(tile.pixels[7], 3.0);
        close(tile.pixels[8], 6.5);
        close(tile.pixels[12], 5.0 / 3.0);
        close(tile.pixels[15], 4.0);
    }
}

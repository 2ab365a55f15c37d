//! Textures: decoded images with glTF's samplers.

use crate::math::ops::powf;
use crate::scene::description::{ImageDescription, TextureDescription, TextureRef, Wrap};
use glam::Vec2;
use std::sync::Arc;

/// All textures of a scene.
#[derive(Clone, Debug)]
pub struct Textures {
    textures: Vec<TextureDescription>,
    images: Vec<ImageDescription>,
    /// Linear value of each sRGB byte.
    srgb: Arc<[f32; 256]>,
    /// Linear value of each byte as it is.
    linear: Arc<[f32; 256]>,
}

/// How a texture's colour bytes are coded; alpha is always linear.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// IEC 61966-2-1.
    Srgb,
    /// Value / 255.
    Linear,
}

/// Linear value of the sRGB-coded `v` in [0, 1] (IEC 61966-2-1).
pub fn srgb_to_linear(v: f32) -> f32 {
    if v <= 0.04045 { v / 12.92 } else { powf((v + 0.055) / 1.055, 2.4) }
}

impl Default for Textures {
    fn default() -> Self {
        Textures::new(Vec::new(), Vec::new())
    }
}

impl Textures {
    /// Takes textures and the images they name.
    pub fn new(textures: Vec<TextureDescription>, images: Vec<ImageDescription>) -> Self {
        let table = |f: &dyn Fn(f32) -> f32| Arc::new(std::array::from_fn(|i| f(i as f32 / 255.0)));
        Textures { textures, images, srgb: table(&srgb_to_linear), linear: table(&|v| v) }
    }

    /// Filtered RGBA, linear, at the texture coordinates; white where the reference leads nowhere.
    pub fn sample(&self, reference: TextureRef, uv: &[Vec2; 2], encoding: Encoding) -> [f32; 4] {
        const WHITE: [f32; 4] = [1.0; 4];
        let Some(texture) = self.textures.get(reference.texture) else { return WHITE };
        let Some(image) = self.images.get(texture.image) else { return WHITE };
        let uv = uv[reference.uv_set.min(1)];
        if image.width == 0 || image.height == 0 || !uv.is_finite() {
            return WHITE;
        }
        let (x, y) = (f64::from(uv.x) * f64::from(image.width), f64::from(uv.y) * f64::from(image.height));
        if texture.nearest {
            return self.texel(texture, image, x.floor() as i64, y.floor() as i64, encoding);
        }
        let (x, y) = (x - 0.5, y - 0.5);
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = ((x - x0) as f32, (y - y0) as f32);
        let (x0, y0) = (x0 as i64, y0 as i64);
        let t = |dx, dy| self.texel(texture, image, x0.saturating_add(dx), y0.saturating_add(dy), encoding);
        let (a, b, c, d) = (t(0, 0), t(1, 0), t(0, 1), t(1, 1));
        std::array::from_fn(|k| {
            let (top, bottom) = (a[k] + (b[k] - a[k]) * fx, c[k] + (d[k] - c[k]) * fx);
            top + (bottom - top) * fy
        })
    }

    /// Bytes held.
    pub fn memory_bytes(&self) -> usize {
        self.images.iter().map(|i| i.rgba.len()).sum()
    }

    /// Texels across the longer side of the image behind `reference`; 1 where it leads nowhere.
    pub fn resolution(&self, reference: TextureRef) -> [u32; 2] {
        self.textures
            .get(reference.texture)
            .and_then(|t| self.images.get(t.image))
            .map_or([1, 1], |i| [i.width.max(1), i.height.max(1)])
    }

    /// Whether every texel that filtering may touch for coordinates within the box from `min` to `max` is black.
    pub fn is_black_within(&self, reference: TextureRef, min: Vec2, max: Vec2) -> bool {
        let Some(texture) = self.textures.get(reference.texture) else { return false };
        let Some(image) = self.images.get(texture.image) else { return false };
        if !(min.is_finite() && max.is_finite()) {
            return false;
        }
        // A texel beyond each side for the filter; never more than one turn of a wrapped image.
        let range = |lo: f32, hi: f32, size: u32| {
            let n = f64::from(size);
            let (first, last) = ((f64::from(lo) * n).floor() as i64 - 1, (f64::from(hi) * n).floor() as i64 + 1);
            first..=last.min(first.saturating_add(2 * i64::from(size)))
        };
        let columns = range(min.x, max.x, image.width);
        range(min.y, max.y, image.height).all(|y| {
            columns.clone().all(|x| {
                let t = self.texel(texture, image, x, y, Encoding::Linear);
                t[0] == 0.0 && t[1] == 0.0 && t[2] == 0.0
            })
        })
    }

    /// One texel, linear; coordinates beyond the image wrap.
    fn texel(&self, t: &TextureDescription, i: &ImageDescription, x: i64, y: i64, encoding: Encoding) -> [f32; 4] {
        let (x, y) = (wrap(x, i.width, t.wrap_u), wrap(y, i.height, t.wrap_v));
        let start = 4 * (y * i.width as usize + x);
        let Some(rgba) = i.rgba.get(start..start + 4) else { return [1.0; 4] };
        let table = match encoding {
            Encoding::Srgb => &self.srgb,
            Encoding::Linear => &self.linear,
        };
        let at = |k: usize| table[usize::from(rgba[k])];
        [at(0), at(1), at(2), self.linear[usize::from(rgba[3])]]
    }
}

/// Index into `size` texels after wrapping.
fn wrap(x: i64, size: u32, mode: Wrap) -> usize {
    let n = i64::from(size);
    let wrapped = match mode {
        Wrap::Repeat => x.rem_euclid(n),
        Wrap::ClampToEdge => x.clamp(0, n - 1),
        Wrap::MirroredRepeat => {
            let r = x.rem_euclid(2 * n);
            if r < n { r } else { 2 * n - 1 - r }
        }
    };
    wrapped as usize
}

//! Images of other renderers: `tests/reference/*.exr`, made as its README says.

use gatherlight_render::export::exr_read::decode;
use gatherlight_render::film::compare::compare;
use gatherlight_render::math::Rgb;
use std::path::Path;

/// Pixels across and down.
pub const SIDE: u32 = 256;

/// Width, height and pixels, rows from the top, of the image of the scene `name`.
///
/// # Panics
/// When it cannot be read.
pub fn image(name: &str) -> (u32, u32, Vec<Rgb>) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("reference").join(name).with_extension("exr");
    let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let image = decode(&bytes).unwrap_or_else(|e| panic!("{e}"));
    let pixels = image.rgb().unwrap_or_else(|e| panic!("{e}"));
    (image.width as u32, image.height as u32, pixels)
}

/// The pixels of an image that is [`SIDE`] wide and high.
///
/// # Panics
/// When it is not, or cannot be read.
pub fn reference(name: &str) -> Vec<Rgb> {
    let (width, height, pixels) = image(name);
    assert_eq!((width, height), (SIDE, SIDE));
    pixels
}

/// Width, height and values of the image of the scene `name`, all channels of a pixel after the other, as means of blocks of its
/// pixels: `width` divides its width.
///
/// # Panics
/// When it cannot be read.
pub fn reduced(name: &str, width: u32) -> (u32, u32, Vec<f64>) {
    let (whole_width, whole_height, pixels) = image(name);
    let factor = whole_width / width;
    let height = whole_height / factor;
    let mut sums = vec![0.0; (width * height * 3) as usize];
    for (i, pixel) in pixels.iter().enumerate() {
        let (x, y) = (i as u32 % whole_width / factor, i as u32 / whole_width / factor);
        for (c, v) in pixel.to_array().into_iter().enumerate() {
            sums[((y * width + x) * 3) as usize + c] += f64::from(v) / f64::from(factor * factor);
        }
    }
    (width, height, sums)
}

/// The image made of the means of blocks of `factor` × `factor` pixels of an image of [`SIDE`].
pub fn block_means(pixels: &[Rgb], factor: u32) -> Vec<Rgb> {
    let side = SIDE / factor;
    let weight = 1.0 / (factor * factor) as f32;
    (0..side * side)
        .map(|i| {
            let (x, y) = (i % side * factor, i / side * factor);
            let block = (0..factor * factor).map(|j| pixels[((y + j / factor) * SIDE + x + j % factor) as usize]);
            block.sum::<Rgb>() * weight
        })
        .collect()
}

/// How far an image is from a reference.
#[derive(Clone, Copy, Debug)]
pub struct Errors {
    /// Mean of (a − r)² / (r² + 0.01).
    pub relative_mse: f64,
    /// Difference of the means, relative to the reference's.
    pub bias: f64,
}

/// Compares square images of equal size and prints the result under `name`.
///
/// # Panics
/// When they are not.
pub fn against(name: &str, pixels: &[Rgb], reference: &[Rgb]) -> Errors {
    let side = (pixels.len() as f64).sqrt() as usize;
    let c = compare((side, side, pixels), (side, side, reference)).unwrap_or_else(|e| panic!("{e}"));
    let errors = Errors { relative_mse: c.relative_mse, bias: c.bias.unwrap_or(f64::NAN) };
    println!("{name}: relMSE {:.2e}, bias {:+.3} %", errors.relative_mse, errors.bias * 100.0);
    errors
}

//! A tone-mapped preview as PNG.
//!
//! One operator, without settings: exposure puts the 90th percentile of luminance at 0.9, highlights roll off by
//! Reinhard's curve with a white point (Reinhard et al. 2002, eq. 4) on luminance so that hues stay, then sRGB, 8 bits.
//! A pure function of the pixels.

use crate::error::ImageError;
use crate::math::{Rgb, ops};
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};

/// Share of the pixels that are darker than the one that sets the exposure.
const EXPOSURE_PERCENTILE: f64 = 0.9;
/// Luminance that pixel gets before the roll-off.
const EXPOSURE_TARGET: f32 = 0.9;
/// Exposed luminance that becomes pure white: above, everything clips.
const WHITE_POINT: f32 = 6.0;

/// The preview of `pixels` (linear Rec.709, `width × height`, row by row from the top) as the bytes of a PNG file.
///
/// # Errors
/// [`ImageError::Png`] when the pixels are not `width × height`.
pub fn preview(width: u32, height: u32, pixels: &[Rgb]) -> Result<Vec<u8>, ImageError> {
    let exposure = exposure(pixels);
    let bytes: Vec<u8> = pixels.iter().flat_map(|&p| tone_map(p, exposure)).collect();
    encode_rgb8(width, height, &bytes)
}

/// 8-bit sRGB triples as the bytes of a PNG file.
///
/// # Errors
/// [`ImageError::Png`] when there are not `3 × width × height` bytes.
pub fn encode_rgb8(width: u32, height: u32, rgb: &[u8]) -> Result<Vec<u8>, ImageError> {
    if rgb.len() as u64 != 3 * u64::from(width) * u64::from(height) {
        return Err(ImageError::Png(format!("{} bytes for {width} × {height} pixels", rgb.len())));
    }
    let mut png = Vec::new();
    let encoder = PngEncoder::new(&mut png);
    encoder.write_image(rgb, width, height, ExtendedColorType::Rgb8).map_err(|e| ImageError::Png(e.to_string()))?;
    Ok(png)
}

fn usable(p: Rgb) -> Rgb {
    p.map(|v| if v.is_finite() { v.max(0.0) } else { 0.0 })
}

/// Factor on radiance; 1 for a black image.
fn exposure(pixels: &[Rgb]) -> f32 {
    let mut luminances: Vec<f32> =
        pixels.iter().map(|&p| usable(p).luminance()).filter(|&l| l > 0.0 && l.is_finite()).collect();
    if luminances.is_empty() {
        return 1.0;
    }
    let at = ((luminances.len() - 1) as f64 * EXPOSURE_PERCENTILE) as usize;
    let (_, &mut key, _) = luminances.select_nth_unstable_by(at, f32::total_cmp);
    // A tiny key would make the factor infinite.
    EXPOSURE_TARGET / key.max(f32::MIN_POSITIVE * 4.0)
}

fn tone_map(pixel: Rgb, exposure: f32) -> [u8; 3] {
    let exposed = usable(usable(pixel) * exposure);
    let l = exposed.luminance();
    let mapped = if l > 0.0 {
        // In the order that cannot overflow: L' / L = (1 + L / white²) / (1 + L).
        exposed * ((1.0 + l / (WHITE_POINT * WHITE_POINT)) / (1.0 + l))
    } else {
        exposed
    };
    mapped.to_array().map(|v| (srgb(v.clamp(0.0, 1.0)) * 255.0 + 0.5) as u8)
}

/// IEC 61966-2-1 transfer function.
fn srgb(v: f32) -> f32 {
    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * ops::powf(v, 1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decoded(png: &[u8]) -> Vec<u8> {
        image::load_from_memory(png).unwrap().to_rgb8().into_raw()
    }

    #[test]
    fn exposure_does_not_depend_on_the_unit_of_light() {
        let ramp: Vec<Rgb> = (0..64).map(|i| Rgb::new(i as f32, 0.5 * i as f32, 1.0)).collect();
        let brighter: Vec<Rgb> = ramp.iter().map(|&p| p * 1_048_576.0).collect();
        assert_eq!(preview(8, 8, &ramp).unwrap(), preview(8, 8, &brighter).unwrap());
    }

    #[test]
    fn the_curve_rises_and_ends_at_white() {
        let ramp: Vec<u8> = (0..1000).map(|i| tone_map(Rgb::splat(i as f32 * 0.01), 1.0)[1]).collect();
        assert!(ramp.windows(2).all(|w| w[0] <= w[1]));
        assert_eq!(ramp[0], 0);
        assert_eq!(tone_map(Rgb::splat(WHITE_POINT), 1.0), [255; 3]);
        assert!(tone_map(Rgb::splat(WHITE_POINT * 0.8), 1.0)[0] < 255);
        // The exposed key: 0.6 (1 + 0.6/36) / 1.6 = 0.38125 → sRGB 0.6526.
        assert_eq!(tone_map(Rgb::splat(0.6), 1.0), [166; 3]);
    }

    #[test]
    fn any_float_gives_a_picture() {
        let odd = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, f32::MAX, 1e-45, 0.0, 1.0].map(Rgb::splat);
        assert_eq!(decoded(&preview(4, 2, &odd).unwrap()).len(), 24);
        assert_eq!(decoded(&preview(2, 1, &[Rgb::BLACK; 2]).unwrap()), [0; 6]);
        assert!(preview(3, 1, &[Rgb::BLACK; 2]).is_err());
    }
}

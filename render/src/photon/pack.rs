//! Packed photon fields: powers as RGBE, normals and directions as octahedral codes.
//!
//! All of it is plain IEEE arithmetic (add, multiply, divide, square root), so a code has the same bits on every machine.

use crate::math::Rgb;
use glam::Vec3;

/// Largest biased exponent of an RGBE code; decoded values stay finite.
const MAX_EXPONENT: u32 = 254;

/// Packs a power, irradiance or radiance: three 8-bit mantissas (red lowest) under one 8-bit exponent, rounded to nearest
/// (after Ward 1991, which truncates and so loses 0.4 % of the light).
///
/// The error of each channel is at most 1/255 of the largest channel (rms 0.17 %) from 2⁻¹²⁶ to the largest f32. Smaller
/// values fade out in steps of 2⁻¹³³. Negative and NaN channels count as 0, infinite ones as the largest code.
/// Black, and only what rounds to black, is 0.
#[inline]
pub fn encode_rgbe(v: Rgb) -> u32 {
    // Not `clamp`: `max` takes NaN to 0.
    #[allow(clippy::manual_clamp)]
    let [r, g, b] = v.to_array().map(|c| c.max(0.0).min(f32::MAX));
    let largest = r.max(g).max(b);
    let mut exponent = (largest.to_bits() >> 23).max(1);
    if quantise(largest, exponent) > 255 && exponent < MAX_EXPONENT {
        exponent += 1;
    }
    let [r, g, b] = [r, g, b].map(|c| quantise(c, exponent).min(255));
    if r | g | b == 0 { 0 } else { exponent << 24 | b << 16 | g << 8 | r }
}

/// Mantissa of `c` under a biased exponent in 1 … 254: `c` · 2^(134 − exponent), rounded to nearest.
#[inline]
fn quantise(c: f32, exponent: u32) -> u32 {
    let scale = f64::from_bits(u64::from(1023 + 134 - exponent) << 52);
    (f64::from(c) * scale + 0.5) as u32
}

/// The inverse of [`encode_rgbe`]. Total: every code decodes to finite values ≥ 0 except exponent 255, which no encoder
/// writes and which decodes as exponent 254.
#[inline]
pub fn decode_rgbe(code: u32) -> Rgb {
    let exponent = (code >> 24).min(MAX_EXPONENT);
    // Mantissa · 2⁻⁷ < 2 first, then the power of two: no intermediate overflows, and exponent 0 is 0.
    let power = f32::from_bits(exponent << 23);
    let channel = |shift: u32| (code >> shift & 255) as f32 * (1.0 / 128.0) * power;
    Rgb::new(channel(0), channel(8), channel(16))
}

/// Packs a unit vector into 2 × 8 bits (octahedral map, Cigolle et al. 2014, "oct16P"): error ≤ 0.7°, axes exact.
#[inline]
pub fn encode_normal(n: Vec3) -> u16 {
    let [x, y] = encode_oct::<127>(n);
    ((y + 128) as u16) << 8 | (x + 128) as u16
}

/// The inverse of [`encode_normal`]; unit length, for every code.
#[inline]
pub fn decode_normal(code: u16) -> Vec3 {
    let [x, y] = [i32::from(code & 255) - 128, i32::from(code >> 8) - 128];
    decode_oct::<127>(x.max(-127), y.max(-127))
}

/// Packs a unit vector into 2 × 16 bits (octahedral, "oct32P"): error ≤ 0.003°, axes exact.
#[inline]
pub fn encode_direction(d: Vec3) -> u32 {
    let [x, y] = encode_oct::<32767>(d);
    ((y + 32768) as u32) << 16 | (x + 32768) as u32
}

/// The inverse of [`encode_direction`]; unit length, for every code.
#[inline]
pub fn decode_direction(code: u32) -> Vec3 {
    let [x, y] = [(code & 0xffff) as i32 - 32768, (code >> 16) as i32 - 32768];
    decode_oct::<32767>(x.max(-32767), y.max(-32767))
}

/// Octahedral coordinates of `v` in [−MAX, MAX]²: of the four grid points around it the one that decodes nearest.
/// The zero vector and NaN give the +z axis.
#[inline]
fn encode_oct<const MAX: i32>(v: Vec3) -> [i32; 2] {
    let l1 = v.x.abs() + v.y.abs() + v.z.abs();
    if !(l1 > 0.0 && l1 < f32::INFINITY) {
        return [0, 0];
    }
    let (mut x, mut y) = (v.x / l1, v.y / l1);
    if v.z < 0.0 {
        (x, y) = ((1.0 - y.abs()).copysign(x), (1.0 - x.abs()).copysign(y));
    }
    let unit = (v / l1) * (1.0 / (v / l1).length());
    let (fx, fy) = ((x * MAX as f32).floor(), (y * MAX as f32).floor());
    let (mut best, mut best_error) = ([0, 0], f32::INFINITY);
    for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let (cx, cy) = ((fx as i32 + dx).clamp(-MAX, MAX), (fy as i32 + dy).clamp(-MAX, MAX));
        let error = (decode_oct::<MAX>(cx, cy) - unit).length_squared();
        if error < best_error {
            (best, best_error) = ([cx, cy], error);
        }
    }
    best
}

#[inline]
fn decode_oct<const MAX: i32>(x: i32, y: i32) -> Vec3 {
    let (x, y) = (x as f32, y as f32);
    let z = MAX as f32 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    let v = Vec3::new(x - fold.copysign(x), y - fold.copysign(y), z);
    v * (1.0 / v.length_squared().sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{Purpose, Stream, ops, warp};

    fn random_power(s: &mut Stream) -> Rgb {
        // Log-uniform over the whole range of normal numbers, with unlike channels.
        let largest = ops::exp(-87.0 + 175.0 * s.next_f32());
        Rgb::new(largest, largest * s.next_f32(), largest * s.next_f32())
    }

    #[test]
    fn rgbe_error_is_bounded_over_the_whole_range() {
        let mut s = Stream::new(1, Purpose::Test, 0, 0);
        for _ in 0..1_000_000 {
            let v = random_power(&mut s);
            let d = decode_rgbe(encode_rgbe(v));
            for c in 0..3 {
                let error = (f64::from(d[c]) - f64::from(v[c])).abs() / f64::from(v.max_component());
                assert!(error <= 1.0 / 255.0, "{v:?} {d:?}");
            }
        }
    }

    #[test]
    fn rgbe_is_unbiased() {
        let mut s = Stream::new(2, Purpose::Test, 0, 0);
        let (n, mut sum, mut squares) = (2_000_000, 0.0f64, 0.0f64);
        for _ in 0..n {
            let v = random_power(&mut s);
            let error = f64::from(decode_rgbe(encode_rgbe(v)).r) / f64::from(v.r) - 1.0;
            sum += error;
            squares += error * error;
        }
        let n = f64::from(n);
        let (mean, deviation) = (sum / n, (squares / n).sqrt());
        assert!(deviation < 0.002, "rms {deviation}");
        // Rounding to nearest under a log-uniform law: a bias of order (1/256)²/12 ≈ 1.3e-6 beside the noise.
        assert!(mean.abs() < 4.5 * deviation / n.sqrt() + 3e-6, "bias {mean}");
    }

    #[test]
    fn rgbe_edges() {
        assert_eq!(encode_rgbe(Rgb::BLACK), 0);
        assert_eq!(decode_rgbe(0), Rgb::BLACK);
        for v in [1e-38f32, 1.2e-38, 1e-30, 1.0, 0.999_999_94, 255.5, 1e38, f32::MAX, f32::INFINITY] {
            let d = decode_rgbe(encode_rgbe(Rgb::splat(v))).r;
            let v = v.min(f32::MAX);
            assert!(d.is_finite() && (f64::from(d) / f64::from(v) - 1.0).abs() < 0.005, "{v} {d}");
        }
        assert_eq!(decode_rgbe(encode_rgbe(Rgb::new(f32::NAN, -1.0, 2.0))), Rgb::new(0.0, 0.0, 2.0));
        assert_eq!(encode_rgbe(Rgb::splat(1e-45)), 0);
        for code in (0..=u32::MAX).step_by(9973) {
            assert!(decode_rgbe(code).is_finite());
        }
    }

    #[test]
    fn rgbe_codes_are_fixed_points() {
        let mut s = Stream::new(3, Purpose::Test, 0, 0);
        for _ in 0..100_000 {
            let code = encode_rgbe(random_power(&mut s));
            assert_eq!(encode_rgbe(decode_rgbe(code)), code);
        }
    }

    #[test]
    fn octahedral_error_is_bounded() {
        let mut s = Stream::new(4, Purpose::Test, 0, 0);
        let (mut normal, mut direction) = (0.0f32, 0.0f32);
        for _ in 0..500_000 {
            let v = warp::uniform_sphere(s.next_2d());
            // The chord is the angle to within its cube.
            normal = normal.max((decode_normal(encode_normal(v)) - v).length());
            direction = direction.max((decode_direction(encode_direction(v)) - v).length());
        }
        assert!(normal.to_degrees() < 0.7, "{}", normal.to_degrees());
        assert!(direction.to_degrees() < 0.003, "{}", direction.to_degrees());
    }

    #[test]
    fn octahedral_axes_are_exact_and_every_code_is_unit() {
        for a in [Vec3::X, Vec3::Y, Vec3::Z] {
            for v in [a, -a] {
                assert_eq!(decode_normal(encode_normal(v)), v);
                assert_eq!(decode_direction(encode_direction(v)), v);
            }
        }
        for code in 0..=u16::MAX {
            assert!((decode_normal(code).length() - 1.0).abs() < 1e-6);
        }
        for code in (0..=u32::MAX).step_by(7919) {
            assert!((decode_direction(code).length() - 1.0).abs() < 1e-6);
        }
        for v in [Vec3::ZERO, Vec3::NAN, Vec3::splat(f32::INFINITY)] {
            assert_eq!(decode_normal(encode_normal(v)), Vec3::Z);
        }
    }
}

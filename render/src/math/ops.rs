//! The only home of transcendental functions: pure Rust ones, because the platform's C library differs between machines
//! and would change the image's bits. `sqrt`, `+`, `*` and `/` are exact in IEEE 754 and need no wrapper.

/// π.
pub const PI: f32 = std::f32::consts::PI;
/// 1/π.
pub const INV_PI: f32 = std::f32::consts::FRAC_1_PI;

/// Sine of `x` radians.
#[inline]
pub fn sin(x: f32) -> f32 {
    libm::sinf(x)
}
/// Cosine of `x` radians.
#[inline]
pub fn cos(x: f32) -> f32 {
    libm::cosf(x)
}
/// Tangent of `x` radians.
#[inline]
pub fn tan(x: f32) -> f32 {
    libm::tanf(x)
}
/// Tangent of `x` radians in double precision.
#[inline]
pub fn tan64(x: f64) -> f64 {
    libm::tan(x)
}
/// Cosine of `x` radians in double precision.
#[inline]
pub fn cos64(x: f64) -> f64 {
    libm::cos(x)
}
/// Sine of `x` radians in double precision.
#[inline]
pub fn sin64(x: f64) -> f64 {
    libm::sin(x)
}
/// Angle of the point (x, y) in double precision, radians in (−π, π].
#[inline]
pub fn atan2_64(y: f64, x: f64) -> f64 {
    libm::atan2(y, x)
}
/// Cube root.
#[inline]
pub fn cbrt(x: f32) -> f32 {
    libm::cbrtf(x)
}
/// Angle of the point (x, y), radians in (−π, π].
#[inline]
pub fn atan2(y: f32, x: f32) -> f32 {
    libm::atan2f(y, x)
}
/// Arc cosine, argument clamped to [−1, 1].
#[inline]
pub fn acos(x: f32) -> f32 {
    libm::acosf(x.clamp(-1.0, 1.0))
}
/// eˣ.
#[inline]
pub fn exp(x: f32) -> f32 {
    libm::expf(x)
}
/// Natural logarithm.
#[inline]
pub fn ln(x: f32) -> f32 {
    libm::logf(x)
}
/// Natural logarithm in double precision.
#[inline]
pub fn ln64(x: f64) -> f64 {
    libm::log(x)
}
/// xʸ.
#[inline]
pub fn powf(x: f32, y: f32) -> f32 {
    libm::powf(x, y)
}
/// x⁵ by multiplication.
#[inline]
pub fn pow5(x: f32) -> f32 {
    let x2 = x * x;
    x2 * x2 * x
}
/// √max(x, 0).
#[inline]
pub fn safe_sqrt(x: f32) -> f32 {
    x.max(0.0).sqrt()
}

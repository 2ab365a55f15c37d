//! The scene space: bounds centred on the origin, bounding radius in [1, 2), an exact power of two from the file's unit.
//!
//! Everything after import works there in `f32` with tolerances that never depend on the user's unit, so that a scene
//! scaled by a power of two, or moved in exactly representable steps, gives the same bits.

use glam::{Affine3A, DAffine3, DVec3, Mat3A, Vec3, Vec3A};

/// Map between the file's world space (f64, the user's unit) and scene space (f32).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneSpace {
    /// World position of the scene's origin.
    pub center: DVec3,
    /// Scene units per world unit: a power of two.
    pub scale: f64,
    /// Bounding radius in scene units, in [1, 2) (1 where there is no geometry).
    pub radius: f32,
}

impl SceneSpace {
    /// The space for geometry within the world-space box `min` … `max`; `None` for no geometry.
    pub fn from_bounds(bounds: Option<(DVec3, DVec3)>) -> Self {
        let Some((min, max)) = bounds else {
            return SceneSpace { center: DVec3::ZERO, scale: 1.0, radius: 1.0 };
        };
        let center = min + (max - min) * 0.5;
        let radius = ((max - min) * 0.5).length();
        if radius <= 0.0 || !radius.is_finite() {
            return SceneSpace { center, scale: 1.0, radius: 1.0 };
        }
        let scale = power_of_two_below(radius).recip();
        SceneSpace { center, scale, radius: (radius * scale) as f32 }
    }

    /// A world position in scene space.
    pub fn point(&self, p: DVec3) -> Vec3 {
        ((p - self.center) * self.scale).as_vec3()
    }
    /// A scene position in world space.
    pub fn to_world(&self, p: Vec3) -> DVec3 {
        p.as_dvec3() / self.scale + self.center
    }
    /// A world length in scene units.
    pub fn length(&self, l: f64) -> f32 {
        (l * self.scale) as f32
    }
    /// A scene length in world units.
    pub fn length_to_world(&self, l: f32) -> f64 {
        f64::from(l) / self.scale
    }
    /// `to_world` followed by the map to scene space, still in f64.
    pub fn transform(&self, to_world: DAffine3) -> DAffine3 {
        DAffine3 {
            matrix3: to_world.matrix3 * self.scale,
            translation: (to_world.translation - self.center) * self.scale,
        }
    }
}

/// The largest power of two ≤ `x` (x > 0 and finite).
pub fn power_of_two_below(x: f64) -> f64 {
    let bits = x.to_bits() & 0x7ff0_0000_0000_0000;
    if bits == 0 {
        return f64::MIN_POSITIVE;
    }
    f64::from_bits(bits)
}

/// f64 → f32, once at the end.
pub fn to_affine3a(a: DAffine3) -> Affine3A {
    let c = |v: DVec3| Vec3A::from(v.as_vec3());
    Affine3A {
        matrix3: Mat3A::from_cols(c(a.matrix3.x_axis), c(a.matrix3.y_axis), c(a.matrix3.z_axis)),
        translation: c(a.translation),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_radius_lies_in_one_to_two_for_every_unit() {
        for e in [-300, -20, -1, 0, 1, 20, 300] {
            let half = DVec3::new(0.3, 0.7, 0.1) * 2f64.powi(e);
            let s = SceneSpace::from_bounds(Some((-half, half)));
            assert!((1.0..2.0).contains(&s.radius), "{e}: {}", s.radius);
            assert_eq!(s.scale.to_bits() & 0x000f_ffff_ffff_ffff, 0, "a power of two");
        }
    }

    #[test]
    fn scaling_by_powers_of_two_and_moving_gives_the_same_bits() {
        let (min, max) = (DVec3::new(-0.3, -0.7, 0.11), DVec3::new(1.3, 0.9, 2.5));
        let p = DVec3::new(0.123, 0.456, 0.789);
        let base = SceneSpace::from_bounds(Some((min, max)));
        for e in [-20, 20] {
            let f = 2f64.powi(e);
            let s = SceneSpace::from_bounds(Some((min * f, max * f)));
            assert_eq!(s.point(p * f), base.point(p));
            assert_eq!(s.radius, base.radius);
        }
    }
}

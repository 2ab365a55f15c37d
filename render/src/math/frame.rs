//! Orthonormal frames around a normal.

use glam::Vec3;

/// Right-handed orthonormal frame; `z` is the normal.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    /// First tangent.
    pub x: Vec3,
    /// Second tangent.
    pub y: Vec3,
    /// Normal.
    pub z: Vec3,
}

impl Frame {
    /// A frame around the unit normal `z`, without singularity (Duff et al. 2017, JCGT 6(1), listing 3).
    #[inline]
    pub fn from_normal(z: Vec3) -> Self {
        let sign = 1f32.copysign(z.z);
        let a = -1.0 / (sign + z.z);
        let b = z.x * z.y * a;
        Frame {
            x: Vec3::new(1.0 + sign * z.x * z.x * a, sign * b, -sign * z.x),
            y: Vec3::new(b, sign + z.y * z.y * a, -z.y),
            z,
        }
    }
    /// From scene to local coordinates.
    #[inline]
    pub fn to_local(&self, v: Vec3) -> Vec3 {
        Vec3::new(v.dot(self.x), v.dot(self.y), v.dot(self.z))
    }
    /// From local to scene coordinates.
    #[inline]
    pub fn to_scene(&self, v: Vec3) -> Vec3 {
        self.x * v.x + self.y * v.y + self.z * v.z
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_orthonormal_for_every_octant_and_the_poles() {
        for x in -2..=2 {
            for y in -2..=2 {
                for z in -2..=2 {
                    let v = Vec3::new(x as f32, y as f32, z as f32 + 1e-7);
                    let n = v.normalize();
                    let f = Frame::from_normal(n);
                    assert!(f.x.dot(f.y).abs() < 1e-6 && f.x.dot(f.z).abs() < 1e-6 && f.y.dot(f.z).abs() < 1e-6);
                    assert!((f.x.length() - 1.0).abs() < 1e-6 && (f.y.length() - 1.0).abs() < 1e-6);
                    assert!((f.x.cross(f.y) - f.z).length() < 1e-5, "right-handed");
                    assert!((f.to_scene(f.to_local(v)) - v).length() < 1e-5);
                }
            }
        }
    }
}

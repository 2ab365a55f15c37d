//! Cameras: film positions to rays.

use super::description::{CameraDescription, Projection};
use super::normalise::SceneSpace;
use crate::geometry::Ray;
use crate::math::ops;
use glam::{DVec3, Vec3};

/// A pinhole or orthographic camera in scene space.
#[derive(Clone, Debug)]
pub struct Camera {
    origin: Vec3,
    right: Vec3,
    up: Vec3,
    forward: Vec3,
    /// Half extents of the image plane: at distance 1 (perspective) or in scene units (orthographic).
    half_width: f32,
    half_height: f32,
    orthographic: bool,
    width: f32,
    height: f32,
}

impl Camera {
    /// A camera for an image of `width` × `height` pixels. The vertical extent is the file's; the horizontal one
    /// follows the image's shape.
    pub fn new(description: &CameraDescription, space: &SceneSpace, width: u32, height: u32) -> Self {
        let m = description.to_world.matrix3;
        let unit = |v: DVec3, fallback: DVec3| if v.length_squared() > 0.0 { v.normalize() } else { fallback };
        let forward = unit(-m.z_axis, DVec3::NEG_Z);
        let right = unit(m.x_axis - forward * m.x_axis.dot(forward), DVec3::X);
        // A mirroring node transform keeps its mirrored image: up is the file's, not the cross product.
        let up = unit(m.y_axis - forward * m.y_axis.dot(forward) - right * m.y_axis.dot(right), DVec3::Y);
        let aspect = f64::from(width) / f64::from(height);
        let (half_height, orthographic) = match description.projection {
            Projection::Perspective { yfov, .. } => (ops::tan64(yfov * 0.5) as f32, false),
            Projection::Orthographic { ymag, .. } => (space.length(ymag), true),
        };
        Camera {
            origin: space.point(description.to_world.translation),
            right: right.as_vec3(),
            up: up.as_vec3(),
            forward: forward.as_vec3(),
            half_width: (f64::from(half_height) * aspect) as f32,
            half_height,
            orthographic,
            width: width as f32,
            height: height as f32,
        }
    }

    /// The ray through film position (`x`, `y`) in pixels, (0, 0) being the top-left corner of the image.
    #[inline]
    pub fn ray(&self, x: f32, y: f32) -> Ray {
        let sx = (2.0 * x / self.width - 1.0) * self.half_width;
        let sy = (1.0 - 2.0 * y / self.height) * self.half_height;
        let offset = self.right * sx + self.up * sy;
        if self.orthographic {
            Ray::new(self.origin + offset, self.forward)
        } else {
            Ray::new(self.origin, (self.forward + offset).normalize())
        }
    }

    /// Distance of a scene position from the camera along its axis, in scene units.
    pub fn depth(&self, p: Vec3) -> f32 {
        (p - self.origin).dot(self.forward)
    }

    /// Width of a pixel on a surface that faces the camera at `depth` scene units.
    pub fn pixel_footprint(&self, depth: f32) -> f32 {
        let half = self.half_height * if self.orthographic { 1.0 } else { depth };
        2.0 * half / self.height
    }
}

/// A camera that frames a box of `min` … `max` (world space) from the front, slightly above.
pub fn framing_camera(min: DVec3, max: DVec3) -> CameraDescription {
    let center = (min + max) * 0.5;
    let radius = ((max - min) * 0.5).length().max(f64::MIN_POSITIVE);
    let yfov = 45f64.to_radians();
    let direction = DVec3::new(0.35, 0.3, 1.0).normalize();
    // Far enough for the bounding sphere to fit: radius / sin(yfov / 2), with a margin of 5 %.
    let half_tan = ops::tan64(yfov * 0.5);
    let distance = 1.05 * radius * (1.0 + half_tan * half_tan).sqrt() / half_tan;
    let eye = center + direction * distance;
    let right = DVec3::Y.cross(direction).normalize();
    let up = direction.cross(right);
    CameraDescription {
        name: "framing camera".into(),
        to_world: glam::DAffine3 { matrix3: glam::DMat3::from_cols(right, up, direction), translation: eye },
        projection: Projection::Perspective { yfov, aspect: None },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DAffine3;

    fn unit_space() -> SceneSpace {
        SceneSpace { center: DVec3::ZERO, scale: 1.0, radius: 1.0 }
    }

    #[test]
    fn the_corners_of_the_image_are_the_edges_of_the_view() {
        let d = CameraDescription {
            name: String::new(),
            to_world: DAffine3::IDENTITY,
            projection: Projection::Perspective { yfov: 90f64.to_radians(), aspect: None },
        };
        let c = Camera::new(&d, &unit_space(), 200, 100);
        let top_left = c.ray(0.0, 0.0).direction;
        assert!((top_left / -top_left.z - Vec3::new(-2.0, 1.0, -1.0)).length() < 1e-5, "{top_left}");
        assert_eq!(c.ray(100.0, 50.0).direction, Vec3::NEG_Z);
    }

    #[test]
    fn orthographic_rays_are_parallel() {
        let d = CameraDescription {
            name: String::new(),
            to_world: DAffine3::IDENTITY,
            projection: Projection::Orthographic { xmag: 3.0, ymag: 2.0 },
        };
        let c = Camera::new(&d, &unit_space(), 30, 20);
        let r = c.ray(0.0, 20.0);
        assert_eq!((r.origin, r.direction), (Vec3::new(-3.0, -2.0, 0.0), Vec3::NEG_Z));
    }

    #[test]
    fn the_framing_camera_sees_the_whole_box() {
        let (min, max) = (DVec3::new(-1.0, -2.0, 3.0), DVec3::new(4.0, 1.0, 5.0));
        let d = framing_camera(min, max);
        let inverse = d.to_world.inverse();
        for i in 0..8 {
            let pick = |b: usize, lo: f64, hi: f64| if i >> b & 1 == 0 { lo } else { hi };
            let p = DVec3::new(pick(0, min.x, max.x), pick(1, min.y, max.y), pick(2, min.z, max.z));
            let q = inverse.transform_point3(p);
            let t = 22.5f64.to_radians().tan();
            assert!(q.z < 0.0 && (q.x / -q.z).abs() < t && (q.y / -q.z).abs() < t, "{q}");
        }
    }
}

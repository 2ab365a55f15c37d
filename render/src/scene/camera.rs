//! Cameras: film positions to rays.

use super::description::{self, CameraDescription};
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

/// Where a scene point appears on the film, and how densely camera paths look at it.
#[derive(Clone, Copy, Debug)]
pub struct Projection {
    /// Film position in pixels, (0, 0) being the top-left corner of the image.
    pub x: f32,
    /// See [`Projection::x`].
    pub y: f32,
    /// Unit direction from the point to the camera.
    pub direction: Vec3,
    /// Length of the camera ray that meets the point.
    pub distance: f32,
    /// See [`Camera::density`].
    pub density: f64,
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
            description::Projection::Perspective { yfov, .. } => (ops::tan64(yfov * 0.5) as f32, false),
            description::Projection::Orthographic { ymag, .. } => (space.length(ymag), true),
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

    /// Area of the image plane, in the measure of `half_width` and `half_height`.
    #[inline]
    fn plane_area(&self) -> f64 {
        4.0 * f64::from(self.half_width) * f64::from(self.half_height)
    }

    /// pdf of the first point that a camera ray of unit `direction` meets at `distance`, per area facing the ray, where film
    /// positions are uniform over the whole image: 1/(A cos³θ distance²) for a pinhole with an image plane of area A at
    /// distance 1, 1/A for parallel rays (compare Veach 1997, §8.2.2, and pbrt 3rd ed., §16.1.1, where W_e = pdf/cosθ).
    #[inline]
    pub fn density(&self, direction: Vec3, distance: f32) -> f64 {
        if self.orthographic {
            return 1.0 / self.plane_area();
        }
        let c = f64::from(direction.dot(self.forward));
        let d = f64::from(distance);
        1.0 / (self.plane_area() * (c * c * c) * (d * d))
    }

    /// Projects the scene point `p`; `None` where it is outside the image or not in front of the camera.
    #[inline]
    pub fn project(&self, p: Vec3) -> Option<Projection> {
        let v = p - self.origin;
        let depth = v.dot(self.forward);
        if depth <= 0.0 {
            return None;
        }
        let scale = if self.orthographic { 1.0 } else { depth };
        let sx = v.dot(self.right) / (scale * self.half_width);
        let sy = v.dot(self.up) / (scale * self.half_height);
        let (x, y) = (0.5 * (1.0 + sx) * self.width, 0.5 * (1.0 - sy) * self.height);
        if !(0.0..self.width).contains(&x) || !(0.0..self.height).contains(&y) {
            return None;
        }
        let (direction, distance) = if self.orthographic {
            (-self.forward, depth)
        } else {
            let distance = v.length();
            (v * -distance.recip(), distance)
        };
        Some(Projection { x, y, direction, distance, density: self.density(-direction, distance) })
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
        projection: description::Projection::Perspective { yfov, aspect: None },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DAffine3, DMat3};

    fn unit_space() -> SceneSpace {
        SceneSpace { center: DVec3::ZERO, scale: 1.0, radius: 1.0 }
    }

    #[test]
    fn the_corners_of_the_image_are_the_edges_of_the_view() {
        let d = CameraDescription {
            name: String::new(),
            to_world: DAffine3::IDENTITY,
            projection: description::Projection::Perspective { yfov: 90f64.to_radians(), aspect: None },
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
            projection: description::Projection::Orthographic { xmag: 3.0, ymag: 2.0 },
        };
        let c = Camera::new(&d, &unit_space(), 30, 20);
        let r = c.ray(0.0, 20.0);
        assert_eq!((r.origin, r.direction), (Vec3::new(-3.0, -2.0, 0.0), Vec3::NEG_Z));
    }

    /// A perspective and an orthographic camera, turned and moved.
    fn cameras() -> [Camera; 2] {
        let turn = DMat3::from_euler(glam::EulerRot::XYZ, 0.3, -0.8, 0.2);
        let to_world = DAffine3 { matrix3: turn, translation: DVec3::new(0.2, -0.4, 0.7) };
        [
            description::Projection::Perspective { yfov: 1.2, aspect: None },
            description::Projection::Orthographic { xmag: 0.7, ymag: 0.5 },
        ]
        .map(|projection| {
            let d = CameraDescription { name: String::new(), to_world, projection };
            Camera::new(&d, &unit_space(), 120, 80)
        })
    }

    #[test]
    fn a_point_on_a_camera_ray_projects_to_its_film_position() {
        for c in cameras() {
            for (x, y) in [(0.5, 0.5), (119.5, 3.25), (60.0, 40.0), (17.3, 79.9)] {
                for distance in [1e-3, 0.9, 50.0] {
                    let ray = c.ray(x, y);
                    let p = c.project(ray.origin + ray.direction * distance).expect("a point in view");
                    let error = (p.x - x).abs().max((p.y - y).abs());
                    // Rounding of the point, a few 1e-7 of its distance from the origin, in pixels: relative to its
                    // distance for the pinhole, to the film for parallel rays.
                    let tolerance = 120.0 * 1e-6 * (1.0 + distance.max(1.0 / distance));
                    assert!(error < tolerance, "{x}, {y} at {distance}: {} {}", p.x, p.y);
                    assert!((p.direction + ray.direction).length() < 2e-6 * (1.0 + 1.0 / distance));
                    assert!((p.distance / distance - 1.0).abs() < 2e-6 * (1.0 + 1.0 / distance));
                }
                let behind = c.ray(x, y);
                assert!(c.project(behind.origin - behind.direction).is_none());
            }
            for (x, y) in [(-0.1, 40.0), (120.1, 40.0), (60.0, -0.1), (60.0, 80.1)] {
                let ray = c.ray(x, y);
                assert!(c.project(ray.origin + ray.direction).is_none(), "{x}, {y}");
            }
        }
    }

    /// The density is 1/(film area) over the area facing the ray that a pixel covers: its integral over the image is 1.
    #[test]
    fn densities_integrate_to_one_over_the_image() {
        for c in cameras() {
            let (n, distance) = (400u32, 1.7f32);
            let mut sum = 0.0;
            for i in 0..n * n {
                let at = |k: u32, size: f32| (k as f32 + 0.5) / n as f32 * size;
                let (x, y) = (at(i % n, 120.0), at(i / n, 80.0));
                let (step_x, step_y) = (60.0 / n as f32, 40.0 / n as f32);
                // The patch that a cell of the film covers at `distance`, from the ends of its axes.
                let end = |x: f32, y: f32| {
                    let r = c.ray(x, y);
                    (r.origin + r.direction * distance).as_dvec3()
                };
                let u = end(x + step_x, y) - end(x - step_x, y);
                let v = end(x, y + step_y) - end(x, y - step_y);
                sum += c.density(c.ray(x, y).direction, distance) * u.cross(v).length();
            }
            assert!((sum - 1.0).abs() < 1e-3, "{sum}");
        }
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

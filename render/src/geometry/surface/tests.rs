//! Spawned rays, normals and attributes.

use super::*;
use crate::geometry::{Accelerator, Ray};
use crate::math::frame::Frame;
use crate::math::rng::{Purpose, Stream};
use crate::math::warp;
use glam::{DAffine3, DQuat, Vec4};
use std::sync::Arc;

fn point(s: &mut Stream) -> Vec3 {
    Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) * 2.0 - 1.0
}

/// A transform with scales between 10⁻³ and 10, mirroring every other time.
fn transform(s: &mut Stream, i: u64) -> Transform {
    let scale = [0, 1, 2].map(|_| 10f64.powi((s.next_f32() * 5.0) as i32 - 3));
    let scale = DVec3::from_array(scale) * if i.is_multiple_of(2) { 1.0 } else { -1.0 };
    let rotation = DQuat::from_axis_angle(point(s).as_dvec3().normalize(), s.next_f32() as f64 * 6.0);
    Transform::new(DAffine3::from_scale_rotation_translation(scale, rotation, point(s).as_dvec3() * 2.0))
}

/// Shoots rays at random triangles, spawns rays on both sides from where they met, and counts how many were spawned
/// and how many of them met the triangle again.
fn self_intersections(size: f32, distance: f32, moved: bool) -> (u32, u32) {
    let (mut spawned, mut met) = (0, 0);
    for i in 0..3000 {
        let s = &mut Stream::new(7, Purpose::Test, 0, i);
        let center = point(s) * distance;
        let sliver = if i % 3 == 0 { 1e-4 } else { 1.0 };
        let (e, f) = (point(s) * size, point(s) * size);
        let positions = vec![center, center + e, center + e * s.next_f32() + f * sliver];
        let mesh = Mesh { positions, triangles: vec![[0, 1, 2]], ..Mesh::default() };
        let transform = moved.then(|| transform(s, i));
        let instance = Instance { mesh: 0, transform, first_emitter: None };
        let accelerator = Accelerator::build(&[Arc::new(mesh.clone())], std::slice::from_ref(&instance));
        let [a, b, c] = mesh.triangle_positions(0, &instance);
        for _ in 0..8 {
            let [b1, b2] = warp::triangle(s.next_2d());
            let target = a + (b - a) * b1 + (c - a) * b2;
            let reach = ((b - a).length() + (c - a).length()).max(1e-3);
            let origin = target + point(s).normalize_or(Vec3::X) * reach;
            let ray = Ray::new(origin, (target - origin).normalize_or(Vec3::X));
            let Some(hit) = accelerator.closest_hit(&ray) else { continue };
            let surface = SurfacePoint::from_hit(&mesh, &instance, &hit);
            for side in [1.0, -1.0] {
                let frame = Frame::from_normal(surface.ng * side);
                let mut local = warp::cosine_hemisphere(s.next_2d());
                if i % 5 == 0 {
                    local.z *= 1e-3;
                }
                let direction = frame.to_scene(local.normalize());
                if direction.dot(surface.ng).abs() < 1e-5 {
                    continue;
                }
                spawned += 1;
                met += u32::from(accelerator.occluded(&Ray::new(surface.spawn(direction), direction)));
            }
        }
    }
    (spawned, met)
}

#[test]
fn spawned_rays_never_meet_their_own_triangle() {
    for size in [1.0, 1e-2, 1e-4, 1e-6] {
        for distance in [0.0, 1.0, 2.0, 1e3] {
            for moved in [false, true] {
                let (spawned, met) = self_intersections(size, distance, moved);
                assert_eq!(met, 0, "of {spawned}: size {size}, {distance} from the origin, transform {moved}");
                // Far from the origin small triangles have no area left.
                assert!(spawned > 5000 || size < 1e-3 * distance, "{spawned}: {size} {distance} {moved}");
            }
        }
    }
}

#[test]
fn the_error_bounds_the_distance_to_the_plane() {
    for i in 0..2000 {
        let s = &mut Stream::new(8, Purpose::Test, 0, i);
        let positions = vec![point(s), point(s), point(s)];
        let mesh = Mesh { positions, triangles: vec![[0, 1, 2]], ..Mesh::default() };
        let instance = Instance { mesh: 0, transform: None, first_emitter: None };
        let [b1, b2] = warp::triangle(s.next_2d());
        let hit = Hit { t: 1.0, b1, b2, instance: 0, triangle: 0 };
        let surface = SurfacePoint::from_hit(&mesh, &instance, &hit);
        let [a, b, c] = [0, 1, 2].map(|v| mesh.positions[v].as_dvec3());
        let normal = (b - a).cross(c - a).normalize();
        let distance = normal.dot(surface.position.as_dvec3() - a).abs();
        assert!(distance <= normal.abs().dot(surface.error.as_dvec3()), "{distance} {:?}", surface.error);
        assert!(surface.error.max_element() < 3e-7);
    }
}

#[test]
fn normals_and_tangents_stay_as_authored_under_mirroring() {
    let mesh = Mesh {
        positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
        triangles: vec![[0, 1, 2]],
        normals: Some(vec![Vec3::Z; 3]),
        tangents: Some(vec![Vec4::new(1.0, 0.0, 0.0, 1.0); 3]),
        ..Mesh::default()
    };
    let hit = Hit { t: 1.0, b1: 0.2, b2: 0.3, instance: 4, triangle: 0 };
    let at = |scale: DVec3| {
        let transform = Some(Transform::new(DAffine3::from_scale(scale)));
        SurfacePoint::from_hit(&mesh, &Instance { mesh: 0, transform, first_emitter: None }, &hit)
    };
    for (scale, normal) in [
        (DVec3::new(2.0, 3.0, 4.0), Vec3::Z),
        (DVec3::new(-2.0, 3.0, 4.0), Vec3::Z),
        (DVec3::new(2.0, 3.0, -4.0), Vec3::NEG_Z),
        (DVec3::new(-2.0, -3.0, -4.0), Vec3::NEG_Z),
    ] {
        let surface = at(scale);
        assert_eq!((surface.ng, surface.ns), (normal, normal), "{scale}");
        assert_eq!(surface.position, (Vec3::new(0.2, 0.3, 0.0) * scale.as_vec3()));
        // The bitangent is the image of the object's, +y.
        let (tangent, handedness) = surface.tangent.expect("tangents");
        let bitangent = surface.ns.cross(tangent) * handedness;
        assert_eq!(tangent, Vec3::X * scale.x.signum() as f32);
        assert_eq!(bitangent, Vec3::Y * scale.y.signum() as f32, "{scale}");
        let map = Transform::new(DAffine3::from_scale(scale)).normal_to_scene;
        assert_eq!((map * Vec3::Z).normalize(), normal);
    }
    assert_eq!(at(DVec3::ONE).instance, 4);
}

#[test]
fn shading_normals_stay_in_the_hemisphere_of_the_geometric_normal() {
    for i in 0..5000 {
        let s = &mut Stream::new(9, Purpose::Test, 0, i);
        let normals = Some(vec![point(s).normalize(), point(s).normalize(), point(s).normalize()]);
        let positions = vec![point(s), point(s), point(s)];
        let mesh = Mesh { positions, normals, triangles: vec![[0, 1, 2]], ..Mesh::default() };
        let transform = (i % 2 == 0).then(|| transform(s, i));
        let instance = Instance { mesh: 0, transform, first_emitter: None };
        let [b1, b2] = warp::triangle(s.next_2d());
        let hit = Hit { t: 1.0, b1, b2, instance: 0, triangle: 0 };
        let surface = SurfacePoint::from_hit(&mesh, &instance, &hit);
        assert!(surface.ns.dot(surface.ng) > 0.5 * MIN_NORMAL_COSINE, "{surface:?}");
        assert!((surface.ns.length() - 1.0).abs() < 1e-5 && (surface.ng.length() - 1.0).abs() < 1e-5);
    }
}

#[test]
fn attributes_are_interpolated_and_default_where_absent() {
    let mut mesh = Mesh {
        positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
        triangles: vec![[0, 1, 2]],
        uvs: [None, Some(vec![Vec2::ZERO, Vec2::X, Vec2::Y])],
        material: 3,
        ..Mesh::default()
    };
    let instance = Instance { mesh: 0, transform: None, first_emitter: None };
    let hit = Hit { t: 1.0, b1: 0.25, b2: 0.5, instance: 0, triangle: 0 };
    let surface = SurfacePoint::from_hit(&mesh, &instance, &hit);
    assert_eq!(surface.uv, [Vec2::ZERO, Vec2::new(0.25, 0.5)]);
    assert_eq!((surface.color, surface.material, surface.tangent), ([1.0; 4], 3, None));
    mesh.colors = Some(vec![[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0]]);
    assert_eq!(SurfacePoint::from_hit(&mesh, &instance, &hit).color, [0.25, 0.25, 0.5, 0.5]);
}

#[test]
fn areas_and_bounds_are_those_of_the_scene() {
    let mesh = Mesh { positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y], triangles: vec![[0, 1, 2]], ..Mesh::default() };
    let transform = Some(Transform::new(DAffine3::from_scale(DVec3::new(-2.0, 3.0, 1.0))));
    let moved = Instance { mesh: 0, transform, first_emitter: None };
    assert_eq!(mesh.area(0, &Instance { transform: None, ..moved.clone() }), 0.5);
    assert_eq!(mesh.area(0, &moved), 3.0);
    assert_eq!(mesh.triangle_positions(0, &moved)[1], Vec3::new(-2.0, 0.0, 0.0));
    assert_eq!(mesh.bounds().max, Vec3::new(1.0, 1.0, 0.0));
    assert!(Mesh::default().bounds().is_empty());
}

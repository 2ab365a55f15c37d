//! Procedural scenes for the ray benchmarks.

use gatherlight_render::geometry::Mesh;
use gatherlight_render::math::ops::{cos, sin};
use gatherlight_render::math::rng::{Purpose, Stream};
use glam::{Quat, Vec3};
use std::f32::consts::{PI, TAU};

/// A furnished room of half a million triangles, 4 × 1.5 × 3 units around the origin: large walls and planks, curved
/// furniture of fine triangles, curtains, blinds, and plants of slivers.
pub(crate) fn interior() -> Mesh {
    let mut mesh = Mesh::default();
    let s = &mut Stream::new(3, Purpose::Test, 0, 0);
    let (low, high) = (Vec3::new(-2.0, -0.75, -1.5) * 0.8, Vec3::new(2.0, 0.75, 1.5) * 0.8);
    cuboid(&mut mesh, low, high, Quat::IDENTITY, Vec3::ZERO);
    let on_floor = |s: &mut Stream| {
        let at = Vec3::new(s.next_f32(), 0.0, s.next_f32()) * 0.9 + Vec3::new(0.05, 0.0, 0.05);
        low + (high - low) * at
    };
    for i in 0..120 {
        let x = low.x + (high.x - low.x) * i as f32 / 120.0;
        let plank = Vec3::new(0.024, 0.004 + 0.002 * s.next_f32(), high.z - low.z);
        cuboid(&mut mesh, Vec3::new(x, low.y, low.z), Vec3::new(x, low.y, low.z) + plank, Quat::IDENTITY, Vec3::ZERO);
    }
    for _ in 0..400 {
        let size = Vec3::new(s.next_f32(), 2.0 * s.next_f32(), s.next_f32()) * 0.1 + 0.01;
        let turn = Quat::from_rotation_y(s.next_f32() * TAU);
        cuboid(&mut mesh, -size, size, turn, on_floor(s) + Vec3::Y * size.y);
    }
    for _ in 0..36 {
        let (radius, at) = (0.03 + 0.1 * s.next_f32(), on_floor(s) + Vec3::Y * s.next_f32());
        sheet(&mut mesh, 64, 32, |u, v| at + radius * sphere(u, v));
    }
    for _ in 0..30 {
        let (radius, at) = (0.05 + 0.1 * s.next_f32(), on_floor(s) + Vec3::Y * s.next_f32());
        let turn = Quat::from_rotation_x(s.next_f32() * TAU);
        sheet(&mut mesh, 64, 48, |u, v| {
            let (a, b) = (u * TAU, v * TAU);
            let ring = Vec3::new(cos(a), 0.0, sin(a));
            at + turn * (ring * radius * (1.0 + 0.3 * cos(b)) + Vec3::Y * radius * 0.3 * sin(b))
        });
    }
    for side in [-1.0, 1.0] {
        sheet(&mut mesh, 200, 100, |u, v| {
            let fold = 0.03 * sin(u * 40.0 * PI) * (0.5 + v);
            Vec3::new(side * 0.9 * high.x + fold, low.y + v * (high.y - low.y), low.z * 0.8 + u * 1.4)
        });
    }
    for i in 0..60 {
        let at = Vec3::new(0.0, low.y + (i as f32 + 0.5) / 60.0 * (high.y - low.y), high.z * 0.97);
        cuboid(&mut mesh, Vec3::new(-0.8, -0.001, -0.01), Vec3::new(0.8, 0.001, 0.01), Quat::from_rotation_x(0.6), at);
    }
    for _ in 0..12 {
        let root = on_floor(s);
        for _ in 0..4000 {
            let at = root + (sphere(s.next_f32(), s.next_f32()) + Vec3::Y) * 0.15 * s.next_f32();
            let (along, across) = (sphere(s.next_f32(), s.next_f32()), sphere(s.next_f32(), s.next_f32()));
            push(&mut mesh, [at, at + along * 0.04, at + along * 0.02 + across * 0.004]);
        }
    }
    mesh
}

/// An open box with two finely tessellated spheres, like scenes that show caustics.
pub(crate) fn spheres() -> Mesh {
    let mut mesh = Mesh::default();
    cuboid(&mut mesh, Vec3::splat(-1.0), Vec3::splat(1.0), Quat::IDENTITY, Vec3::ZERO);
    for (radius, at) in [(0.35, Vec3::new(-0.4, -0.65, -0.3)), (0.35, Vec3::new(0.4, -0.65, 0.3))] {
        sheet(&mut mesh, 128, 64, |u, v| at + radius * sphere(u, v));
    }
    cuboid(&mut mesh, Vec3::new(-0.25, 0.98, -0.25), Vec3::new(0.25, 0.99, 0.25), Quat::IDENTITY, Vec3::ZERO);
    mesh
}

fn sphere(u: f32, v: f32) -> Vec3 {
    let (a, b) = (u * TAU, v * PI);
    Vec3::new(sin(b) * cos(a), cos(b), sin(b) * sin(a))
}

fn push(mesh: &mut Mesh, corners: [Vec3; 3]) {
    let first = mesh.positions.len() as u32;
    mesh.positions.extend(corners);
    mesh.triangles.push([first, first + 1, first + 2]);
}

fn cuboid(mesh: &mut Mesh, low: Vec3, high: Vec3, turn: Quat, at: Vec3) {
    let first = mesh.positions.len() as u32;
    for i in 0..8 {
        let pick = |bit: usize| if i >> bit & 1 == 0 { low[bit] } else { high[bit] };
        mesh.positions.push(turn * Vec3::new(pick(0), pick(1), pick(2)) + at);
    }
    for [a, b, c, d] in [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]] {
        mesh.triangles.extend([[first + a, first + b, first + c], [first + a, first + c, first + d]]);
    }
}

/// A grid of `m` × `n` quads over (u, v) in [0, 1]².
fn sheet(mesh: &mut Mesh, m: u32, n: u32, at: impl Fn(f32, f32) -> Vec3) {
    let first = mesh.positions.len() as u32;
    for (j, i) in (0..=n).flat_map(|j| (0..=m).map(move |i| (j, i))) {
        mesh.positions.push(at(i as f32 / m as f32, j as f32 / n as f32));
    }
    for (j, i) in (0..n).flat_map(|j| (0..m).map(move |i| (j, i))) {
        let a = first + j * (m + 1) + i;
        let (b, c, d) = (a + 1, a + m + 1, a + m + 2);
        mesh.triangles.extend([[a, b, d], [a, d, c]]);
    }
}

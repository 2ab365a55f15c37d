//! Against brute force, in every vector width; watertightness; degenerate input.

use super::super::Transform;
use super::super::simd::Portable;
use super::*;
use crate::math::rng::{Purpose, Stream};
use crate::math::warp;
use glam::{DQuat, DVec3};

fn stream(index: u64) -> Stream {
    Stream::new(1, Purpose::Test, 0, index)
}

fn point(s: &mut Stream) -> Vec3 {
    Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) * 2.0 - 1.0
}

fn direction(s: &mut Stream) -> Vec3 {
    warp::uniform_sphere(s.next_2d())
}

fn mesh(triangles: &[[Vec3; 3]]) -> Mesh {
    Mesh {
        positions: triangles.iter().flatten().copied().collect(),
        triangles: (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        ..Mesh::default()
    }
}

fn fixed(mesh: u32) -> Instance {
    Instance { mesh, transform: None, first_emitter: None }
}

fn scene(mesh: Mesh) -> Accelerator {
    Accelerator::build(&[Arc::new(mesh)], &[fixed(0)])
}

/// Every triangle by the same test, one at a time, without any tree.
fn brute_force(meshes: &[Arc<Mesh>], instances: &[Instance], ray: &Ray, accept: impl Fn(&Hit) -> bool) -> Option<Hit> {
    let mut best = Best { t: ray.t_max, hit: None, accept: &accept };
    for (index, instance) in instances.iter().enumerate() {
        let (origin, direction) = match &instance.transform {
            None => (ray.origin, ray.direction),
            Some(t) => {
                let to_scene =
                    DAffine3::from_mat3_translation(t.to_scene.matrix3.as_dmat3(), t.to_scene.translation.as_dvec3());
                Placed { to_object: to_scene.inverse(), instance: 0, mesh: 0 }.to_object(ray)
            }
        };
        let sheared = ShearedRay::new(origin, direction);
        for (triangle, corners) in sound_triangles(&meshes[instance.mesh as usize]) {
            let mut block = Block::EMPTY;
            block.set(0, corners, index as u32, triangle);
            let candidates = sheared.meet::<super::super::simd::Array<4>>(Portable, &block, f32::INFINITY);
            if candidates.lanes != 0
                && let Some(c) = sheared.resolve(&candidates, &block, 0)
            {
                best.take(Hit { t: c.t, b1: c.b1, b2: c.b2, instance: index as u32, triangle });
            }
        }
    }
    best.hit
}

/// Asserts that the structure, at every level, finds what brute force finds.
fn assert_as_brute_force(meshes: &[Arc<Mesh>], instances: &[Instance], rays: impl Iterator<Item = Ray>) -> usize {
    let mut accelerator = Accelerator::build(meshes, instances);
    let mut hits = 0;
    for ray in rays {
        let accept = |hit: &Hit| hit.triangle % 5 != 3;
        let expected = brute_force(meshes, instances, &ray, |_| true);
        let expected_where = brute_force(meshes, instances, &ray, accept);
        for level in Level::all() {
            accelerator.level = level;
            assert_eq!(accelerator.closest_hit(&ray), expected, "{ray:?} {level:?}");
            assert_eq!(accelerator.occluded(&ray), expected.is_some(), "{ray:?} {level:?}");
            assert_eq!(accelerator.closest_hit_where(&ray, accept), expected_where, "{ray:?} {level:?}");
            assert_eq!(accelerator.occluded_where(&ray, accept), expected_where.is_some(), "{ray:?} {level:?}");
        }
        hits += usize::from(expected.is_some());
    }
    hits
}

/// Rays from anywhere, some along the axes, some bounded.
fn rays(seed: u64, count: u64) -> impl Iterator<Item = Ray> {
    (0..count).map(move |i| {
        let s = &mut stream(seed << 32 | i);
        let origin = point(s) * 1.5;
        let mut ray = Ray::new(origin, direction(s));
        match i % 8 {
            0 => ray.direction = [Vec3::X, Vec3::Y, Vec3::Z][i as usize / 8 % 3] * if i % 16 == 0 { 1.0 } else { -1.0 },
            1 => ray.direction = Vec3::new(ray.direction.x, -0.0, ray.direction.z).normalize(),
            2 => ray.t_max = s.next_f32(),
            _ => {}
        }
        ray
    })
}

/// Triangles of a size around `size`, of which one in four is a sliver.
fn soup(seed: u64, count: usize, size: f32) -> Mesh {
    let s = &mut stream(seed);
    let triangle = |i: usize| {
        let a = point(s);
        let (e, f) = (direction(s) * size, direction(s) * size);
        let f = if i.is_multiple_of(4) { e * s.next_f32() + f * 1e-6 } else { f };
        [a, a + e, a + f]
    };
    mesh(&(0..count).map(triangle).collect::<Vec<_>>())
}

#[test]
fn equals_brute_force_on_soups_and_slivers() {
    for (seed, count, size) in [(1, 1, 1.0), (2, 3, 1.0), (3, 40, 0.7), (4, 1000, 0.2), (5, 5000, 0.1)] {
        let meshes = [Arc::new(soup(seed, count, size))];
        let hits = assert_as_brute_force(&meshes, &[fixed(0)], rays(seed, 1500));
        assert!(count < 40 || hits > 100, "{hits} of 1500 rays hit {count} triangles");
    }
}

#[test]
fn equals_brute_force_on_instances_with_mirroring_and_shearing_transforms() {
    let meshes = [Arc::new(soup(6, 200, 0.3)), Arc::new(soup(7, 50, 0.5)), Arc::new(Mesh::default())];
    let mut instances = vec![fixed(0), fixed(2)];
    for i in 0..40 {
        let s = &mut stream(100 + i);
        let scale = DVec3::new(0.2, 0.3 * s.next_f32() as f64 + 0.01, if i % 2 == 0 { 0.25 } else { -0.25 });
        let rotation = DQuat::from_axis_angle(direction(s).as_dvec3().normalize(), s.next_f32() as f64 * 6.0);
        let to_scene = DAffine3::from_scale_rotation_translation(scale, rotation, point(s).as_dvec3());
        let transform = Some(Transform::new(to_scene));
        instances.push(Instance { mesh: i as u32 % 3, transform, first_emitter: None });
    }
    let hits = assert_as_brute_force(&meshes, &instances, rays(8, 1500));
    assert!(hits > 250, "{hits}");
    let without_fixed = &instances[2..];
    assert_as_brute_force(&meshes, without_fixed, rays(9, 500));
}

#[test]
fn instances_give_the_hits_of_the_transformed_mesh() {
    let original = soup(10, 300, 0.3);
    let to_scene = DAffine3::from_scale_rotation_translation(
        DVec3::new(0.5, -2.0, 1.5),
        DQuat::from_rotation_y(0.7),
        DVec3::new(0.1, -0.4, 0.3),
    );
    let mut moved = original.clone();
    for p in &mut moved.positions {
        *p = to_scene.transform_point3(p.as_dvec3()).as_vec3();
    }
    let transform = Some(Transform::new(to_scene));
    let instanced = Accelerator::build(&[Arc::new(original)], &[Instance { mesh: 0, transform, first_emitter: None }]);
    let flat = scene(moved);
    let (mut hits, mut different) = (0, 0);
    for ray in rays(11, 20_000) {
        match (instanced.closest_hit(&ray), flat.closest_hit(&ray)) {
            (Some(a), Some(b)) if a.triangle == b.triangle => {
                hits += 1;
                assert!((a.t - b.t).abs() <= 1e-4 * b.t.max(0.1), "{a:?} {b:?}");
            }
            (None, None) => {}
            _ => different += 1,
        }
    }
    // Slivers and edges may go to either side by rounding.
    assert!(hits > 3000 && different < 40, "{hits} {different}");
}

#[test]
fn agrees_with_moller_trumbore_in_double_precision() {
    let mesh = soup(12, 500, 0.4);
    let accelerator = scene(mesh.clone());
    let (mut same, mut different) = (0, 0);
    for ray in rays(13, 5000) {
        let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let mut best: Option<(f64, u32)> = None;
        for (i, corners) in sound_triangles(&mesh) {
            let [a, b, c] = corners.map(|p| p.as_dvec3());
            let (e, f) = (b - a, c - a);
            let h = d.cross(f);
            let det = e.dot(h);
            let s = o - a;
            let q = s.cross(e);
            let (u, v, t) = (s.dot(h) / det, d.dot(q) / det, f.dot(q) / det);
            let inside = u >= 0.0 && v >= 0.0 && u + v <= 1.0;
            if inside && t > 0.0 && t < best.map_or(ray.t_max as f64, |b| b.0) {
                best = Some((t, i));
            }
        }
        match (accelerator.closest_hit(&ray), best) {
            (None, None) => same += 1,
            (Some(hit), Some((t, triangle))) if hit.triangle == triangle => {
                same += 1;
                assert!((hit.t as f64 - t).abs() <= 2e-5 * t.max(0.1), "{hit:?} {t}");
            }
            _ => different += 1,
        }
    }
    assert!(same > 4980 && different < 20, "{same} {different}");
}

/// A closed surface around the origin: a subdivided octahedron with vertices moved by `roughness`, sharing vertices.
fn closed(divisions: usize, roughness: f32) -> Mesh {
    let n = divisions as i32;
    let mut keys = std::collections::BTreeMap::new();
    let mut mesh = Mesh::default();
    for octant in 0..8 {
        let sign = |bit: i32| if octant >> bit & 1 == 0 { 1 } else { -1 };
        let mut vertex = |i: i32, j: i32| {
            let key = [sign(0) * i, sign(1) * j, sign(2) * (n - i - j)];
            *keys.entry(key).or_insert_with(|| {
                let radius = 1.0 + roughness * (stream(mesh.positions.len() as u64).next_f32() - 0.5);
                mesh.positions.push(Vec3::from_array(key.map(|k| k as f32)).normalize() * radius);
                mesh.positions.len() as u32 - 1
            })
        };
        for i in 0..n {
            for j in 0..n - i {
                let [a, b, c] = [vertex(i, j), vertex(i + 1, j), vertex(i, j + 1)];
                mesh.triangles.push([a, b, c]);
                if i + j + 1 < n {
                    let d = vertex(i + 1, j + 1);
                    mesh.triangles.push([b, d, c]);
                }
            }
        }
    }
    mesh
}

#[test]
fn no_ray_from_inside_a_closed_mesh_escapes_through_edges_or_vertices() {
    let mesh = closed(24, 0.05);
    let accelerator = scene(mesh.clone());
    let transform = Some(Transform::new(DAffine3::from_scale_rotation_translation(
        DVec3::new(1.5, -0.3, 0.7),
        DQuat::from_rotation_x(0.4),
        DVec3::new(0.3, 0.2, -5.0),
    )));
    let instanced =
        Accelerator::build(&[Arc::new(mesh.clone())], &[Instance { mesh: 0, transform, first_emitter: None }]);
    let to_scene = transform.map(|t| t.to_scene).unwrap_or_default();
    let mut escaped = 0;
    let mut shot = 0;
    for round in 0..70 {
        for (i, triangle) in mesh.triangles.iter().enumerate() {
            let s = &mut stream(round << 32 | i as u64);
            let origin = if round == 0 { Vec3::ZERO } else { point(s) * 0.4 };
            let [a, b, c] = triangle.map(|v| mesh.positions[v as usize]);
            for target in [a, a.midpoint(b), a.lerp(b, s.next_f32()), b.lerp(c, s.next_f32())] {
                let ray = Ray::new(origin, (target - origin).normalize());
                escaped += usize::from(accelerator.closest_hit(&ray).is_none() || !accelerator.occluded(&ray));
                let (o, p) = (to_scene.transform_point3(origin), to_scene.transform_point3(target));
                let ray = Ray::new(o, (p - o).normalize());
                escaped += usize::from(instanced.closest_hit(&ray).is_none() || !instanced.occluded(&ray));
                shot += 2;
            }
        }
    }
    assert!(shot > 2_000_000);
    assert_eq!(escaped, 0, "of {shot}");
}

#[test]
fn axis_parallel_rays_inside_a_box_do_not_escape() {
    // Planes at 0 and 1: box tests meet 0 × ∞, and rays along the diagonals meet edges.
    let grid = 8;
    let mut triangles = Vec::new();
    for axis in 0..3 {
        for side in [0.0, 1.0] {
            for (i, j) in (0..grid).flat_map(|i| (0..grid).map(move |j| (i, j))) {
                let at = |i: i32, j: i32| {
                    let mut p = Vec3::splat(side);
                    p[(axis + 1) % 3] = i as f32 / grid as f32;
                    p[(axis + 2) % 3] = j as f32 / grid as f32;
                    p
                };
                triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
    }
    let accelerator = scene(mesh(&triangles));
    for (i, j, k) in (1..16).flat_map(|i| (1..16).flat_map(move |j| (1..16).map(move |k| (i, j, k)))) {
        let origin = Vec3::new(i as f32, j as f32, k as f32) / 16.0;
        for d in [(1, 0, 0), (0, -1, 0), (0, 0, 1), (1, 1, 0), (0, -1, 1), (1, 1, 1), (-1, 1, -1)] {
            let ray = Ray::new(origin, Vec3::new(d.0 as f32, d.1 as f32, d.2 as f32));
            assert!(accelerator.closest_hit(&ray).is_some_and(|hit| hit.t <= 1.0), "{ray:?}");
        }
    }
}

#[test]
fn near_hits_count_down_to_tiny_distances() {
    for distance in [1e-3, 1e-6, 1e-9, 1e-12] {
        let y = |x: f32, z: f32| Vec3::new(x, 0.0, z);
        let accelerator = scene(mesh(&[[y(-1.0, -1.0), y(1.0, -1.0), y(0.0, 1.0)]]));
        for d in [Vec3::NEG_Y, Vec3::new(0.6, -0.8, 0.0), Vec3::new(0.999, -0.01, 0.0)] {
            let hit = accelerator.closest_hit(&Ray::new(Vec3::new(0.1, distance, 0.1), d));
            let t = hit.map(|hit| hit.t).unwrap_or(f32::NAN);
            assert!((t * -d.y / distance - 1.0).abs() < 1e-3, "{distance} {d} {t}");
            // Behind the plane and leading away from it there is nothing.
            assert_eq!(accelerator.closest_hit(&Ray::new(Vec3::new(0.1, -distance, 0.1), d)), None);
        }
    }
}

#[test]
fn among_coincident_triangles_the_lowest_index_is_hit() {
    let t = [Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, -1.0, 0.0), Vec3::new(0.0, 1.0, 0.0)];
    let meshes = [Arc::new(mesh(&[t; 37])), Arc::new(mesh(&[t; 5]))];
    let instances = [fixed(1), fixed(0), fixed(0)];
    let accelerator = Accelerator::build(&meshes, &instances);
    for i in 0..200 {
        let s = &mut stream(i);
        let ray =
            Ray::new(point(s) + Vec3::Z * 2.0, Vec3::new(s.next_f32() * 0.1, s.next_f32() * 0.1, -1.0).normalize());
        if let Some(hit) = accelerator.closest_hit(&ray) {
            assert_eq!((hit.instance, hit.triangle), (0, 0));
        }
        let later = accelerator.closest_hit_where(&ray, |hit| hit.instance > 0 && hit.triangle > 3);
        assert!(later.is_none_or(|hit| (hit.instance, hit.triangle) == (1, 4)));
    }
}

#[test]
fn stacked_triangles_build_and_trace() {
    let stacked = |offset: f32| {
        let corners = |i: usize| {
            let z = i as f32 * offset;
            [Vec3::new(-1.0, -1.0, z), Vec3::new(1.0, -1.0, z), Vec3::new(0.0, 1.0, z)]
        };
        mesh(&(0..8000).map(corners).collect::<Vec<_>>())
    };
    for offset in [0.0, 1e-7, 1e-4] {
        let meshes = [Arc::new(stacked(offset))];
        let accelerator = Accelerator::build(&meshes, &[fixed(0)]);
        let entries = accelerator.fixed.as_ref().map(|g| g.tree.stack_entries);
        assert!(entries.is_some_and(|n| n <= 7 * super::super::binary::MAX_DEPTH), "{entries:?}");
        assert_as_brute_force(&meshes, &[fixed(0)], rays(14, 30));
    }
}

#[test]
fn nothing_one_and_degenerate_triangles() {
    let ray = Ray::new(Vec3::new(0.1, 0.1, 1.0), Vec3::NEG_Z);
    assert_eq!(Accelerator::build(&[], &[]).closest_hit(&ray), None);
    assert!(!Accelerator::build(&[], &[fixed(3)]).occluded(&ray));
    assert_eq!(scene(Mesh::default()).closest_hit(&ray), None);
    let good = [Vec3::ZERO, Vec3::X, Vec3::Y];
    let hit = scene(mesh(&[good])).closest_hit(&ray);
    assert!(hit.is_some_and(|h| h.t == 1.0 && (h.b1 - 0.1).abs() < 1e-6 && (h.b2 - 0.1).abs() < 1e-6), "{hit:?}");
    let bad = [
        [Vec3::ZERO; 3],
        [Vec3::ZERO, Vec3::X, Vec3::X * 0.5],
        [Vec3::ZERO, Vec3::splat(f32::NAN), Vec3::Y],
        [Vec3::ZERO, Vec3::X * f32::INFINITY, Vec3::Y],
        [Vec3::ZERO, Vec3::X * 1e20, Vec3::Y * 1e20],
        [Vec3::ZERO, Vec3::X * 3e38, Vec3::Y * -3e38],
    ];
    let mut with_bad = mesh(&[&bad[..], &[good]].concat());
    with_bad.triangles.push([0, 1, 1000]);
    let accelerator = scene(with_bad);
    assert_eq!(accelerator.closest_hit(&ray).map(|h| (h.t, h.triangle)), Some((1.0, 6)));
    assert_eq!(scene(mesh(&bad)).closest_hit(&ray), None);
}

#[test]
fn rays_that_are_not_finite_meet_nothing() {
    let accelerator = scene(soup(15, 100, 1.0));
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for axis in 0..3 {
            let (mut o, mut d) = (Vec3::ZERO, Vec3::X);
            d[axis] = value;
            assert_eq!(accelerator.closest_hit(&Ray::new(Vec3::ZERO, d)), None);
            o[axis] = value;
            assert_eq!(accelerator.closest_hit(&Ray::new(o, Vec3::X)), None);
        }
    }
    assert_eq!(accelerator.closest_hit(&Ray::new(Vec3::ZERO, Vec3::ZERO)), None);
    assert_eq!(accelerator.closest_hit(&Ray::segment(Vec3::ZERO, Vec3::X, f32::NAN)), None);
    assert_eq!(accelerator.closest_hit(&Ray::segment(Vec3::ZERO, Vec3::X, -1.0)), None);
    // Finite but absurd rays do not panic.
    for scale in [1e-38, 1e-20, 1e20, 1e38] {
        for ray in rays(16, 200) {
            let _ = accelerator.closest_hit(&Ray::new(ray.origin * scale, ray.direction * scale));
            let _ = accelerator.occluded(&Ray::new(ray.origin, ray.direction * scale));
        }
    }
}

#[test]
fn hits_lie_within_the_triangle_and_the_interval() {
    let accelerator = scene(soup(17, 2000, 0.3));
    for ray in rays(18, 5000) {
        if let Some(hit) = accelerator.closest_hit(&ray) {
            assert!(hit.t > 0.0 && hit.t < ray.t_max);
            assert!(hit.b1 >= 0.0 && hit.b2 >= 0.0 && hit.b1 + hit.b2 <= 1.0 + f32::EPSILON, "{hit:?}");
        }
    }
}

#[test]
fn the_tree_does_not_depend_on_the_number_of_threads() {
    let build = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        let accelerator = pool.install(|| scene(soup(19, 20_000, 0.05)));
        let group = accelerator.fixed.expect("triangles");
        format!("{:?} {:?}", group.tree, group.blocks)
    };
    assert!(build(1) == build(4));
}

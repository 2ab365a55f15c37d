//! Tangents from texture coordinates, where a material has a normal map and the mesh has none.
//!
//! Mikkelsen (2008), "Simulation of Wrinkled Surfaces Revisited", §3.1: per corner the texture's u direction, weighted
//! by the corner's angle, summed over the triangles around a vertex that agree in handedness; vertices where they
//! disagree are split.

use super::shading::{orthogonal_tangent, unit64};
use crate::geometry::Mesh;
use crate::math::ops;
use glam::{DVec3, Vec2, Vec3};

/// Fills `mesh.tangents` from coordinate set `uv_set`. A mesh without that set stays as it is; one without normals
/// is taken apart into single triangles first, because its faces share no tangents.
pub(super) fn generate(mesh: &mut Mesh, uv_set: usize) {
    if mesh.uvs.get(uv_set).is_none_or(Option::is_none) {
        return;
    }
    if mesh.normals.is_none() {
        let corners: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
        select_vertices(mesh, &corners);
        mesh.triangles = (0..corners.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    }
    let frames: Vec<Option<Direction>> = mesh.triangles.iter().map(|t| direction(mesh, uv_set, *t)).collect();
    let signs = split_by_handedness(mesh, &frames);
    let mut sums = vec![DVec3::ZERO; mesh.positions.len()];
    for (triangle, frame) in mesh.triangles.iter().zip(&frames) {
        let Some(frame) = frame else { continue };
        let points = triangle.map(|v| position(mesh, v));
        for corner in 0..3 {
            let angle = corner_angle(points[corner], points[(corner + 1) % 3], points[(corner + 2) % 3]);
            if let Some(sum) = sums.get_mut(triangle[corner] as usize) {
                *sum += frame.u * f64::from(angle);
            }
        }
    }
    let normals = mesh.normals.clone().unwrap_or_else(|| face_normals(mesh));
    let tangents = sums.iter().zip(&normals).zip(&signs);
    mesh.tangents = Some(tangents.map(|((sum, n), sign)| orthogonal_tangent(*n, *sum).extend(*sign)).collect());
}

/// Unit direction of growing u on a triangle, and whether the texture is mirrored there.
struct Direction {
    u: DVec3,
    sign: f32,
}

/// `None` where the texture coordinates span no area.
fn direction(mesh: &Mesh, uv_set: usize, triangle: [u32; 3]) -> Option<Direction> {
    let uvs = mesh.uvs.get(uv_set)?.as_ref()?;
    let uv = |v: u32| uvs.get(v as usize).copied().unwrap_or(Vec2::ZERO).as_dvec2();
    let [a, b, c] = triangle;
    let (e1, e2) = (position(mesh, b) - position(mesh, a), position(mesh, c) - position(mesh, a));
    let (d1, d2) = (uv(b) - uv(a), uv(c) - uv(a));
    let determinant = d1.x * d2.y - d2.x * d1.y;
    let u = (e1 * d2.y - e2 * d1.y) * determinant.signum();
    let u = unit64(u).filter(|_| determinant != 0.0)?.as_dvec3();
    // A normal map's green points up in the image, and glTF's v runs down: the bitangent cross(normal, tangent) · w
    // points along falling v, so the sign is the opposite of MikkTSpace's, whose v runs up.
    Some(Direction { u, sign: if determinant > 0.0 { -1.0 } else { 1.0 } })
}

/// Duplicates vertices shared by mirrored and unmirrored triangles; returns each vertex's sign.
fn split_by_handedness(mesh: &mut Mesh, frames: &[Option<Direction>]) -> Vec<f32> {
    let mut signs = vec![0.0f32; mesh.positions.len()];
    let mut origin: Vec<u32> = (0..signs.len() as u32).collect();
    let mut twin: Vec<Option<u32>> = vec![None; signs.len()];
    for (triangle, frame) in mesh.triangles.iter_mut().zip(frames) {
        let Some(frame) = frame else { continue };
        for vertex in triangle.iter_mut() {
            let Some(sign) = signs.get_mut(*vertex as usize) else { continue };
            if *sign == 0.0 {
                *sign = frame.sign;
            }
            if *sign == frame.sign {
                continue;
            }
            let Some(slot) = twin.get_mut(*vertex as usize) else { continue };
            let original = *vertex;
            *vertex = *slot.get_or_insert_with(|| {
                origin.push(original);
                (origin.len() - 1) as u32
            });
            if signs.len() < origin.len() {
                signs.push(frame.sign);
            }
        }
    }
    if origin.len() > mesh.positions.len() {
        select_vertices(mesh, &origin);
    }
    signs.iter().map(|s| if *s == 0.0 { 1.0 } else { *s }).collect()
}

/// Replaces the mesh's vertices by copies of those listed; triangles stay as they are.
fn select_vertices(mesh: &mut Mesh, list: &[u32]) {
    fn pick<T: Copy + Default>(values: &[T], list: &[u32]) -> Vec<T> {
        list.iter().map(|v| values.get(*v as usize).copied().unwrap_or_default()).collect()
    }
    mesh.positions = pick(&mesh.positions, list);
    mesh.normals = mesh.normals.as_ref().map(|n| pick(n, list));
    mesh.colors = mesh.colors.as_ref().map(|c| pick(c, list));
    for uvs in &mut mesh.uvs {
        *uvs = uvs.as_ref().map(|u| pick(u, list));
    }
}

fn position(mesh: &Mesh, vertex: u32) -> DVec3 {
    mesh.positions.get(vertex as usize).copied().unwrap_or(Vec3::ZERO).as_dvec3()
}

fn corner_angle(at: DVec3, b: DVec3, c: DVec3) -> f32 {
    match (unit64(b - at), unit64(c - at)) {
        (Some(b), Some(c)) => ops::acos(b.dot(c)),
        _ => 0.0,
    }
}

/// Face normals of a mesh whose triangles share no vertices.
fn face_normals(mesh: &Mesh) -> Vec<Vec3> {
    let mut normals = vec![Vec3::Z; mesh.positions.len()];
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| position(mesh, v));
        for vertex in triangle {
            if let Some(normal) = normals.get_mut(*vertex as usize) {
                *normal = unit64((b - a).cross(c - a)).unwrap_or(Vec3::Z);
            }
        }
    }
    normals
}

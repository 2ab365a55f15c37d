//! Normals and tangents of unit length, whatever the file holds.

use glam::{DVec3, Vec3, Vec4};

/// Scales normals to unit length. Those of length zero become the area-weighted mean of the faces around them.
/// Returns how many those are.
pub(super) fn repair_normals(normals: &mut [Vec3], positions: &[Vec3], triangles: &[[u32; 3]]) -> usize {
    let mut broken = Vec::new();
    for (vertex, normal) in normals.iter_mut().enumerate() {
        match unit(*normal) {
            Some(n) => *normal = n,
            None => broken.push(vertex),
        }
    }
    if broken.is_empty() {
        return 0;
    }
    let mut sums = vec![DVec3::ZERO; normals.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|v| positions.get(v as usize).copied().unwrap_or_default().as_dvec3());
        for vertex in triangle {
            if let Some(sum) = sums.get_mut(*vertex as usize) {
                *sum += (b - a).cross(c - a);
            }
        }
    }
    for &vertex in &broken {
        let made = sums.get(vertex).and_then(|sum| unit64(*sum)).unwrap_or(Vec3::Z);
        if let Some(normal) = normals.get_mut(vertex) {
            *normal = made;
        }
    }
    broken.len()
}

/// Tangents orthogonal to their normals, of unit length, handedness ±1.
pub(super) fn unit_tangents(raw: impl Iterator<Item = Vec4>, normals: &[Vec3]) -> Vec<Vec4> {
    raw.zip(normals)
        .map(|(t, n)| {
            let sign = if t.w < 0.0 { -1.0 } else { 1.0 };
            orthogonal_tangent(*n, t.truncate().as_dvec3()).extend(sign)
        })
        .collect()
}

/// The unit vector nearest to `tangent` that is orthogonal to the unit vector `normal`; any one where there is none.
pub(super) fn orthogonal_tangent(normal: Vec3, tangent: DVec3) -> Vec3 {
    let n = normal.as_dvec3();
    let unit_tangent = unit64(tangent).map_or(DVec3::ZERO, |t| t.as_dvec3());
    let flat = unit_tangent - n * n.dot(unit_tangent);
    let made = if flat.length_squared() > 1e-12 { unit64(flat) } else { None };
    made.unwrap_or_else(|| normal.any_orthonormal_vector())
}

/// `v` scaled to unit length, unless it is zero.
pub(super) fn unit(v: Vec3) -> Option<Vec3> {
    unit64(v.as_dvec3())
}

/// [`unit()`] in double precision; no single-precision length over- or underflows.
pub(super) fn unit64(v: DVec3) -> Option<Vec3> {
    let largest = v.abs().max_element();
    if !(largest > 0.0 && largest.is_finite()) {
        return None;
    }
    let scaled = v / largest;
    Some((scaled / scaled.length_squared().sqrt()).as_vec3())
}

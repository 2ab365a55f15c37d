//! Meshes placed by a transform that squashes them flat: they have no inverse transform, so the squashed shape itself
//! becomes a mesh.

use crate::geometry::Mesh;
use glam::{DAffine3, DMat3, DVec3};

/// Relative determinant below which a transform counts as flat: rounding leaves about 1e-16 where there should be 0.
const FLATNESS: f64 = 1e-12;

/// True when the transform maps space to a plane, a line or a point.
pub(super) fn is_flat(transform: &DAffine3) -> bool {
    let m = transform.matrix3;
    let volume = m.x_axis.length() * m.y_axis.length() * m.z_axis.length();
    let determinant = m.determinant().abs();
    determinant <= FLATNESS * volume || determinant.is_nan()
}

/// The mesh as `transform` leaves it, with flat normals, and the translation that remains. `None` when no triangle
/// keeps an area.
pub(super) fn flattened(mesh: &Mesh, transform: &DAffine3) -> Option<(Mesh, DAffine3)> {
    let mut flat = Mesh { normals: None, tangents: None, ..mesh.clone() };
    for position in &mut flat.positions {
        *position = (transform.matrix3 * position.as_dvec3()).as_vec3();
    }
    let at = |v: u32| flat.positions.get(v as usize).map_or(DVec3::ZERO, |p| p.as_dvec3());
    let mut triangles = std::mem::take(&mut flat.triangles);
    triangles.retain(|[a, b, c]| (at(*b) - at(*a)).cross(at(*c) - at(*a)) != DVec3::ZERO);
    flat.triangles = triangles;
    let finite = flat.positions.iter().all(|p| p.is_finite());
    let translation = DAffine3 { matrix3: DMat3::IDENTITY, translation: transform.translation };
    (finite && !flat.triangles.is_empty()).then_some((flat, translation))
}

//! A point on a surface, with everything that shading needs.

use super::{Hit, Instance, Mesh, Transform};
use glam::{DMat3, DVec3, Vec2, Vec3};

/// Least cosine between shading and geometric normal: normals that lean beyond are brought back to it.
const MIN_NORMAL_COSINE: f32 = 1e-3;

/// A point on a surface.
#[derive(Clone, Copy, Debug)]
pub struct SurfacePoint {
    /// Position in scene space, computed from barycentric coordinates.
    pub position: Vec3,
    /// Conservative bound on the absolute rounding error of `position`, per axis.
    pub error: Vec3,
    /// Unit geometric normal, on the front side (counter-clockwise).
    pub ng: Vec3,
    /// Unit shading normal (interpolated, before normal mapping), in the hemisphere of `ng`.
    pub ns: Vec3,
    /// Unit tangent along increasing u of the normal map's texture set with handedness, if the mesh has one.
    pub tangent: Option<(Vec3, f32)>,
    /// Texture coordinates, sets 0 and 1 (zero where absent).
    pub uv: [Vec2; 2],
    /// Vertex colour (white where absent), linear RGBA.
    pub color: [f32; 4],
    /// Index of the material.
    pub material: u32,
    /// Index of the instance.
    pub instance: u32,
    /// Index of the triangle in its mesh.
    pub triangle: u32,
}

impl SurfacePoint {
    /// The point where a ray met `instance` of `mesh`. Panics if the hit is not one of this mesh (an index out of range).
    ///
    /// The position is computed from the barycentric coordinates in double precision and rounded once, so that the bound
    /// on its error is half a unit in the last place; with a transform, the rounding of ray origins in object space is
    /// added, mapped to the scene (compare pbrt 4th ed., §6.8.5, where single precision needs γ(7) and more). `ng` is
    /// the normal of the corners counter-clockwise in object space, so the front stays the front under a mirroring
    /// transform. Vertex normals that oppose the winding are flipped, those that lean over are brought back.
    #[inline]
    pub fn from_hit(mesh: &Mesh, instance: &Instance, hit: &Hit) -> SurfacePoint {
        Self::of_hit::<true>(mesh, instance, hit)
    }
    /// The same without tangent, texture coordinates and colour, for scenes where nothing reads them.
    #[inline]
    pub fn from_hit_bare(mesh: &Mesh, instance: &Instance, hit: &Hit) -> SurfacePoint {
        Self::of_hit::<false>(mesh, instance, hit)
    }

    fn of_hit<const ATTRIBUTES: bool>(mesh: &Mesh, instance: &Instance, hit: &Hit) -> SurfacePoint {
        let indices = mesh.triangles[hit.triangle as usize].map(|v| v as usize);
        let weights = [1.0 - hit.b1 - hit.b2, hit.b1, hit.b2];
        let placement = Placement::new(instance.transform.as_ref());
        let corners = indices.map(|v| mesh.positions[v].as_dvec3());
        let (position, error) = placement.position(corners, hit);
        let [a, b, c] = corners;
        let ng = (placement.normals * (b - a).cross(c - a)).normalize().as_vec3();

        let vertex_normals = mesh.normals.as_ref().map(|normals| indices.map(|v| normals[v]));
        let (ns, flipped) = vertex_normals.map_or((ng, false), |n| shading_normal(n, weights, &placement, ng));
        let tangent = mesh.tangents.as_ref().filter(|_| ATTRIBUTES).and_then(|tangents| {
            let t = indices.map(|v| tangents[v].truncate());
            let direction = (placement.map * interpolate(t, weights).as_dvec3()).try_normalize()?.as_vec3();
            // Mirroring and flipping turn the cross product of normal and tangent around, but not the bitangent.
            let sign = if placement.mirrors != flipped { -1.0 } else { 1.0 };
            Some((direction, sign * tangents[indices[0]].w.signum()))
        });
        let uv = |set: &Option<Vec<Vec2>>| {
            set.as_ref().filter(|_| ATTRIBUTES).map_or(Vec2::ZERO, |uv| {
                let [a, b, c] = indices.map(|v| uv[v]);
                a * weights[0] + b * weights[1] + c * weights[2]
            })
        };
        let color = mesh.colors.as_ref().filter(|_| ATTRIBUTES).map_or([1.0; 4], |colors| {
            let [a, b, c] = indices.map(|v| colors[v]);
            std::array::from_fn(|i| a[i] * weights[0] + b[i] * weights[1] + c[i] * weights[2])
        });
        SurfacePoint {
            position,
            error,
            ng,
            ns,
            tangent,
            uv: [uv(&mesh.uvs[0]), uv(&mesh.uvs[1])],
            color,
            material: mesh.material,
            instance: hit.instance,
            triangle: hit.triangle,
        }
    }

    /// Origin of a ray that leaves this point towards `direction`: moved along the geometric normal, to the side of
    /// `direction`, by the bound on the position's rounding error (pbrt 4th ed., §6.8.6), never by a constant.
    #[inline]
    pub fn spawn(&self, direction: Vec3) -> Vec3 {
        offset_origin(self.position, self.error, self.ng, direction)
    }

    /// End of a segment that leaves another surface at `origin` and must not reach this one: moved off it, to the side of
    /// `origin`, by the bound on the position's rounding error and on that of the ray. The direction's rounding, and that of
    /// the distance at which the ray would meet the surface, move its end by a few units in the last place of its length.
    #[inline]
    pub fn arrival(&self, origin: Vec3) -> Vec3 {
        let back = origin - self.position;
        let along = Vec3::splat(8.0 * f32::EPSILON * back.length());
        offset_origin(self.position, self.error + along, self.ng, back)
    }
}

/// `position` moved along the unit `normal`, to the side of `direction`, by the bound `error` on its rounding error per axis
/// (pbrt 4th ed., §6.8.6): the origin of a ray that leaves a surface there.
#[inline]
pub fn offset_origin(position: Vec3, error: Vec3, normal: Vec3, direction: Vec3) -> Vec3 {
    let d = normal.abs().dot(error);
    let side = if direction.dot(normal) < 0.0 { -1.0 } else { 1.0 };
    let offset = normal * (d * side);
    let p = position + offset;
    // Round away from the surface, so that the sum's own rounding cannot undo the offset.
    let away = |p: f32, o: f32| match o {
        o if o > 0.0 => p.next_up(),
        o if o < 0.0 => p.next_down(),
        _ => p,
    };
    Vec3::new(away(p.x, offset.x), away(p.y, offset.y), away(p.z, offset.z))
}

#[inline]
fn interpolate([a, b, c]: [Vec3; 3], weights: [f32; 3]) -> Vec3 {
    a * weights[0] + b * weights[1] + c * weights[2]
}

/// The unit interpolated normal in the hemisphere of `ng`, and whether it had to be flipped.
fn shading_normal(vertex_normals: [Vec3; 3], weights: [f32; 3], placement: &Placement, ng: Vec3) -> (Vec3, bool) {
    let to_scene = |n: Vec3| (placement.normals * n.as_dvec3()).normalize_or_zero().as_vec3();
    // The whole triangle is flipped or none of it, so that the normal stays continuous.
    let flipped = to_scene(vertex_normals[0] + vertex_normals[1] + vertex_normals[2]).dot(ng) < 0.0;
    let n = to_scene(interpolate(vertex_normals, weights));
    let n = if flipped { -n } else { n };
    let cosine = n.dot(ng);
    if !n.is_finite() || n == Vec3::ZERO {
        (ng, flipped)
    } else if cosine < MIN_NORMAL_COSINE {
        ((n + ng * (MIN_NORMAL_COSINE - cosine)).normalize_or(ng), flipped)
    } else {
        (n, flipped)
    }
}

/// An instance's map to the scene in double precision.
struct Placement {
    /// Linear part.
    map: DMat3,
    /// Translation.
    shift: DVec3,
    /// Maps object normals to scene normals, up to a positive factor.
    normals: DMat3,
    /// Whether the map is not the identity.
    moved: bool,
    /// Whether it mirrors.
    mirrors: bool,
}

impl Placement {
    fn new(transform: Option<&Transform>) -> Self {
        let Some(transform) = transform else {
            let one = DMat3::IDENTITY;
            return Placement { map: one, shift: DVec3::ZERO, normals: one, moved: false, mirrors: false };
        };
        let map = transform.to_scene.matrix3.as_dmat3();
        let (x, y, z) = (map.x_axis, map.y_axis, map.z_axis);
        // The cofactors are the inverse transpose times the determinant.
        let cofactors = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y));
        let mirrors = x.dot(cofactors.x_axis) < 0.0;
        let normals = if mirrors { -1.0 * cofactors } else { cofactors };
        Placement { map, shift: transform.to_scene.translation.as_dvec3(), normals, moved: true, mirrors }
    }

    /// The point of a hit in scene space, and the bound on its error.
    fn position(&self, [a, b, c]: [DVec3; 3], hit: &Hit) -> (Vec3, Vec3) {
        /// One rounding to single precision, with room for the roundings of the bound itself.
        const SINGLE: f64 = (1.0 + 1e-5) / 16_777_216.0;
        /// A few roundings in double precision.
        const DOUBLE: f64 = 16.0 * f64::EPSILON;
        let object = a + hit.b1 as f64 * (b - a) + hit.b2 as f64 * (c - a);
        let size = a.abs().max(b.abs()).max(c.abs());
        if !self.moved {
            let error = SINGLE * object.abs() + DOUBLE * size;
            return (object.as_vec3(), error.as_vec3());
        }
        let point = self.map * object + self.shift;
        let spread = DMat3::from_cols(self.map.x_axis.abs(), self.map.y_axis.abs(), self.map.z_axis.abs());
        let error = SINGLE * (point.abs() + spread * object.abs()) + DOUBLE * (spread * size + self.shift.abs());
        (point.as_vec3(), error.as_vec3())
    }
}

#[cfg(test)]
mod tests;

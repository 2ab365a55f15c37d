//! A point on a surface, with everything that shading needs.

use glam::{Vec2, Vec3};

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
    /// Origin of a ray that leaves this point towards `direction`: moved along the geometric normal, to the side of
    /// `direction`, by the bound on the position's rounding error (pbrt 4th ed., §6.8.6), never by a constant.
    #[inline]
    pub fn spawn(&self, direction: Vec3) -> Vec3 {
        let d = self.ng.abs().dot(self.error);
        let side = if direction.dot(self.ng) < 0.0 { -1.0 } else { 1.0 };
        let offset = self.ng * (d * side);
        let p = self.position + offset;
        // Round away from the surface, so that the sum's own rounding cannot undo the offset.
        let away = |p: f32, o: f32| {
            if o > 0.0 {
                p.next_up()
            } else if o < 0.0 {
                p.next_down()
            } else {
                p
            }
        };
        Vec3::new(away(p.x, offset.x), away(p.y, offset.y), away(p.z, offset.z))
    }
}

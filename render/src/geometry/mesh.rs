//! Triangle meshes as arrays, and their instances.

use super::Bounds;
use glam::{Affine3A, DAffine3, Mat3, Vec2, Vec3, Vec4};

/// One glTF primitive: triangles with one material. All attribute arrays have one entry per vertex.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Vertex positions; finite.
    pub positions: Vec<Vec3>,
    /// Triangles, counter-clockwise seen from the front; every index < `positions.len()`.
    pub triangles: Vec<[u32; 3]>,
    /// Unit vertex normals, where the surface is smooth; `None` means flat.
    pub normals: Option<Vec<Vec3>>,
    /// Tangents (xyz unit, w = handedness ±1), where normal maps need them.
    pub tangents: Option<Vec<Vec4>>,
    /// Texture coordinate sets 0 and 1.
    pub uvs: [Option<Vec<Vec2>>; 2],
    /// Linear vertex colours, multiplied into the base colour.
    pub colors: Option<Vec<[f32; 4]>>,
    /// Index of the material.
    pub material: u32,
}

/// Affine map between an instance's object space and scene space.
#[derive(Clone, Copy, Debug)]
pub struct Transform {
    /// Object to scene.
    pub to_scene: Affine3A,
    /// Scene to object.
    pub to_object: Affine3A,
    /// Maps object normals to scene normals (inverse transpose), including the sign of a mirroring transform so that
    /// counter-clockwise stays front.
    pub normal_to_scene: Mat3,
}

/// One placement of a mesh.
#[derive(Clone, Debug)]
pub struct Instance {
    /// Index of the mesh.
    pub mesh: u32,
    /// `None`: the mesh's vertices are already in scene space (it is used once).
    pub transform: Option<Transform>,
    /// Index of the first triangle of this instance in the scene's list of emissive triangles, where it emits.
    pub first_emitter: Option<u32>,
}

impl Mesh {
    /// Bytes held.
    pub fn memory_bytes(&self) -> usize {
        let per_vertex = size_of::<Vec3>() * (1 + usize::from(self.normals.is_some()))
            + size_of::<Vec4>() * usize::from(self.tangents.is_some())
            + size_of::<Vec2>() * self.uvs.iter().flatten().count()
            + size_of::<[f32; 4]>() * usize::from(self.colors.is_some());
        self.positions.len() * per_vertex + self.triangles.len() * size_of::<[u32; 3]>()
    }

    /// Box around all vertices, in the mesh's own space.
    pub fn bounds(&self) -> Bounds {
        Bounds::of(self.positions.iter().copied())
    }

    /// Corners of triangle `triangle` of this mesh in scene space, in the mesh's order. Panics if an index is out of
    /// range.
    #[inline]
    pub fn triangle_positions(&self, triangle: u32, instance: &Instance) -> [Vec3; 3] {
        let corners = self.triangles[triangle as usize].map(|v| self.positions[v as usize]);
        match &instance.transform {
            None => corners,
            Some(transform) => corners.map(|p| transform.to_scene.transform_point3(p)),
        }
    }

    /// Area of triangle `triangle` in scene space. Panics if an index is out of range.
    #[inline]
    pub fn area(&self, triangle: u32, instance: &Instance) -> f32 {
        let [a, b, c] = self.triangle_positions(triangle, instance).map(|p| p.as_dvec3());
        (0.5 * (b - a).cross(c - a).length()) as f32
    }
}

impl Transform {
    /// A transform by its double-precision map from object to scene.
    ///
    /// A mirroring map (negative determinant) turns counter-clockwise triangles into clockwise ones. What the author
    /// made the front stays the front: [`Transform::normal_to_scene`] is the inverse transpose without any change of
    /// sign, so that it maps the object-space normal (counter-clockwise by the vertices' order) to the scene-space
    /// normal of the same side. It is *not* the cross product of the mapped edges, which points to the other side if the
    /// map mirrors. `Mesh::triangle_positions` keeps the vertices' order, so there counter-clockwise is the back.
    ///
    /// A map without an inverse gives entries that are not finite; the accelerator leaves such instances out.
    pub fn new(to_scene: DAffine3) -> Self {
        let to_object = to_scene.inverse();
        let single = |a: DAffine3| Affine3A::from_mat3_translation(a.matrix3.as_mat3(), a.translation.as_vec3());
        Transform {
            to_scene: single(to_scene),
            to_object: single(to_object),
            normal_to_scene: to_object.matrix3.transpose().as_mat3(),
        }
    }
}

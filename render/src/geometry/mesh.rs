//! Triangle meshes as arrays, and their instances.

use glam::{Affine3A, Mat3, Vec2, Vec3, Vec4};

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

//! Scenes made in code, with known answers.

use gatherlight_render::geometry::{Mesh, SurfacePoint};
use gatherlight_render::material::{Bsdf, Material, Textures};
use gatherlight_render::math::Rgb;
use gatherlight_render::scene::description::{
    CameraDescription, InstanceDescription, LightDescription, LightKind, MaterialDescription, Projection,
    SceneDescription,
};
use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3};
use std::collections::BTreeMap;

/// Assembles a scene part by part.
#[derive(Default)]
pub struct SceneMaker {
    /// The scene so far.
    pub scene: SceneDescription,
}

impl SceneMaker {
    /// An empty scene.
    pub fn new() -> Self {
        Self::default()
    }
    /// Adds a material and returns its index.
    pub fn material(&mut self, m: MaterialDescription) -> u32 {
        self.scene.materials.push(m);
        self.scene.materials.len() as u32 - 1
    }
    /// Adds a mesh once, at the identity.
    pub fn mesh(&mut self, mesh: Mesh) -> &mut Self {
        self.scene.meshes.push(mesh);
        let mesh = self.scene.meshes.len() - 1;
        self.scene.instances.push(InstanceDescription {
            mesh,
            to_world: DAffine3::IDENTITY,
            name: format!("node{mesh}"),
        });
        self
    }
    /// Adds a light shining along `direction` from `position`.
    pub fn light(&mut self, kind: LightKind, intensity: Rgb, position: DVec3, direction: DVec3) -> &mut Self {
        let to_world = look_along(position, direction);
        self.scene.lights.push(LightDescription { name: String::new(), to_world, intensity, kind });
        self
    }
    /// Adds a perspective camera at `eye` that looks at `target`.
    pub fn camera(&mut self, eye: DVec3, target: DVec3, yfov: f64) -> &mut Self {
        self.scene.cameras.push(CameraDescription {
            name: "camera".into(),
            to_world: look_along(eye, target - eye),
            projection: Projection::Perspective { yfov, aspect: None },
        });
        self
    }
}

/// A node transform at `position` whose −z axis is `direction`.
pub fn look_along(position: DVec3, direction: DVec3) -> DAffine3 {
    let z = -direction.normalize();
    let hint = if z.y.abs() < 0.9 { DVec3::Y } else { DVec3::X };
    let x = hint.cross(z).normalize();
    DAffine3 { matrix3: DMat3::from_cols(x, z.cross(x), z), translation: position }
}

/// A parallelogram with corner `o` and edges `u`, `v`; its front is towards `u × v`.
pub fn quad(o: Vec3, u: Vec3, v: Vec3, material: u32) -> Mesh {
    Mesh {
        positions: vec![o, o + u, o + u + v, o + v],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        material,
        ..Default::default()
    }
}

/// A box with its faces' fronts outwards (`inward` = false) or inwards.
pub fn cuboid(min: Vec3, max: Vec3, inward: bool, material: u32) -> Mesh {
    let corner = |i: usize| {
        let pick = |b: usize, lo: f32, hi: f32| if i >> b & 1 == 0 { lo } else { hi };
        Vec3::new(pick(0, min.x, max.x), pick(1, min.y, max.y), pick(2, min.z, max.z))
    };
    let faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let mut triangles = Vec::new();
    for f in faces {
        for t in [[f[0], f[1], f[2]], [f[0], f[2], f[3]]] {
            triangles.push(if inward { [t[0], t[2], t[1]] } else { t });
        }
    }
    Mesh { positions: (0..8).map(corner).collect(), triangles, material, ..Default::default() }
}

/// A sphere from an icosahedron subdivided `levels` times: 20 · 4^levels triangles, fronts outwards or `inward`.
pub fn sphere(center: Vec3, radius: f32, levels: u32, smooth: bool, inward: bool, material: u32) -> Mesh {
    let g = (1.0 + 5f32.sqrt()) * 0.5;
    let mut points: Vec<Vec3> = [(0., 1., g), (0., -1., g), (0., 1., -g), (0., -1., -g)]
        .iter()
        .flat_map(|&(a, b, c)| [Vec3::new(a, b, c), Vec3::new(b, c, a), Vec3::new(c, a, b)])
        .map(Vec3::normalize)
        .collect();
    // The faces of the icosahedron are the triples of mutually nearest vertices.
    let near = |a: Vec3, b: Vec3| a.dot(b) > 0.4 && a.dot(b) < 0.9;
    let mut triangles = Vec::new();
    for i in 0..12u32 {
        for j in i + 1..12 {
            for k in j + 1..12 {
                let (a, b, c) = (points[i as usize], points[j as usize], points[k as usize]);
                if near(a, b) && near(b, c) && near(a, c) {
                    let out = (b - a).cross(c - a).dot(a) > 0.0;
                    triangles.push(if out { [i, j, k] } else { [i, k, j] });
                }
            }
        }
    }
    for _ in 0..levels {
        let mut middle: BTreeMap<(u32, u32), u32> = BTreeMap::new();
        let mut next = Vec::with_capacity(triangles.len() * 4);
        for t in &triangles {
            let m: [u32; 3] = std::array::from_fn(|e| {
                let (a, b) = (t[e], t[(e + 1) % 3]);
                *middle.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    points.push((points[a as usize] + points[b as usize]).normalize());
                    points.len() as u32 - 1
                })
            });
            next.extend([[t[0], m[0], m[2]], [t[1], m[1], m[0]], [t[2], m[2], m[1]], m]);
        }
        triangles = next;
    }
    let sign = if inward { -1.0 } else { 1.0 };
    let normals = smooth.then(|| points.iter().map(|p| *p * sign).collect());
    if inward {
        triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    Mesh {
        positions: points.iter().map(|p| center + *p * radius).collect(),
        triangles,
        normals,
        material,
        ..Default::default()
    }
}

/// A closed box whose every wall emits `le` and reflects `albedo`: radiance Le / (1 − albedo) everywhere.
pub fn enclosure(albedo: f32, le: f32) -> SceneDescription {
    let mut s = SceneMaker::new();
    let wall = s.material(MaterialDescription {
        emission: Rgb::splat(le),
        ..MaterialDescription::lambert("wall", Rgb::splat(albedo))
    });
    s.mesh(cuboid(Vec3::splat(-1.0), Vec3::splat(1.0), true, wall));
    s.camera(DVec3::new(0.1, 0.2, 0.3), DVec3::new(0.7, -0.4, -1.0), 1.0);
    s.scene
}

/// A room lit only through glass: a large lamp enclosed by a glass body under the ceiling, so that BSDF sampling finds
/// it, and both path tracing and photons converge.
pub fn lamp_in_glass() -> SceneDescription {
    let mut s = SceneMaker::new();
    let wall = s.material(MaterialDescription::lambert("wall", Rgb::new(0.6, 0.5, 0.4)));
    let lamp = s.material(MaterialDescription::emitter("lamp", Rgb::new(4.0, 3.0, 2.0)));
    let glass = s.material(MaterialDescription::glass("glass", 1.5));
    s.mesh(cuboid(Vec3::splat(-1.0), Vec3::splat(1.0), true, wall));
    s.mesh(sphere(Vec3::new(0.1, 0.2, 0.0), 0.3, 3, true, false, lamp));
    s.mesh(cuboid(Vec3::new(-0.35, -0.2, -0.4), Vec3::new(0.5, 0.6, 0.4), false, glass));
    s.camera(DVec3::new(0.0, 0.0, 0.95), DVec3::new(0.0, -0.1, 0.0), 1.4);
    s.scene
}

/// The BSDF of an untextured material at the origin, where the surface has the geometric normal `ng` and the shading
/// normal `ns`, both unit.
pub fn bsdf(d: &MaterialDescription, ng: Vec3, ns: Vec3) -> Bsdf {
    let point = SurfacePoint {
        position: Vec3::ZERO,
        error: Vec3::ZERO,
        ng,
        ns,
        tangent: None,
        uv: [Vec2::ZERO; 2],
        color: [1.0; 4],
        material: 0,
        instance: 0,
        triangle: 0,
    };
    Material::new(d, 1.0).bsdf(&point, &Textures::default())
}

//! From a description to a [`Scene`]: normalise, bake single-use meshes, compile materials, collect lights.

use super::description::{CameraDescription, LightDescription, LightKind, SceneDescription};
use super::normalise::{SceneSpace, power_of_two_below};
use super::{Camera, Scene, camera};
use crate::error::SceneError;
use crate::geometry::{Accelerator, Instance, Mesh, Transform};
use crate::light::{DirectionalLight, EmissiveTriangle, Light, LightContext, Lights, PointLight, SpotLight};
use crate::material::{Material, Textures};
use crate::settings::CameraChoice;
use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3};
use std::sync::Arc;

/// Largest number of triangles, over all instances that are stored apart.
pub const MAX_TRIANGLES: u64 = u32::MAX as u64;
/// A mesh used several times is still copied into scene space when it has at most this many triangles: a copy is
/// faster to trace than an instance, and costs next to nothing.
const SMALL_MESH_TRIANGLES: usize = 64;

/// Builds the scene.
///
/// # Errors
/// When an index points nowhere, a transform is not finite, or a limit is exceeded.
pub fn build(mut description: SceneDescription) -> Result<Scene, SceneError> {
    check_indices(&description)?;
    let space = SceneSpace::from_bounds(world_bounds(&description));
    let textures = Textures::new(std::mem::take(&mut description.textures), std::mem::take(&mut description.images));
    let materials: Vec<Material> = description.materials.iter().map(|m| Material::new(m, space.scale as f32)).collect();
    let (meshes, mut instances) = place_meshes(&description, &space)?;
    let emitters = collect_emitters(&meshes, &mut instances, &materials);
    let punctual = description.lights.iter().map(|l| punctual_light(l, &space)).collect();
    let context = LightContext { materials: &materials, textures: &textures };
    let lights = Lights::build(&emitters, punctual, &context);
    let accelerator = Accelerator::build(&meshes, &instances);
    let has_alpha_masks =
        instances.iter().any(|i| materials[meshes[i.mesh as usize].material as usize].has_alpha_mask());
    let has_absorption = materials.iter().any(|m| m.absorption().is_some());
    let mut scene = Scene {
        accelerator,
        meshes,
        instances,
        materials,
        textures,
        lights,
        space,
        has_alpha_masks,
        has_absorption,
        is_bare: false,
        warnings: description.warnings,
    };
    scene.is_bare = scene.has_bare_surfaces();
    Ok(scene)
}

/// The camera that `choice` names, for an image of `width` × `height`; a framing one where the file has none.
///
/// Returns a note for the user when a default camera was made.
///
/// # Errors
/// When there is no such camera; the message lists those there are.
pub fn choose_camera(
    cameras: &[CameraDescription],
    bounds: Option<(DVec3, DVec3)>,
    space: &SceneSpace,
    choice: &CameraChoice,
    width: u32,
    height: u32,
) -> Result<(Camera, Option<String>), SceneError> {
    let found = match choice {
        CameraChoice::First => cameras.first(),
        CameraChoice::Index(i) => cameras.get(*i as usize),
        CameraChoice::Name(n) => cameras.iter().find(|c| c.name == *n),
    };
    if let Some(c) = found {
        return Ok((Camera::new(c, space, width, height), None));
    }
    if *choice == CameraChoice::First {
        let (min, max) = bounds.unwrap_or((DVec3::splat(-1.0), DVec3::splat(1.0)));
        let c = camera::framing_camera(min, max);
        let note = "the scene has no camera; using one that frames the whole scene from the front".to_string();
        return Ok((Camera::new(&c, space, width, height), Some(note)));
    }
    let wanted = match choice {
        CameraChoice::Index(i) => format!("index {i}"),
        CameraChoice::Name(n) => format!("{n:?}"),
        CameraChoice::First => "0".into(),
    };
    let list: Vec<String> = cameras.iter().enumerate().map(|(i, c)| format!("{i} {:?}", c.name)).collect();
    let list =
        if list.is_empty() { "the scene has none".to_string() } else { format!("there are {}", list.join(", ")) };
    Err(SceneError::invalid("--camera", format!("no camera {wanted}; {list}")))
}

fn check_indices(d: &SceneDescription) -> Result<(), SceneError> {
    let mut triangles = 0u64;
    for (i, m) in d.meshes.iter().enumerate() {
        if m.material as usize >= d.materials.len() {
            return Err(SceneError::invalid(format!("mesh {i}"), format!("no material {}", m.material)));
        }
        let n = m.positions.len();
        if m.triangles.iter().flatten().any(|&v| v as usize >= n) {
            return Err(SceneError::invalid(format!("mesh {i}"), format!("a triangle names a vertex beyond {n}")));
        }
        if m.positions.iter().any(|p| !p.is_finite()) {
            return Err(SceneError::invalid(format!("mesh {i}"), "a vertex position is not finite"));
        }
    }
    for i in &d.instances {
        let place = || format!("node {:?}", i.name);
        let mesh = d.meshes.get(i.mesh).ok_or_else(|| SceneError::invalid(place(), format!("no mesh {}", i.mesh)))?;
        if !i.to_world.is_finite() {
            return Err(SceneError::invalid(place(), "its transform is not finite"));
        }
        triangles += mesh.triangles.len() as u64;
    }
    if triangles > MAX_TRIANGLES {
        return Err(SceneError::Limit {
            place: "scene".into(),
            what: "the number of triangles".into(),
            actual: triangles,
            limit: MAX_TRIANGLES,
            remedy: "simplify the meshes or split the scene".into(),
        });
    }
    Ok(())
}

/// World-space box of all instances; `None` without geometry.
pub fn world_bounds(d: &SceneDescription) -> Option<(DVec3, DVec3)> {
    let mut bounds: Option<(DVec3, DVec3)> = None;
    for i in &d.instances {
        let mesh = &d.meshes[i.mesh];
        for &v in mesh.triangles.iter().flatten() {
            let p = i.to_world.transform_point3(mesh.positions[v as usize].as_dvec3());
            bounds = Some(bounds.map_or((p, p), |(lo, hi)| (lo.min(p), hi.max(p))));
        }
    }
    bounds
}

type Placed = (Vec<Arc<Mesh>>, Vec<Instance>);

fn place_meshes(d: &SceneDescription, space: &SceneSpace) -> Result<Placed, SceneError> {
    let mut uses = vec![0usize; d.meshes.len()];
    for i in &d.instances {
        uses[i.mesh] += 1;
    }
    let (mut meshes, mut instances) = (Vec::new(), Vec::new());
    let mut shared: Vec<Option<(u32, DAffine3)>> = vec![None; d.meshes.len()];
    for i in &d.instances {
        let source = &d.meshes[i.mesh];
        if source.triangles.is_empty() {
            continue;
        }
        let to_scene = space.transform(i.to_world);
        if uses[i.mesh] == 1 || source.triangles.len() <= SMALL_MESH_TRIANGLES || !is_invertible(&to_scene) {
            meshes.push(Arc::new(bake(source, &to_scene)));
            instances.push(Instance { mesh: meshes.len() as u32 - 1, transform: None, first_emitter: None });
            continue;
        }
        let (mesh, from_unit) = *shared[i.mesh].get_or_insert_with(|| {
            let (mesh, from_unit) = unit_mesh(source);
            meshes.push(Arc::new(mesh));
            (meshes.len() as u32 - 1, from_unit)
        });
        let transform = Some(Transform::new(to_scene * from_unit));
        instances.push(Instance { mesh, transform, first_emitter: None });
    }
    Ok((meshes, instances))
}

/// Whether a transform can be undone in f32 without losing everything; a flat one (scale 0 along an axis) cannot.
fn is_invertible(a: &DAffine3) -> bool {
    let m = a.matrix3;
    let volume = m.determinant().abs();
    let lengths = m.x_axis.length() * m.y_axis.length() * m.z_axis.length();
    volume > 1e-6 * lengths && lengths > 0.0
}

/// Vertices into scene space, in f64 until the last step. Mirroring transforms swap the winding, so that the authored
/// front stays front (glTF 2.0 §3.7.4).
fn bake(source: &Mesh, to_scene: &DAffine3) -> Mesh {
    let m = to_scene.matrix3;
    let mirrored = m.determinant() < 0.0;
    let normal_matrix = cofactor(&m);
    let sign = if mirrored { -1.0 } else { 1.0 };
    let direction = |n: Vec3, m: &DMat3, sign: f64| {
        let v = *m * n.as_dvec3() * sign;
        v.try_normalize().unwrap_or_else(|| n.as_dvec3()).as_vec3()
    };
    let mut mesh = source.clone();
    for p in &mut mesh.positions {
        *p = to_scene.transform_point3(p.as_dvec3()).as_vec3();
    }
    if let Some(normals) = &mut mesh.normals {
        normals.iter_mut().for_each(|n| *n = direction(*n, &normal_matrix, sign));
    }
    if let Some(tangents) = &mut mesh.tangents {
        for t in tangents {
            *t = direction(t.truncate(), &m, 1.0).extend(t.w * sign as f32);
        }
    }
    if mirrored {
        mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    mesh
}

/// det(m) · m⁻ᵀ, which exists for every matrix.
fn cofactor(m: &DMat3) -> DMat3 {
    DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis))
}

/// A shared mesh moved to the origin and scaled by a power of two into radius [1, 2), with the map back.
fn unit_mesh(source: &Mesh) -> (Mesh, DAffine3) {
    let used = source.triangles.iter().flatten().map(|&v| source.positions[v as usize].as_dvec3());
    let (lo, hi) = used.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
    let center = ((lo + hi) * 0.5).as_vec3().as_dvec3();
    let radius = ((hi - lo) * 0.5).length();
    let scale = if radius > 0.0 { power_of_two_below(radius).recip() } else { 1.0 };
    let mut mesh = source.clone();
    for p in &mut mesh.positions {
        *p = ((p.as_dvec3() - center) * scale).as_vec3();
    }
    (mesh, DAffine3 { matrix3: DMat3::from_diagonal(DVec3::splat(scale.recip())), translation: center })
}

fn collect_emitters(meshes: &[Arc<Mesh>], instances: &mut [Instance], materials: &[Material]) -> Vec<EmissiveTriangle> {
    let mut emitters = Vec::new();
    for index in 0..instances.len() {
        let mesh = &meshes[instances[index].mesh as usize];
        if !materials[mesh.material as usize].is_emissive() {
            continue;
        }
        instances[index].first_emitter = Some(emitters.len() as u32);
        let instance = &instances[index];
        let mirrored = instance.transform.is_some_and(|t| t.to_scene.matrix3.determinant() < 0.0);
        for (t, &triangle) in mesh.triangles.iter().enumerate() {
            let mut p = mesh.triangle_positions(t as u32, instance);
            let mut triangle = triangle;
            if mirrored {
                // What the author made the front stays the front.
                p.swap(1, 2);
                triangle.swap(1, 2);
            }
            emitters.push(EmissiveTriangle {
                p,
                uv: triangle.map(|v| [0, 1].map(|set| mesh.uvs[set].as_ref().map_or(Vec2::ZERO, |uv| uv[v as usize]))),
                color: triangle.map(|v| mesh.colors.as_ref().map_or([1.0; 4], |c| c[v as usize])),
                material: mesh.material,
                instance: index as u32,
                triangle: t as u32,
            });
        }
    }
    emitters
}

fn punctual_light(l: &LightDescription, space: &SceneSpace) -> Light {
    let axis = (-l.to_world.matrix3.z_axis).try_normalize().unwrap_or(DVec3::NEG_Z).as_vec3();
    let position = space.point(l.to_world.translation);
    // Intensity is power per solid angle; irradiance I/d² keeps its value when lengths are scaled by s if I → I s².
    let intensity = l.intensity * (space.scale * space.scale) as f32;
    match l.kind {
        LightKind::Point => Light::Point(PointLight { position, intensity }),
        LightKind::Spot { inner, outer } => Light::Spot(SpotLight::new(position, axis, intensity, inner, outer)),
        LightKind::Directional => {
            let (scene_center, scene_radius) = (Vec3::ZERO, space.radius);
            Light::Directional(DirectionalLight {
                direction: axis,
                irradiance: l.intensity,
                scene_center,
                scene_radius,
            })
        }
    }
}

//! Scenes: description, building, the scene space, cameras and digests.

pub mod builder;
pub mod camera;
pub mod description;
pub mod digest;
pub mod normalise;
pub mod segment;
pub mod surfaces;

pub use camera::Camera;
pub use digest::SceneDigest;
pub use normalise::SceneSpace;

use crate::geometry::{Accelerator, Hit, Instance, Mesh, Ray, SurfacePoint};
use crate::light::{LightContext, Lights};
use crate::material::{Bsdf, Material, Textures};
use crate::math::Rgb;
use glam::Vec3;
use std::sync::Arc;

/// A scene ready for rendering: everything in scene space, immutable.
pub struct Scene {
    /// What rays meet.
    pub accelerator: Accelerator,
    /// Meshes by index.
    pub meshes: Vec<Arc<Mesh>>,
    /// Placements by index.
    pub instances: Vec<Instance>,
    /// Materials by index.
    pub materials: Vec<Material>,
    /// Decoded textures.
    pub textures: Textures,
    /// All lights.
    pub lights: Lights,
    /// The map to the file's world space.
    pub space: SceneSpace,
    /// Whether any material has an alpha mask, so that hits must be tested.
    pub has_alpha_masks: bool,
    /// Whether any body absorbs light, so that path segments must be told apart by the body they run through.
    pub has_absorption: bool,
    /// Whether all surfaces are [bare](surfaces::Bare).
    pub is_bare: bool,
    /// What was read but is not shown as the file asks.
    pub warnings: Vec<String>,
}

impl Scene {
    /// The nearest surface along `ray`.
    #[inline]
    pub fn intersect(&self, ray: &Ray) -> Option<SurfacePoint> {
        self.intersect_with_distance(ray).map(|(point, _)| point)
    }

    /// The nearest surface along `ray` and its distance.
    #[inline]
    pub fn intersect_with_distance(&self, ray: &Ray) -> Option<(SurfacePoint, f32)> {
        let hit = if self.has_alpha_masks {
            self.accelerator.closest_hit_where(ray, |h| self.is_solid(h))
        } else {
            self.accelerator.closest_hit(ray)
        }?;
        Some((self.surface_point(&hit), hit.t))
    }

    /// Whether anything blocks `ray` within its interval.
    #[inline]
    pub fn occluded(&self, ray: &Ray) -> bool {
        if self.has_alpha_masks {
            self.accelerator.occluded_where(ray, |h| self.is_solid(h))
        } else {
            self.accelerator.occluded(ray)
        }
    }

    /// The surface at `hit`.
    #[inline]
    pub fn surface_point(&self, hit: &Hit) -> SurfacePoint {
        let instance = &self.instances[hit.instance as usize];
        SurfacePoint::from_hit(&self.meshes[instance.mesh as usize], instance, hit)
    }

    /// The material of a surface.
    #[inline]
    pub fn material(&self, point: &SurfacePoint) -> &Material {
        &self.materials[point.material as usize]
    }

    /// How the surface at `point` scatters light.
    #[inline]
    pub fn bsdf(&self, point: &SurfacePoint) -> Bsdf {
        self.material(point).bsdf(point, &self.textures)
    }

    /// Emitted radiance at `point` towards `wo`.
    #[inline]
    pub fn emission(&self, point: &SurfacePoint, wo: Vec3) -> Rgb {
        let material = self.material(point);
        if material.is_emissive() { material.emission(point, &self.textures, wo) } else { Rgb::BLACK }
    }

    /// What evaluating a textured light needs.
    #[inline]
    pub fn light_context(&self) -> LightContext<'_> {
        LightContext { materials: &self.materials, textures: &self.textures }
    }

    /// Share of light that survives `distance` inside the body that `material` bounds (Beer and Lambert).
    #[inline]
    pub fn transmittance(&self, material: Option<u32>, distance: f32) -> Rgb {
        if !self.has_absorption {
            return Rgb::WHITE;
        }
        material.map_or(Rgb::WHITE, |m| self.materials[m as usize].transmittance(distance))
    }

    fn is_solid(&self, hit: &Hit) -> bool {
        let mesh = &self.meshes[self.instances[hit.instance as usize].mesh as usize];
        let material = &self.materials[mesh.material as usize];
        !material.has_alpha_mask() || {
            let point = self.surface_point(hit);
            material.alpha_passes(&point.uv, &point.color, &self.textures)
        }
    }

    /// Whether any surface has a diffuse lobe.
    pub fn has_diffuse(&self) -> bool {
        self.used_materials().any(Material::has_diffuse)
    }

    /// Whether any surface has a specular or glossy lobe.
    pub fn has_specular_or_glossy(&self) -> bool {
        self.used_materials().any(Material::has_specular_or_glossy)
    }

    /// Materials of the instances in the scene, one entry an instance.
    pub fn used_materials(&self) -> impl Iterator<Item = &Material> {
        self.instances.iter().map(|i| &self.materials[self.meshes[i.mesh as usize].material as usize])
    }

    /// Bytes held by geometry and textures.
    pub fn memory_bytes(&self) -> usize {
        let meshes: usize = self.meshes.iter().map(|m| m.memory_bytes()).sum();
        meshes + self.accelerator.memory_bytes() + self.textures.memory_bytes()
    }

    /// Total area of all triangles, in scene units.
    pub fn area(&self) -> f64 {
        self.instances
            .iter()
            .map(|i| {
                let mesh = &self.meshes[i.mesh as usize];
                (0..mesh.triangles.len() as u32).map(|t| f64::from(mesh.area(t, i))).sum::<f64>()
            })
            .sum()
    }
}

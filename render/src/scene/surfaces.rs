//! What the surfaces of a scene can be, known when the code that renders it is compiled: a scene of nothing but bare Lambertian
//! surfaces pays nothing for glass, layers, textures, normal maps, holes and bodies that it lacks.

use super::Scene;
use crate::geometry::{Ray, SurfacePoint};
use crate::material::{Bsdf, Lambert, Material, Scatter};

/// A kind of scene. What its functions give does not depend on it: [`Bare`] gives for the scenes that it may be asked of what
/// [`Any`] gives, bit by bit.
pub trait Surfaces: Copy + Send + Sync {
    /// How its surfaces scatter light.
    type Bsdf: Scatter;
    /// The nearest surface along `ray` and its distance.
    fn intersect(scene: &Scene, ray: &Ray) -> Option<(SurfacePoint, f32)>;
    /// How the surface at `point` scatters light.
    fn bsdf(scene: &Scene, point: &SurfacePoint) -> Self::Bsdf;
}

/// Surfaces of all kinds.
#[derive(Clone, Copy, Debug)]
pub struct Any;

/// Bare Lambertian surfaces, each of one colour, without holes: [`Scene::is_bare`].
#[derive(Clone, Copy, Debug)]
pub struct Bare;

impl Surfaces for Any {
    type Bsdf = Bsdf;
    #[inline]
    fn intersect(scene: &Scene, ray: &Ray) -> Option<(SurfacePoint, f32)> {
        scene.intersect_with_distance(ray)
    }
    #[inline]
    fn bsdf(scene: &Scene, point: &SurfacePoint) -> Bsdf {
        scene.bsdf(point)
    }
}

impl Surfaces for Bare {
    type Bsdf = Lambert;
    #[inline]
    fn intersect(scene: &Scene, ray: &Ray) -> Option<(SurfacePoint, f32)> {
        let hit = scene.accelerator.closest_hit(ray)?;
        let instance = &scene.instances[hit.instance as usize];
        let point = SurfacePoint::from_hit_bare(&scene.meshes[instance.mesh as usize], instance, &hit);
        Some((point, hit.t))
    }
    #[inline]
    fn bsdf(scene: &Scene, point: &SurfacePoint) -> Lambert {
        Lambert::new(point.ng, point.ns, scene.material(point).plain_color())
    }
}

impl Scene {
    /// Whether every surface in it is a bare Lambertian one of one colour, without holes, and no body absorbs light.
    pub(super) fn has_bare_surfaces(&self) -> bool {
        let has_colors = self.instances.iter().any(|i| self.meshes[i.mesh as usize].colors.is_some());
        !has_colors && !self.has_alpha_masks && !self.has_absorption && self.used_materials().all(Material::is_plain)
    }
}

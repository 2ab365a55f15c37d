//! The acceleration structure (the only file that names obvhs). Placeholder: brute force.

use super::{Hit, Instance, Mesh, Ray};
use std::sync::Arc;

/// Finds what a ray meets.
pub struct Accelerator {
    meshes: Vec<Arc<Mesh>>,
    instances: Vec<Instance>,
}

impl Accelerator {
    /// Builds the structure. Positions are finite.
    pub fn build(meshes: &[Arc<Mesh>], instances: &[Instance]) -> Self {
        Accelerator { meshes: meshes.to_vec(), instances: instances.to_vec() }
    }
    /// The nearest hit with 0 < t < t_max.
    pub fn closest_hit(&self, ray: &Ray) -> Option<Hit> {
        self.closest_hit_where(ray, |_| true)
    }
    /// The nearest hit that `accept` lets count (alpha masks).
    pub fn closest_hit_where(&self, ray: &Ray, accept: impl Fn(&Hit) -> bool) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        for (i, inst) in self.instances.iter().enumerate() {
            let mesh = &self.meshes[inst.mesh as usize];
            for (t, tri) in mesh.triangles.iter().enumerate() {
                let p = tri.map(|v| mesh.positions[v as usize]);
                let (e1, e2) = (p[1] - p[0], p[2] - p[0]);
                let h = ray.direction.cross(e2);
                let a = e1.dot(h);
                if a == 0.0 {
                    continue;
                }
                let s = ray.origin - p[0];
                let b1 = s.dot(h) / a;
                let q = s.cross(e1);
                let b2 = ray.direction.dot(q) / a;
                let d = e2.dot(q) / a;
                if b1 < 0.0 || b2 < 0.0 || b1 + b2 > 1.0 || d <= 0.0 || d >= best.map_or(ray.t_max, |b| b.t) {
                    continue;
                }
                let hit = Hit { t: d, b1, b2, instance: i as u32, triangle: t as u32 };
                if accept(&hit) {
                    best = Some(hit);
                }
            }
        }
        best
    }
    /// Whether anything lies at 0 < t < t_max.
    pub fn occluded(&self, ray: &Ray) -> bool {
        self.closest_hit(ray).is_some()
    }
    /// Whether anything that `accept` lets count lies at 0 < t < t_max.
    pub fn occluded_where(&self, ray: &Ray, accept: impl Fn(&Hit) -> bool) -> bool {
        self.closest_hit_where(ray, accept).is_some()
    }
    /// Bytes held.
    pub fn memory_bytes(&self) -> usize {
        0
    }
}

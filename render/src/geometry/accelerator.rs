//! The two-level acceleration structure.
//!
//! Instances without a transform are one bottom-level tree over all their triangles. Instances with a transform share a
//! tree per mesh, under a top-level tree over the instances; scenes without them have none and pay nothing for it.

use super::bounds::Bounds;
use super::bvh;
use super::simd::{Kernel, Level, Simd};
use super::traverse::{Slabs, Visitor, walk};
use super::triangle::{BLOCK, Block, Crossing, ShearedRay};
use super::wide::WideTree;
use super::{Hit, Instance, Mesh, Ray};
use glam::{DAffine3, Vec3};
use std::sync::Arc;

/// Triangles with a coordinate beyond this (in scene or object space) are never hit: products of three coordinates must
/// not overflow. Scene space has a radius below 2.
pub const MAX_COORDINATE: f32 = 1e12;

/// Finds what a ray meets.
pub struct Accelerator {
    level: Level,
    /// Triangles that are already in scene space.
    fixed: Option<Group>,
    /// By mesh: its triangles in object space, where an instance with a transform uses it.
    shared: Vec<Option<Group>>,
    /// The instances with a transform.
    top: Option<Top>,
}

/// A bottom-level tree.
struct Group {
    tree: WideTree,
    /// One block a leaf.
    blocks: Vec<Block>,
}

/// The top-level tree; leaf i is `placed[i]`.
struct Top {
    tree: WideTree,
    placed: Vec<Placed>,
}

/// An instance with a transform.
struct Placed {
    to_object: DAffine3,
    instance: u32,
    mesh: u32,
}

impl Accelerator {
    /// Builds the structure. Triangles of zero area, with a vertex that is not finite or beyond [`MAX_COORDINATE`], or
    /// with an index out of range, are left out, and so are instances without an invertible transform.
    pub fn build(meshes: &[Arc<Mesh>], instances: &[Instance]) -> Self {
        let mut fixed = Vec::new();
        let mut shared: Vec<Option<Group>> = meshes.iter().map(|_| None).collect();
        let mut placed = Vec::new();
        let mut boxes = Vec::new();
        for (index, instance) in instances.iter().enumerate() {
            let Some(mesh) = meshes.get(instance.mesh as usize) else { continue };
            let index = index as u32;
            let Some(transform) = &instance.transform else {
                fixed.extend(sound_triangles(mesh).map(|(triangle, _)| (index, instance.mesh, triangle)));
                continue;
            };
            let to_scene = DAffine3::from_mat3_translation(
                transform.to_scene.matrix3.as_dmat3(),
                transform.to_scene.translation.as_dvec3(),
            );
            let to_object = to_scene.inverse();
            let group = &mut shared[instance.mesh as usize];
            if group.is_none() {
                let triangles: Vec<_> = sound_triangles(mesh).map(|(t, _)| (0, instance.mesh, t)).collect();
                *group = Group::build(meshes, &triangles);
            }
            let Some(group) = group else { continue };
            if to_object.is_finite() {
                boxes.push(scene_bounds(group.tree.bounds, &to_scene));
                placed.push(Placed { to_object, instance: index, mesh: instance.mesh });
            }
        }
        let fixed = Group::build(meshes, &fixed);
        Accelerator { level: Level::detect(), fixed, shared, top: Top::build(&boxes, placed) }
    }

    /// The nearest hit with 0 < t < t_max. Among equally near ones, the lowest (instance, triangle). None for a ray with
    /// a coordinate that is not finite, or without a direction.
    pub fn closest_hit(&self, ray: &Ray) -> Option<Hit> {
        self.closest_hit_where(ray, |_| true)
    }

    /// The nearest hit that `accept` lets count (alpha masks). `accept` may be asked about hits that are not the nearest.
    pub fn closest_hit_where(&self, ray: &Ray, accept: impl Fn(&Hit) -> bool) -> Option<Hit> {
        if !is_sound(ray) {
            return None;
        }
        self.level.run(Closest { scene: self, ray, accept })
    }

    /// Whether anything lies at 0 < t < t_max.
    pub fn occluded(&self, ray: &Ray) -> bool {
        self.occluded_where(ray, |_| true)
    }

    /// Whether anything that `accept` lets count lies at 0 < t < t_max.
    pub fn occluded_where(&self, ray: &Ray, accept: impl Fn(&Hit) -> bool) -> bool {
        is_sound(ray) && self.level.run(Occluded { scene: self, ray, accept })
    }

    /// Bytes held.
    pub fn memory_bytes(&self) -> usize {
        let groups = self.fixed.iter().chain(self.shared.iter().flatten()).map(Group::memory_bytes).sum::<usize>();
        let top = self.top.as_ref().map_or(0, |top| top.tree.memory_bytes() + top.placed.len() * size_of::<Placed>());
        groups + top
    }
}

/// Whether a ray can meet anything.
#[inline]
fn is_sound(ray: &Ray) -> bool {
    ray.origin.is_finite() && ray.direction.is_finite() && ray.direction != Vec3::ZERO && ray.t_max > 0.0
}

/// The triangles that can be hit, with their corners.
fn sound_triangles(mesh: &Mesh) -> impl Iterator<Item = (u32, [Vec3; 3])> {
    (0..mesh.triangles.len() as u32).filter_map(|i| {
        let corners = corners(mesh, i)?;
        let within = corners.iter().all(|p| p.abs().cmple(Vec3::splat(MAX_COORDINATE)).all());
        let [a, b, c] = corners.map(|p| p.as_dvec3());
        (within && (b - a).cross(c - a) != glam::DVec3::ZERO).then_some((i, corners))
    })
}

/// A triangle's corners, if its indices are in range.
fn corners(mesh: &Mesh, triangle: u32) -> Option<[Vec3; 3]> {
    let [a, b, c] = *mesh.triangles.get(triangle as usize)?;
    let position = |i: u32| mesh.positions.get(i as usize).copied();
    Some([position(a)?, position(b)?, position(c)?])
}

/// A box in scene space around a transformed box, with room for the rounding of rays that are transformed back.
fn scene_bounds(bounds: Bounds, to_scene: &DAffine3) -> Bounds {
    const ROOM: f32 = 1e-5;
    let around = Bounds::of(bounds.corners().map(|p| to_scene.transform_point3(p.as_dvec3()).as_vec3()));
    let room = around.min.abs().max(around.max.abs()).max_element() * ROOM;
    Bounds { min: around.min - room, max: around.max + room }
}

impl Group {
    /// Builds a tree over (instance, mesh, triangle); `None` if there are none.
    fn build(meshes: &[Arc<Mesh>], triangles: &[(u32, u32, u32)]) -> Option<Self> {
        if triangles.is_empty() {
            return None;
        }
        let corners_of = |&(_, mesh, triangle): &(u32, u32, u32)| {
            meshes.get(mesh as usize).and_then(|mesh| corners(mesh, triangle)).unwrap_or_default()
        };
        let boxes: Vec<Bounds> = triangles.iter().map(|t| Bounds::of(corners_of(t))).collect();
        let collapsed = WideTree::collapse(&bvh::build(&boxes), BLOCK as u32);
        let block = |range: &[u32]| {
            let mut block = Block::EMPTY;
            for (lane, &item) in collapsed.items[range[0] as usize..range[1] as usize].iter().enumerate() {
                let triangle = &triangles[item as usize];
                block.set(lane, corners_of(triangle), triangle.0, triangle.2);
            }
            block
        };
        let blocks = collapsed.starts.windows(2).map(block).collect();
        Some(Group { tree: collapsed.tree, blocks })
    }

    fn memory_bytes(&self) -> usize {
        self.tree.memory_bytes() + self.blocks.len() * size_of::<Block>()
    }

    /// Shows `sink` the triangles that the ray meets at 0 < t ≤ `t_max`. `instance` stands for that of a shared mesh.
    #[inline(always)]
    fn meet<S: Simd>(
        &self,
        simd: S,
        (origin, direction): (Vec3, Vec3),
        t_max: f32,
        instance: Option<u32>,
        sink: &mut impl Sink,
    ) {
        let ray = ShearedRay::new(origin, direction);
        let slabs = Slabs::new(origin, direction, self.tree.bounds);
        let mut visitor = BlockVisitor { blocks: &self.blocks, ray, t_max, instance, sink };
        walk(simd, &self.tree, &slabs, t_max, &mut visitor);
    }
}

/// What is done with hits. The methods must be `#[inline(always)]`.
trait Sink {
    /// Takes a hit; gives the distance up to which hits still matter, or `None` to stop.
    fn take(&mut self, hit: Hit) -> Option<f32>;
    /// The distance up to which hits still matter, or `None` to stop.
    fn reach(&self) -> Option<f32>;
}

/// Visits the leaves of a [`Group`].
struct BlockVisitor<'a, K> {
    blocks: &'a [Block],
    ray: ShearedRay,
    t_max: f32,
    instance: Option<u32>,
    sink: &'a mut K,
}

impl<K: Sink> Visitor for BlockVisitor<'_, K> {
    #[inline(always)]
    fn visit<S: Simd>(&mut self, simd: S, leaf: u32) -> Option<f32> {
        let block = &self.blocks[leaf as usize];
        let candidates = self.ray.meet::<S::F4>(simd, block, self.t_max);
        let mut lanes = candidates.lanes;
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize & (BLOCK - 1);
            lanes &= lanes - 1;
            if let Some(Crossing { t, b1, b2 }) = self.ray.resolve(&candidates, block, lane) {
                let instance = self.instance.unwrap_or(block.instance[lane]);
                self.t_max = self.sink.take(Hit { t, b1, b2, instance, triangle: block.triangle[lane] })?;
            }
        }
        Some(self.t_max)
    }
}

/// Visits the leaves of a [`Top`].
struct InstanceVisitor<'a, K> {
    scene: &'a Accelerator,
    placed: &'a [Placed],
    ray: &'a Ray,
    sink: &'a mut K,
}

impl<K: Sink> Visitor for InstanceVisitor<'_, K> {
    #[inline(always)]
    fn visit<S: Simd>(&mut self, simd: S, leaf: u32) -> Option<f32> {
        let placed = &self.placed[leaf as usize];
        let t_max = self.sink.reach()?;
        let (origin, direction) = placed.to_object(self.ray);
        let sound = origin.is_finite() && direction.is_finite() && direction != Vec3::ZERO;
        if let (Some(group), true) = (&self.scene.shared[placed.mesh as usize], sound) {
            group.meet(simd, (origin, direction), t_max, Some(placed.instance), self.sink);
        }
        self.sink.reach()
    }
}

impl Top {
    fn build(boxes: &[Bounds], placed: Vec<Placed>) -> Option<Self> {
        if boxes.is_empty() {
            return None;
        }
        let collapsed = WideTree::collapse(&bvh::build(boxes), 1);
        let mut slots: Vec<Option<Placed>> = placed.into_iter().map(Some).collect();
        let placed = collapsed.items.iter().filter_map(|&i| slots[i as usize].take()).collect();
        Some(Top { tree: collapsed.tree, placed })
    }
}

impl Placed {
    /// The ray in object space. The direction is not normalised, so that t is the same. In double precision: the
    /// origin's error is one rounding in object space, whatever the transform.
    #[inline(always)]
    fn to_object(&self, ray: &Ray) -> (Vec3, Vec3) {
        let origin = self.to_object.transform_point3(ray.origin.as_dvec3()).as_vec3();
        let direction = self.to_object.transform_vector3(ray.direction.as_dvec3()).as_vec3();
        (origin, direction)
    }
}

impl Accelerator {
    /// Shows `sink` the triangles that the ray meets, the nearer leaves first.
    #[inline(always)]
    fn meet<S: Simd>(&self, simd: S, ray: &Ray, sink: &mut impl Sink) {
        if let Some(group) = &self.fixed {
            group.meet(simd, (ray.origin, ray.direction), ray.t_max, None, sink);
        }
        if let (Some(top), Some(t_max)) = (&self.top, sink.reach()) {
            let slabs = Slabs::new(ray.origin, ray.direction, top.tree.bounds);
            let mut visitor = InstanceVisitor { scene: self, placed: &top.placed, ray, sink };
            walk(simd, &top.tree, &slabs, t_max, &mut visitor);
        }
    }
}

/// Finds the nearest hit.
struct Closest<'a, A> {
    scene: &'a Accelerator,
    ray: &'a Ray,
    accept: A,
}

/// The nearest hit so far.
struct Best<'a, A> {
    t: f32,
    hit: Option<Hit>,
    accept: &'a A,
}

impl<A: Fn(&Hit) -> bool> Sink for Best<'_, A> {
    #[inline(always)]
    fn take(&mut self, hit: Hit) -> Option<f32> {
        let first = match self.hit {
            Some(best) if hit.t == best.t => (hit.instance, hit.triangle) < (best.instance, best.triangle),
            _ => hit.t < self.t,
        };
        if first && (self.accept)(&hit) {
            self.t = hit.t;
            self.hit = Some(hit);
        }
        Some(self.t)
    }
    #[inline(always)]
    fn reach(&self) -> Option<f32> {
        Some(self.t)
    }
}

impl<A: Fn(&Hit) -> bool> Kernel for Closest<'_, A> {
    type Output = Option<Hit>;
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Option<Hit> {
        let mut best = Best { t: self.ray.t_max, hit: None, accept: &self.accept };
        self.scene.meet(simd, self.ray, &mut best);
        best.hit
    }
}

/// Finds any hit.
struct Occluded<'a, A> {
    scene: &'a Accelerator,
    ray: &'a Ray,
    accept: A,
}

/// Whether anything was hit.
struct Any<'a, A> {
    t_max: f32,
    found: bool,
    accept: &'a A,
}

impl<A: Fn(&Hit) -> bool> Sink for Any<'_, A> {
    #[inline(always)]
    fn take(&mut self, hit: Hit) -> Option<f32> {
        self.found = hit.t < self.t_max && (self.accept)(&hit);
        self.reach()
    }
    #[inline(always)]
    fn reach(&self) -> Option<f32> {
        (!self.found).then_some(self.t_max)
    }
}

impl<A: Fn(&Hit) -> bool> Kernel for Occluded<'_, A> {
    type Output = bool;
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> bool {
        let mut any = Any { t_max: self.ray.t_max, found: false, accept: &self.accept };
        self.scene.meet(simd, self.ray, &mut any);
        any.found
    }
}

#[cfg(test)]
mod tests;

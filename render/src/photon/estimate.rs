//! Density estimates: irradiance on a surface from the photons around a point.
//!
//! # What counts as the same surface
//! Density is wanted on the surface, not in the ball around the point. A photon belongs to the surface of the query point
//! when their normals agree ([`MIN_NORMAL_COSINE`]) and the chord between them leaves the plane of their mean normal by no
//! more than half the angle between the normals, and [`CHORD_SLOPE`]. Between two points of a curve that turns one way the
//! chord keeps within the tangents at its ends, so this holds for planes, spheres, cylinders and their tessellations, however
//! coarse, and fails for parallel surfaces one above the other. Photons that fail neither count nor shrink the radius.
//!
//! Distances between points that pass are measured along the chord. On a plane that is the distance on the tangent disc.
//! On a sphere the part of the surface within chord d has area π d² exactly (Archimedes), where a projection onto the tangent
//! disc would be wrong by the curvature: so the estimate stays right on both, for every kernel.

use super::kdtree::KdTree;
use super::kernel::Kernel;
use super::map::PhotonMap;
use super::pack::decode_normal;
use super::query::{NeighbourBuffer, PhotonSearch};
use crate::math::Rgb;
use glam::Vec3;
use std::cell::Cell;

/// Least cosine between the normals of a query point and of a photon that lie on one surface: 45°, so that walls that
/// meet at a right angle, or the faces of a thin sheet, do not share photons.
pub const MIN_NORMAL_COSINE: f32 = std::f32::consts::FRAC_1_SQRT_2;
/// Slope of the chord between two points of one surface, against the plane of their mean normal, that is allowed beside what
/// the turn of the normal explains: sin 2.9°, four times the error of packed normals. A parallel surface h above does not
/// count within 20 h.
pub const CHORD_SLOPE: f32 = 0.05;
/// Height differences up to this are rounding, whatever the distance: some ulps of positions in scene space.
pub const HEIGHT_ROUNDING: f32 = 1e-6;
/// Least gather radius, scene space: below it positions are rounding errors and a density means nothing. k photons nearer
/// than this (photons at one point) are estimated over a disc of this radius.
pub const MIN_GATHER_RADIUS: f32 = 1e-6;

/// How photons are gathered for an estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gather {
    /// Neighbours, ≥ 2 (1 counts as 2); 0: all photons within the largest radius.
    pub k: u32,
    /// Square of the largest gather radius, scene space; less than [`MIN_GATHER_RADIUS`] counts as that.
    pub max_radius_squared: f32,
    /// Weight of photons on the disc.
    pub kernel: Kernel,
}

/// An estimate of irradiance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// Irradiance: power per area of scene space.
    pub irradiance: Rgb,
    /// Photons in the sum.
    pub count: u32,
    /// Gather radius, scene space: distance of the k-th photon, or the largest radius when there are fewer.
    pub radius: f32,
}

/// Tells photons on the surface of one query point from others.
struct SameSurface<'a> {
    tree: &'a KdTree,
    /// Packed normals in tree order.
    normals: &'a [u16],
    position: Vec3,
    normal: Vec3,
    /// What follows from the normal met last: neighbours mostly share it.
    last: Cell<NormalTest>,
}

/// The test of chords to photons of one packed normal.
#[derive(Clone, Copy)]
struct NormalTest {
    /// The packed normal, or [`NO_CODE`].
    code: u32,
    /// Sum of the normals of query and photon, n.
    sum: Vec3,
    /// Whether the normals agree.
    agrees: bool,
    /// Largest (chord · n)² / chord².
    slope_squared: f32,
    /// Largest (chord · n)² that is rounding.
    rounding_squared: f32,
}

/// No packed normal.
const NO_CODE: u32 = u32::MAX;

impl NormalTest {
    const NONE: NormalTest =
        NormalTest { code: NO_CODE, sum: Vec3::ZERO, agrees: false, slope_squared: 0.0, rounding_squared: 0.0 };

    #[inline]
    fn new(code: u16, normal: Vec3) -> Self {
        let photon = decode_normal(code);
        let cosine = photon.dot(normal);
        let (code, sum) = (u32::from(code), photon + normal);
        if cosine < MIN_NORMAL_COSINE || cosine.is_nan() {
            return NormalTest { code, ..NormalTest::NONE };
        }
        // |n|² = 2 + 2 cos θ, and sin² (θ/2) = (1 − cos θ)/2.
        let slope = CHORD_SLOPE + (0.5 - 0.5 * cosine).max(0.0).sqrt();
        let length_squared = 2.0 + 2.0 * cosine;
        let rounding_squared = HEIGHT_ROUNDING * HEIGHT_ROUNDING * length_squared;
        NormalTest { code, sum, agrees: true, slope_squared: slope * slope * length_squared, rounding_squared }
    }
}

impl<'a> SameSurface<'a> {
    fn new(map: &'a PhotonMap, position: Vec3, normal: Vec3) -> Self {
        Self::among(map.tree(), map.packed_normals(), position, normal)
    }
    fn among(tree: &'a KdTree, normals: &'a [u16], position: Vec3, normal: Vec3) -> Self {
        SameSurface { tree, normals, position, normal, last: Cell::new(NormalTest::NONE) }
    }

    #[inline(always)]
    fn accepts(&self, index: u32) -> bool {
        let code = self.normals[index as usize];
        let mut test = self.last.get();
        if test.code != u32::from(code) {
            test = NormalTest::new(code, self.normal);
            self.last.set(test);
        }
        let chord = Vec3::from_array(self.tree.position(index)) - self.position;
        let height = chord.dot(test.sum);
        test.agrees && height * height <= (test.slope_squared * chord.length_squared()).max(test.rounding_squared)
    }
}

/// Irradiance at `position` on the side of the unit normal `normal`, from the `gather.k` nearest photons of the surface
/// within the largest radius. With fewer photons there, the estimate over the disc of the largest radius: together the two
/// have exactly the right mean for uniform light (see [`super::kernel`]). In a map with a hash grid always the latter.
pub fn irradiance(map: &PhotonMap, position: Vec3, normal: Vec3, gather: &Gather) -> Estimate {
    irradiance_into(map, position, normal, gather, &mut NeighbourBuffer::new())
}

/// [`irradiance`] with memory that is reused from call to call.
pub fn irradiance_into(
    map: &PhotonMap,
    position: Vec3,
    normal: Vec3,
    gather: &Gather,
    buffer: &mut NeighbourBuffer,
) -> Estimate {
    estimate(map, position, normal, gather, buffer, |_| 1.0)
}

/// [`irradiance_into`] with each photon weighted by `weight` of the unit direction `wi` towards its origin, for surfaces
/// whose response depends on it. In a map without directions `wi` is the photon's surface normal.
pub fn irradiance_weighted(
    map: &PhotonMap,
    position: Vec3,
    normal: Vec3,
    gather: &Gather,
    buffer: &mut NeighbourBuffer,
    mut weight: impl FnMut(Vec3) -> f32,
) -> Estimate {
    estimate(map, position, normal, gather, buffer, |i| weight(map.direction(i).unwrap_or_else(|| map.normal(i))))
}

/// [`irradiance_into`] with each photon weighted by `weight` of its number in the map.
pub fn irradiance_by(
    map: &PhotonMap,
    position: Vec3,
    normal: Vec3,
    gather: &Gather,
    buffer: &mut NeighbourBuffer,
    weight: impl FnMut(u32) -> f32,
) -> Estimate {
    estimate(map, position, normal, gather, buffer, weight)
}

/// Irradiance from all photons of the surface within `radius_squared`, whatever their number.
pub fn irradiance_within(
    map: &PhotonMap,
    position: Vec3,
    normal: Vec3,
    radius_squared: f32,
    kernel: Kernel,
) -> Estimate {
    fixed(map, position, normal, radius_squared, kernel, |_| 1.0)
}

/// Calls `visit` with each photon of the surface through `position` with normal `normal` within `radius_squared`, in an order
/// that is a function of map and arguments alone.
pub fn for_each_on_surface(
    map: &PhotonMap,
    position: Vec3,
    normal: Vec3,
    radius_squared: f32,
    mut visit: impl FnMut(u32),
) {
    let surface = SameSurface::new(map, position, normal);
    map.for_each_within(position, radius_squared, |n| {
        if surface.accepts(n.index) {
            visit(n.index);
        }
    });
}

/// The photon of `tree` (packed normals `normals`, in tree order) nearest to `position` on the surface through it with normal
/// `normal`, for looking up precomputed irradiance.
pub fn nearest_compatible(
    tree: &KdTree,
    normals: &[u16],
    position: Vec3,
    normal: Vec3,
    max_radius_squared: f32,
) -> Option<u32> {
    let surface = SameSurface::among(tree, normals, position, normal);
    tree.nearest(position.to_array(), max_radius_squared, |i| surface.accepts(i)).map(|n| n.index)
}

/// Sums weighted powers in double precision: a million equal photons lose nothing.
#[derive(Default)]
struct Sum {
    rgb: [f64; 3],
    count: u32,
}

impl Sum {
    #[inline(always)]
    fn add(&mut self, power: Rgb, weight: f32) {
        for c in 0..3 {
            self.rgb[c] += f64::from(power[c]) * f64::from(weight);
        }
        self.count += 1;
    }
    fn estimate(&self, normalisation: f32, map: &PhotonMap, radius_squared: f32) -> Estimate {
        if self.count == 0 {
            return Estimate { irradiance: Rgb::BLACK, count: 0, radius: radius_squared.sqrt() };
        }
        let scale = f64::from(normalisation) / map.emitted_count().max(1) as f64;
        let [r, g, b] = self.rgb.map(|c| (c * scale) as f32);
        Estimate { irradiance: Rgb::new(r, g, b), count: self.count, radius: radius_squared.sqrt() }
    }
}

#[inline(always)]
fn estimate(
    map: &PhotonMap,
    position: Vec3,
    normal: Vec3,
    gather: &Gather,
    buffer: &mut NeighbourBuffer,
    mut weight: impl FnMut(u32) -> f32,
) -> Estimate {
    let min_radius_squared = MIN_GATHER_RADIUS * MIN_GATHER_RADIUS;
    let max_radius_squared = gather.max_radius_squared.max(min_radius_squared);
    if gather.k == 0 || map.has_hash_grid() {
        return fixed(map, position, normal, max_radius_squared, gather.kernel, weight);
    }
    let surface = SameSurface::new(map, position, normal);
    let k = gather.k.max(2) as usize;
    map.tree().k_nearest(position.to_array(), k, max_radius_squared, |i| surface.accepts(i), buffer);
    let (radius_squared, last) = match buffer.farthest() {
        Some(last) if buffer.len() == k => (last.distance_squared, Some(last.index)),
        _ => (max_radius_squared, None),
    };
    if radius_squared < min_radius_squared {
        return fixed(map, position, normal, min_radius_squared, gather.kernel, weight);
    }
    let mut sum = Sum::default();
    let inverse = 1.0 / radius_squared;
    for n in buffer.iter() {
        if Some(n.index) != last {
            sum.add(map.power(n.index), gather.kernel.shape(n.distance_squared * inverse) * weight(n.index));
        }
    }
    sum.estimate(gather.kernel.normalisation(radius_squared), map, radius_squared)
}

#[inline(always)]
fn fixed(
    map: &PhotonMap,
    position: Vec3,
    normal: Vec3,
    radius_squared: f32,
    kernel: Kernel,
    mut weight: impl FnMut(u32) -> f32,
) -> Estimate {
    let surface = SameSurface::new(map, position, normal);
    let mut sum = Sum::default();
    let inverse = 1.0 / radius_squared;
    map.for_each_within(position, radius_squared, |n| {
        if surface.accepts(n.index) {
            sum.add(map.power(n.index), kernel.shape(n.distance_squared * inverse) * weight(n.index));
        }
    });
    sum.estimate(kernel.normalisation(radius_squared), map, radius_squared)
}

/// Photons that [`choose_max_radius`] looks at.
const RADIUS_SAMPLES: usize = 1024;
/// The quantile of their k-th neighbours' distances that it starts from.
const RADIUS_QUANTILE: f32 = 0.9;
/// The factor on that quantile.
const RADIUS_FACTOR: f32 = 2.0;

/// The distance that stands for a photon whose surface holds fewer than k photons, at least: a twentieth of the scene.
const SPARSE_RADIUS: f32 = 0.1;

/// A largest gather radius from the map itself, so that nobody has to set one: twice the 90 % quantile of the distance to
/// the k-th photon of the surface, over ≤ 1024 photons spread evenly over the map. Scene space, > 0.
///
/// Photons sample the lit surface in proportion to their density, so nine estimates in ten (weighted by light) reach
/// their k photons well inside it. It only ends the search where there is little light; there the estimate becomes one over
/// a disc of this radius, with the right mean. It also bounds how far light can leak around the rim of a caustic.
/// Surfaces with fewer than k photons count with their extent, at least [`SPARSE_RADIUS`]; so does an empty map.
pub fn choose_max_radius(map: &PhotonMap, k: u32) -> f32 {
    (RADIUS_FACTOR * neighbour_distance(map, k, RADIUS_QUANTILE)).max(MIN_GATHER_RADIUS)
}

/// The `quantile` (in [0, 1)) of the distance from a photon to the k-th of its surface, over ≤ 1024 photons spread evenly over
/// the map. Scene space. Surfaces with fewer than k photons count with their extent, at least [`SPARSE_RADIUS`]; so does
/// an empty map.
pub fn neighbour_distance(map: &PhotonMap, k: u32, quantile: f32) -> f32 {
    distance_in(map, map, k, quantile)
}

/// The same from the photons of `places` to the k-th photon of `map` on their surface.
pub fn distance_in(map: &PhotonMap, places: &PhotonMap, k: u32, quantile: f32) -> f32 {
    let (count, k) = (places.stored_count(), k.max(2) as usize);
    let stride = count.div_ceil(RADIUS_SAMPLES).max(1);
    let mut buffer = NeighbourBuffer::new();
    let mut distances: Vec<f32> = (0..count)
        .step_by(stride)
        .map(|i| {
            let (position, normal) = (places.position(i as u32), places.normal(i as u32));
            let surface = SameSurface::new(map, position, normal);
            map.tree().k_nearest(position.to_array(), k, f32::INFINITY, |i| surface.accepts(i), &mut buffer);
            let farthest = buffer.farthest().map_or(0.0, |n| n.distance_squared.sqrt());
            if buffer.len() == k { farthest } else { farthest.max(SPARSE_RADIUS) }
        })
        .collect();
    distances.sort_unstable_by(f32::total_cmp);
    let rank = (distances.len() as f32 * quantile) as usize;
    distances.get(rank).copied().unwrap_or(SPARSE_RADIUS)
}

#[cfg(test)]
mod tests;

//! Irradiance precomputed at some of a map's photons, for final gather (Christensen 1999, "Faster photon map global
//! illumination").
//!
//! A final-gather ray takes the irradiance of the nearest site on its surface. Sites are photons, each chosen with equal
//! probability by the hash of its index, far fewer than all: their tree is small enough for the processor's caches, and k
//! nearest photons are searched at few places. Each value is computed when first asked for; it is a function of the map alone.
//!
//! The estimate is unbiased for the point that asks. A site is known to be a photon, one too many among the k; but no site
//! lies within the distance ρ between the two, and on that disc, whose area is exponential, just one photon is missing in the
//! mean: with a share p of the photons as sites, the hole's area is 1/p times that of one photon, and the photons that are no
//! sites are spread over it as everywhere. So the site itself counts among the k, and because it sits at the centre, where
//! other kernels would overrate it, the kernel is the constant one always. Sites are looked for within half the largest
//! gather radius, so that the hole lies inside a disc of that radius around the site; where there is none, the estimate is made
//! at the point itself, around which no photon is a site: over both cases the mean is right, however few photons there are.

use super::estimate::{Gather, irradiance_into, nearest_compatible};
use super::kdtree::KdTree;
use super::kernel::Kernel;
use super::map::PhotonMap;
use super::pack::{decode_normal, decode_rgbe, encode_rgbe};
use super::query::NeighbourBuffer;
use crate::math::Rgb;
use crate::math::rng::mix64;
use glam::Vec3;
use std::sync::atomic::{AtomicU32, Ordering};

/// Marks an irradiance of zero: decodes to black, and no power encodes to it.
const BLACK_IRRADIANCE: u32 = 1 << 24;
/// Photons of an estimate for each photon that a site stands for. A point is at ρ² = s/(πλ) from its site in the mean, with
/// one site among s photons of density λ, and the estimate reaches to r² = k/(πλ): sites that are so dense add little to its
/// blur, and their hole keeps within its disc but for a little of its tail.
const NEIGHBOURS_PER_STRIDE: u32 = 8;
/// Most photons that one site stands for.
const MAX_STRIDE: u32 = 16;
/// Least number of neighbours of an estimate: with fewer, so many sites would be needed that a map took more than 32 bytes a
/// photon with them.
pub const MIN_PRECOMPUTED_K: u32 = 48;

/// Sites and their irradiance.
#[derive(Debug)]
pub struct PrecomputedIrradiance {
    tree: KdTree,
    /// Packed normals of the sites, in tree order.
    normals: Vec<u16>,
    /// Irradiance as RGBE, in tree order; 0 where nobody has looked yet, [`BLACK_IRRADIANCE`] for none.
    irradiance: Vec<AtomicU32>,
}

impl PrecomputedIrradiance {
    /// Chooses the sites for estimates from `k` photons.
    pub(super) fn new(map: &PhotonMap, k: u32) -> Self {
        let stride = u64::from(stride(k));
        let sites: Vec<u32> =
            (0..map.stored_count() as u32).filter(|&i| mix64(u64::from(i)).is_multiple_of(stride)).collect();
        let (tree, order) = KdTree::build_on_one_thread(sites.iter().map(|&i| map.tree().position(i)).collect());
        let normals = order.iter().map(|&s| map.packed_normals()[sites[s as usize] as usize]).collect();
        let irradiance = sites.iter().map(|_| AtomicU32::new(0)).collect();
        PrecomputedIrradiance { tree, normals, irradiance }
    }

    /// Number of sites.
    pub fn len(&self) -> usize {
        self.tree.len()
    }
    /// There is no site.
    pub fn is_empty(&self) -> bool {
        self.tree.is_empty()
    }
    /// Memory of sites and values.
    pub fn memory_bytes(&self) -> u64 {
        self.tree.memory_bytes() + (size_of::<u16>() + size_of::<u32>()) as u64 * self.len() as u64
    }
    /// Expected memory for a map of `count` photons.
    pub fn memory_bytes_for(count: u64, k: u32) -> u64 {
        let sites = count.div_ceil(u64::from(stride(k)));
        KdTree::memory_bytes_for(sites as usize) + (size_of::<u16>() + size_of::<u32>()) as u64 * sites
    }

    /// Irradiance for `position` on the side of the unit normal `normal`. Every call must pass equal `gather`, and the `map`
    /// that the sites are of.
    ///
    /// Values are rounded to RGBE, so that it does not matter who asks first.
    pub fn irradiance(
        &self,
        map: &PhotonMap,
        position: Vec3,
        normal: Vec3,
        gather: &Gather,
        buffer: &mut NeighbourBuffer,
    ) -> Rgb {
        let reach_squared = 0.25 * gather.max_radius_squared;
        let Some(site) = nearest_compatible(&self.tree, &self.normals, position, normal, reach_squared) else {
            return irradiance_into(map, position, normal, &effective(gather), buffer).irradiance;
        };
        match self.irradiance[site as usize].load(Ordering::Relaxed) {
            0 => self.compute(map, site, gather, buffer),
            code => decode_rgbe(code),
        }
    }

    #[cold]
    fn compute(&self, map: &PhotonMap, site: u32, gather: &Gather, buffer: &mut NeighbourBuffer) -> Rgb {
        let position = Vec3::from_array(self.tree.position(site));
        let normal = decode_normal(self.normals[site as usize]);
        let code = match encode_rgbe(irradiance_into(map, position, normal, &effective(gather), buffer).irradiance) {
            0 => BLACK_IRRADIANCE,
            code => code,
        };
        // Another thread may do the same work and store the same bits.
        self.irradiance[site as usize].store(code, Ordering::Relaxed);
        decode_rgbe(code)
    }
}

/// One photon in so many is a site, for estimates from `k` photons.
fn stride(k: u32) -> u32 {
    (k.max(MIN_PRECOMPUTED_K) / NEIGHBOURS_PER_STRIDE).min(MAX_STRIDE)
}

/// How the photons around a site are gathered.
pub(crate) fn effective(gather: &Gather) -> Gather {
    Gather { k: gather.k.max(MIN_PRECOMPUTED_K), kernel: Kernel::Constant, ..*gather }
}

#[cfg(test)]
mod tests;

//! Progressive photon mapping (Hachisuka et al. 2008, 2009) in the form of Knaus and Zwicker (2011): independent rounds, each
//! with its own photons and one camera sample a pixel, gathered within a radius that falls from round to round, and averaged.
//! The mean over rounds is consistent: noise and blur both vanish, with memory for one round's map only.
//!
//! A round is the gather pass of [`super::photon_map`] that looks at its maps directly, within the round's radius: camera paths
//! follow specular and glossy chains to diffuse surfaces (Hachisuka and Jensen 2009, §3), direct light is estimated at them,
//! focused light comes from the caustic map and the rest from the global one. Each map has a radius of its own.

use super::photon_map::GatherSettings;
use super::radius::radius_of_round;
use crate::photon::MapKind;
use crate::photon::estimate::{Gather, MIN_GATHER_RADIUS, neighbour_distance};
use crate::photon::kernel::Kernel;
use crate::photon::map::PhotonMap;
use crate::settings::RenderSettings;

/// Photons that the first round's radius is made to hold with equal weights, where photons are about as dense as at the middle one of
/// the pilot's: a compromise between the noise of few rounds and the blur that fades with many. Focused light has the finer detail.
/// At 256 × 256 and 64 to 80 rounds, cornell-caustic and caustic-ring change by less than 10 % between half and twice of either, and get
/// worse beyond.
const FIRST_ROUND_GLOBAL: f32 = 20.0;
const FIRST_ROUND_CAUSTIC: f32 = 3.0;
/// Neighbours that measure the density in the pilot's map.
const PILOT_NEIGHBOURS: u32 = 8;
/// Least first radius, in pixels' widths: less would show nothing more.
const LEAST_PIXELS: f32 = 0.5;

/// Photons within the first round's radius of a map of this kind. Kernels that fall towards their rim reach further, so that all blur
/// alike.
pub fn first_round_photons(kind: MapKind, kernel: Kernel) -> f32 {
    let photons = match kind {
        MapKind::Global => FIRST_ROUND_GLOBAL,
        MapKind::Caustic => FIRST_ROUND_CAUSTIC,
    };
    photons * Kernel::Constant.second_moment() / kernel.second_moment()
}

/// The radius of round 0, scene space, from a pilot's map of the same kind: what holds `photons` of those that `paths` emitted paths
/// leave, but no less than half a `pixel` (width of a pixel on the surfaces that are seen, scene space).
pub fn first_radius(pilot: &PhotonMap, paths: u64, pixel: f32, photons: f32) -> f32 {
    let distance = f64::from(neighbour_distance(pilot, PILOT_NEIGHBOURS, 0.5));
    // Density grows with the emitted count, the area that holds a number of photons falls with it.
    let growth = paths.max(1) as f64 / pilot.emitted_count().max(1) as f64;
    let wanted = distance * (f64::from(photons) / f64::from(PILOT_NEIGHBOURS) / growth).sqrt();
    (wanted as f32).max(LEAST_PIXELS * pixel).max(MIN_GATHER_RADIUS)
}

/// How `round` reads its maps, whose first radii (scene space) are given; an absent map is not read.
pub fn gather_settings(settings: &RenderSettings, global: f32, caustic: f32, round: u32) -> GatherSettings {
    let gather = |first| {
        let radius = radius_of_round(first, settings.radius_alpha, round);
        Gather { k: 0, max_radius_squared: radius * radius, kernel: settings.kernel }
    };
    GatherSettings { global: gather(global), caustic: gather(caustic), final_gather: 0, direct_from_map: false }
}

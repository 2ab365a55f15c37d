//! Progressive photon mapping (Hachisuka et al. 2008, 2009) in the form of Knaus and Zwicker (2011): independent rounds, each
//! with its own photons and one camera sample a pixel, gathered within a radius that falls from round to round, and averaged.
//! The mean over rounds is consistent: noise and blur both vanish, with memory for one round's map only.
//!
//! A round is the gather pass of [`super::photon_map`] that looks at its maps directly, within the round's radius: camera paths
//! follow specular and glossy chains to diffuse surfaces (Hachisuka and Jensen 2009, §3), direct light is estimated at them,
//! focused light comes from the caustic map and the rest from the global one. Each map has a radius of its own.

use super::photon_map::GatherSettings;
use super::radius::radius_of_round;
use crate::photon::estimate::{Gather, MIN_GATHER_RADIUS, distance_in, neighbour_distance};
use crate::photon::kernel::Kernel;
use crate::photon::map::PhotonMap;
use crate::settings::RenderSettings;

/// Photons that the first round's radius is made to hold with equal weights, where photons are about as dense as at the middle one of
/// the pilot's: a compromise between the noise of few rounds and the blur that fades with many. Focused light has the finer detail.
/// Between 4 and 6 of the caustic map's, caustic-ring and cornell-caustic at 256 × 256 change by less than 10 %.
const FIRST_ROUND_CAUSTIC: f32 = 4.0;
/// The same of the global map, but among the photons of all light, and if that were all in this map: see [`first_global_radius`].
const FIRST_ROUND_GLOBAL: f32 = 50.0;
/// Neighbours that measure the density in the pilot's map.
const PILOT_NEIGHBOURS: u32 = 8;
/// Least first radius, in pixels' widths: less would show nothing more.
const LEAST_PIXELS: f32 = 0.5;

/// The first round of a job, for which a radius is wanted.
#[derive(Clone, Copy, Debug)]
pub struct FirstRound {
    /// Paths that it emits for the map.
    pub paths: u64,
    /// Width of a pixel on the surfaces that are seen, scene space.
    pub pixel: f32,
    /// Kernels that fall towards their rim reach further, so that all blur alike.
    pub kernel: Kernel,
}

impl FirstRound {
    /// The radius within which there are so many photons with equal weights, where [`PILOT_NEIGHBOURS`] of the pilot's are within `distance`; scene
    /// space, no less than half a pixel.
    fn radius(self, pilot: &PhotonMap, photons: f32, distance: f64) -> f32 {
        let wide = f64::from(Kernel::Constant.second_moment() / self.kernel.second_moment());
        // Density grows with the emitted count, the area that holds a number of photons falls with it.
        let growth = self.paths.max(1) as f64 / pilot.emitted_count().max(1) as f64;
        let wanted = distance * (f64::from(photons) * wide / f64::from(PILOT_NEIGHBOURS) / growth).sqrt();
        (wanted as f32).max(LEAST_PIXELS * self.pixel).max(MIN_GATHER_RADIUS)
    }
}

/// The radius of round 0, scene space, from a pilot's map of the same kind: what holds `photons` of the round's, but no less than half a
/// pixel.
pub fn first_radius(pilot: &PhotonMap, round: FirstRound, photons: f32) -> f32 {
    let distance = neighbour_distance(pilot, PILOT_NEIGHBOURS, 0.5);
    round.radius(pilot, photons, distance.into())
}

/// The radius of round 0 of the caustic map, from a pilot's.
pub fn first_caustic_radius(pilot: &PhotonMap, round: FirstRound) -> f32 {
    first_radius(pilot, round, FIRST_ROUND_CAUSTIC)
}

/// The radius of round 0 of the global map, from a pilot's and the map of `all` light that the pilot's paths leave.
///
/// Where the map holds the share s of all light, its noise counts beside all of that, and its blur beside nothing but its own. To hold a
/// number of its own photons, whatever s, would spread the little light of a sparse map over the whole scene; for equal noise beside
/// all light it would have to hold a number of all photons that falls as s. Half-way between is √s. On caustic-ring, where the map is
/// light that the floor and the ring throw back and forth, s is 0.001, and the error of 900 rounds at 256 × 256 falls from 2.5e-4 to
/// 1.2e-4.
pub fn first_global_radius(pilot: &PhotonMap, all: &PhotonMap, round: FirstRound) -> f32 {
    // All light is at least the map's own, and where that is nothing, any radius will do.
    let share = (pilot.stored_count() as f32 / all.stored_count().max(1) as f32).clamp(1e-6, 1.0);
    let distance = distance_in(all, if pilot.is_empty() { all } else { pilot }, PILOT_NEIGHBOURS, 0.5);
    round.radius(all, FIRST_ROUND_GLOBAL * share.sqrt(), distance.into())
}

/// How `round` reads its maps, whose first radii (scene space) are given; an absent map is not read.
pub fn gather_settings(settings: &RenderSettings, global: f32, caustic: f32, round: u32) -> GatherSettings {
    let gather = |first| {
        let radius = radius_of_round(first, settings.radius_alpha, round);
        Gather { k: 0, max_radius_squared: radius * radius, kernel: settings.kernel }
    };
    GatherSettings { global: gather(global), caustic: gather(caustic), final_gather: 0, direct_from_map: false }
}

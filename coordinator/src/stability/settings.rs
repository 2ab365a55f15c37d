//! What each method spends on a case.

use super::{Case, Effort};
use gatherlight_render::settings::{Method, RenderSettings};

/// Photon paths of each map, over all rounds, before the effort's factor.
const PATHS: u64 = 5_000;
/// Light paths of a round of `vcm` by pixels: many where one pixel is all there is.
const LIGHT_PATHS: u64 = 512;
/// Fewest light paths of a round of `vcm`.
const MIN_LIGHT_PATHS: u64 = 64;

/// The settings of `case` by `method`, with `seed`.
pub(super) fn settings(case: &Case, method: Method, effort: &Effort, seed: u64) -> RenderSettings {
    let work = case.samples * effort.factor;
    let photons = case.photons.unwrap_or(PATHS * u64::from(effort.factor));
    let base = RenderSettings {
        seed,
        width: case.side,
        height: case.side,
        samples: 64 * work,
        k: 8,
        ..RenderSettings::for_method(method)
    };
    // The usual radius is for pictures, where no pixel is narrower than what the light does.
    let max_radius = Some((case.radius * case.scale) as f32);
    match method {
        Method::Whitted | Method::Path | Method::Bdpt => base,
        Method::Mlt => RenderSettings {
            mutations: (256 * work / (case.side * case.side)).max(1),
            chains: 8,
            // The image's brightness is theirs, and they are many already.
            bootstrap: 16_384 * u64::from(effort.factor * case.samples.min(16)),
            ..base
        },
        Method::Photon => RenderSettings { photons, caustic_photons: photons, ..base },
        Method::Progressive => {
            // Its kernel makes less of photons near the rim of the given radius.
            let (rounds, photons) = if photons == 1 { (1, 1) } else { (8 * work, 2 * photons) };
            RenderSettings { rounds, photons, caustic_photons: photons, max_radius, ..base }
        }
        Method::Vcm => {
            let rounds = if photons == 1 { 1 } else { 16 * work };
            let paths = (LIGHT_PATHS / u64::from(case.side * case.side)).max(MIN_LIGHT_PATHS);
            let photons = if photons == 1 { 1 } else { paths * u64::from(rounds) };
            RenderSettings { rounds, photons, caustic_photons: 0, max_radius, ..base }
        }
    }
}

//! Numbers of photons and pixels.

use super::{Case, Glb, lit_floor, mean, under_point};
use gatherlight_render::settings::Method;

/// Methods that read no photons.
const NO_PHOTONS: &[Method] = &[Method::Whitted, Method::Path, Method::Bdpt, Method::Mlt];

pub(super) fn cases() -> Vec<Case> {
    let direct = "direct light needs no photons: ρ/π · I/h²";
    let floor = |name: &str| Case::new(name, direct, lit_floor(Glb::new(), 3.0), mean(under_point(0.5, 3.0, 1.0)));
    vec![
        floor("no photons")
            .photons(0)
            .without(NO_PHOTONS, "has no photons")
            .without(&[Method::Vcm], "needs a light path a round, and says so"),
        floor("one photon").photons(1).without(NO_PHOTONS, "has no photons"),
        floor("1 × 1 pixels"),
    ]
}

//! Closed boxes, where light goes on for long.

use super::{Answer, Case, DIRECT_ONLY, Glb, Shape};
use gatherlight_render::settings::Method;

/// Photon maps lose the part of a disc that hangs over an edge: on average 2/(3π) of it along a strip as wide as the
/// radius, which is 0.42 r of the light of a face 2 wide; r ≤ 0.1 here. And the mean of a nearest-neighbour estimate.
const EDGES: f64 = 0.05;

/// Paths that would go on for 1/(1 − ρ) edges are cut by roulette after some hundred, with weight (n/64)² for those that remain:
/// E(S²) = Σ ρⁿ n³/(3 · 64²) · 2, so that the standard deviation of a path is 0.03/(1 − ρ) of the mean.
const CUT: &str =
    "roulette cuts paths of hundreds of edges: a path's standard deviation is 0.03/(1 − albedo) of the mean";

/// Methods whose work grows with the square of the length of a path.
const PAIRS: ([Method; 2], &str) = (
    [Method::Bdpt, Method::Vcm],
    "joins each of the hundreds of vertices of a path with each of another: tenths of a second a sample",
);

pub(super) fn cases() -> Vec<Case> {
    let (whitted, why) = DIRECT_ONLY;
    let paths = &Method::ALL[1..];
    let mut all = vec![
        furnace("enclosure, albedo 0.5", 0.5, 1.0).without(whitted, why),
        furnace("enclosure, albedo 0.9", 0.9, 1.0).without(whitted, why),
        furnace("enclosure, albedo 0.99", 0.99, 1.0).samples(2).photons(20_000).without(whitted, why).large(),
        furnace("enclosure, albedo 0.999", 0.999, 1.0)
            .photons(10_000)
            .without(whitted, why)
            .without(&PAIRS.0, PAIRS.1)
            .limited(paths, CUT)
            .large(),
        furnace("enclosure, albedo 0.9999", 0.9999, 1.0)
            .photons(10_000)
            .without(whitted, why)
            .without(&PAIRS.0, PAIRS.1)
            .limited(paths, CUT)
            .large(),
        furnace("enclosure of radiance 1e-20", 0.5, 1e-20).without(whitted, why),
        furnace("enclosure of radiance 1e20", 0.5, 1e20).without(whitted, why),
        furnace("enclosure of black walls", 0.0, 1.0),
    ];
    all.push(mirror_box());
    all.push(dark_mirrors());
    all
}

fn camera_inside(glb: &mut Glb) {
    glb.camera([0.1, 0.2, 0.3], [0.7, -0.4, -1.0], 1.0);
}

/// Radiance inside a closed box that emits Le and reflects ρ everywhere is Le / (1 − ρ).
fn furnace(name: &str, albedo: f64, radiance: f64) -> Case {
    let mut glb = Glb::new();
    let wall = glb.lambert(albedo, radiance * (1.0 - albedo));
    glb.add(&Shape::room([-1.0; 3], [1.0; 3]), wall);
    camera_inside(&mut glb);
    // The albedo is read in single precision, and so is 1 − ρ, which is what counts.
    let rounding = f64::from(f32::EPSILON) * 0.5 / (1.0 - albedo).max(1e-9);
    let answer = Answer::Mean { radiance, slack: 1e-5 + rounding, blur: if albedo > 0.0 { EDGES } else { 0.0 } };
    Case::new(name, "radiance is Le / (1 − albedo) everywhere", glb, answer).side(4).photons(40_000)
}

/// Five perfect mirrors and a wall of light: every camera ray ends on the light, after however many mirrors.
fn mirror_box() -> Case {
    let mut glb = Glb::new();
    let mirror = glb.white_metal(0.0);
    let light = glb.emitter(1.0);
    let mut walls = Shape::room([-1.0; 3], [1.0; 3]);
    // The last four triangles are the walls at z = ∓1.
    let lit = walls.triangles.split_off(10);
    let lit = Shape { positions: walls.positions.clone(), triangles: lit };
    glb.add(&walls, mirror);
    glb.add(&lit, light);
    camera_inside(&mut glb);
    let answer = Answer::Mean { radiance: 1.0, slack: 1e-4, blur: 0.0 };
    Case::new(
        "mirror box with a wall of light",
        "every ray ends on the light, however many mirrors before",
        glb,
        answer,
    )
    .side(4)
}

/// Six perfect mirrors around a point light: no path ever connects the light with the camera, and none ends by itself.
fn dark_mirrors() -> Case {
    let mut glb = Glb::new();
    let mirror = glb.white_metal(0.0);
    glb.add(&Shape::room([-1.0; 3], [1.0; 3]), mirror);
    glb.point(1.0, [0.3, -0.2, 0.1]);
    camera_inside(&mut glb);
    Case::new(
        "mirror box around a point light",
        "nothing absorbs and nothing ends a path but roulette",
        glb,
        Answer::Black,
    )
    .side(4)
}

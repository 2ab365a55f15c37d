//! Lights of extreme power, size and aim.

use super::{Answer, Case, Glb, PIXEL, Shape, camera_on_floor, floor, lit_floor, mean, under_point};
use serde_json::json;
use std::f64::consts::PI;

pub(super) fn cases() -> Vec<Case> {
    let mut all = Vec::new();
    for (name, intensity) in [("light of 1e-20 candela", 1e-20), ("light of 1e20 candela", 1e20)] {
        let what = "a point light above a floor: ρ/π · I/h²";
        all.push(Case::new(name, what, lit_floor(Glb::new(), intensity), mean(under_point(0.5, intensity, 1.0))));
    }
    let answer = |factor| Answer::SameBits { of: lit_floor(Glb::new(), 3.0).bundle("lit floor"), scale: 1.0, factor };
    for (name, exponent) in [("light times 2^-66", -66), ("light times 2^66", 66)] {
        let factor = f64::from_bits(((1023 + exponent) as u64) << 52);
        let what = "the image scales with the light, bit for bit";
        all.push(Case::new(name, what, lit_floor(Glb::new(), 3.0 * factor), answer(factor as f32)));
    }
    all.extend([far_apart(), small_lamp(), narrow_spot(), sun(), grazing_light()]);
    all
}

/// A light of 3e-6 candela over the floor, and one of 3e6 sealed in a black box that nobody sees.
fn far_apart() -> Case {
    let mut glb = lit_floor(Glb::new(), 3e-6);
    let black = glb.lambert(0.0, 0.0);
    glb.add(&Shape::room([0.9, 0.5, 0.9], [1.5, 1.1, 1.5]), black);
    glb.point(3e6, [1.2, 0.8, 1.2]);
    let answer = mean(under_point(0.5, 3e-6, 1.0));
    Case::new("two lights 1e12 apart", "the bright one is sealed in a box; the dim one lights the floor", glb, answer)
        .samples(16)
}

/// A square lamp of side s = 2⁻¹⁸, 7e-7 of the scene's diameter, of radiance 3/s², over a point away from the origin. Its
/// corners are representable, as positions in scene space are single precision.
fn small_lamp() -> Case {
    let side = 1.0f32 / 262_144.0;
    let mut glb = Glb::new();
    let white = glb.lambert(0.5, 0.0);
    let lamp = glb.emitter(3.0 / f64::from(side * side));
    glb.add(&Shape::quad([-2.0, 0.0, 2.0], [4.0, 0.0, 0.0], [0.0, 0.0, -4.0]), white);
    glb.add(&Shape::quad([1.0, 1.0, 0.0], [side, 0.0, 0.0], [0.0, 0.0, side]), lamp);
    glb.camera([1.7, 0.5, 0.0], [1.0, 0.0, 0.0], 0.002);
    let answer = mean(under_point(0.5, 3.0, 1.0));
    Case::new("lamp of 1e-6 of the scene", "a square lamp that far off is a point light", glb, answer)
}

/// A spot of 0.01° half-angle; the pixel lies within its inner cone.
fn narrow_spot() -> Case {
    let mut glb = Glb::new();
    let white = glb.lambert(0.5, 0.0);
    glb.add(&Shape::quad([-2.0, 0.0, 2.0], [4.0, 0.0, 0.0], [0.0, 0.0, -4.0]), white);
    let outer = 0.01 * PI / 180.0;
    let cone = json!({ "type": "spot", "spot": { "innerConeAngle": 0.5 * outer, "outerConeAngle": outer } });
    glb.light(cone, 3.0, [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]);
    glb.camera([0.7, 0.5, 0.0], [0.0, 0.0, 0.0], 2e-5);
    Case::new("spot of 0.01°", "inside its inner cone a spot is a point light", glb, mean(under_point(0.5, 3.0, 1.0)))
        .radius(2e-5)
}

/// Directional light of 1e9 lux: ρ/π · E.
fn sun() -> Case {
    let mut glb = Glb::new();
    floor(&mut glb, 0.5);
    glb.light(json!({ "type": "directional" }), 1e9, [0.0; 3], [0.0, -1.0, 0.0]);
    Case::new("sun of 1e9 lux", "directional light on a floor: ρ/π · E", glb, mean(0.5 / PI * 1e9))
}

/// Directional light that comes 0.06° above the horizon.
fn grazing_light() -> Case {
    let sine = 1e-3;
    let mut glb = Glb::new();
    let white = glb.lambert(0.5, 0.0);
    glb.add(&Shape::quad([-2.0, 0.0, 2.0], [4.0, 0.0, 0.0], [0.0, 0.0, -4.0]), white);
    camera_on_floor(&mut glb);
    glb.light(json!({ "type": "directional" }), 1.0, [0.0; 3], [f64::sqrt(1.0 - sine * sine), -sine, 0.0]);
    // The direction is single precision: an error of 6e-8 in a sine of 1e-3.
    let answer = Answer::Mean { radiance: 0.5 / PI * sine, slack: PIXEL + 6e-5, blur: 0.0 };
    Case::new("light at a grazing angle", "directional light 0.06° above the floor: ρ/π · E sin", glb, answer)
}

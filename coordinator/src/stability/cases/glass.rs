//! Glass: total reflection, lamps and cameras inside, indices near and far from 1.

use super::{Answer, Case, DIRECT_ONLY, Glb, Shape, mean, surroundings};

pub(super) fn cases() -> Vec<Case> {
    let mut all = vec![trapped(), inside_glass(), sealed_lamp()];
    for (name, ior) in [("index 1", 1.0), ("index 1 + 1e-6", 1.000_001), ("index 3", 3.0)] {
        all.push(slab(name, ior));
    }
    all
}

fn ball(glb: &mut Glb) {
    let glass = glb.glass(1.5, 0.0);
    glb.add(&Shape::cuboid([-1.0; 3], [1.0; 3]), glass);
}

/// Along the diagonal of a glass cube every face is met at 54.7°, beyond the critical angle of 41.8°: no light comes in,
/// and the path that looks for it is reflected for ever.
fn trapped() -> Case {
    let mut glb = Glb::new();
    ball(&mut glb);
    surroundings(&mut glb, 1.0);
    glb.camera([0.1, 0.05, -0.07], [1.1, 1.02, 0.96], 0.05);
    Case::new("total internal reflection", "a glass cube seen from inside, along its diagonal", glb, Answer::Black)
        .side(2)
}

/// Radiance in glass is n² of that outside, whatever is reflected inside before it leaves.
fn inside_glass() -> Case {
    let mut glb = Glb::new();
    ball(&mut glb);
    surroundings(&mut glb, 1.0);
    glb.camera([0.1, 0.05, -0.07], [1.1, 0.06, -0.1], 0.1);
    let answer = Answer::Mean { radiance: 2.25, slack: 1e-4, blur: 0.0 };
    Case::new("camera inside glass", "radiance in glass is n² of that outside", glb, answer).side(2).samples(4)
}

/// A lamp of radiance n² sealed in glass, in a room that emits 1 − ρ: in equilibrium, all radiance outside glass is 1. All
/// light of the lamp reaches the room through glass.
fn sealed_lamp() -> Case {
    let (whitted, why) = DIRECT_ONLY;
    let mut glb = Glb::new();
    let wall = glb.lambert(0.5, 0.5);
    let (lamp, glass) = (glb.emitter(2.25), glb.glass(1.5, 0.0));
    glb.add(&Shape::room([-1.0; 3], [1.0; 3]), wall);
    glb.add(&Shape::cuboid([-0.35, -0.3, -0.4], [0.45, 0.5, 0.4]), glass);
    glb.add(&Shape::cuboid([-0.25, -0.2, -0.3], [0.35, 0.4, 0.3]), lamp);
    glb.camera([0.1, 0.2, 0.9], [0.0, 0.0, 0.0], 1.4);
    let answer = Answer::Mean { radiance: 1.0, slack: 1e-4, blur: 0.05 };
    Case::new("lamp sealed in glass", "light that reaches the room through glass only", glb, answer)
        .side(4)
        .samples(4)
        .photons(40_000)
        .without(whitted, why)
}

/// A slab at normal incidence lets (1 − R)/(1 + R) through, with R = ((n − 1)/(n + 1))².
fn slab(name: &str, ior: f64) -> Case {
    let mut glb = Glb::new();
    let (lamp, glass) = (glb.emitter(1.0), glb.glass(ior, 0.0));
    glb.add(&Shape::quad([-1.0, -1.0, -1.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]), lamp);
    glb.add(&Shape::cuboid([-1.0, -1.0, -0.2], [1.0, 1.0, 0.2]), glass);
    glb.camera([0.0, 0.0, 2.0], [0.0, 0.0, 0.0], 0.002);
    let r = ((ior - 1.0) / (ior + 1.0)) * ((ior - 1.0) / (ior + 1.0));
    Case::new(name, "a slab before a lamp, at normal incidence", glb, mean((1.0 - r) / (1.0 + r)))
        .samples(if ior > 2.0 { 64 } else { 1 })
}

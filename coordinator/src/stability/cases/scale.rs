//! Units and places.

use super::{Answer, Case, Glb, Shape, camera_on_floor, floor, lit_floor, mean, under_point};

pub(super) fn cases() -> Vec<Case> {
    let mut all = Vec::new();
    for (name, scale) in [("scale 1e-6", 1e-6), ("scale 1e6", 1e6)] {
        let what = "the lit floor in another unit, its light along with it";
        let glb = lit_floor(Glb::placed(scale, [0.0; 3]), 3.0 * scale * scale);
        all.push(Case::new(name, what, glb, mean(under_point(0.5, 3.0, 1.0))));
    }
    let answer = || Answer::SameBits { of: room(Glb::new(), 1.0).bundle("room"), scale: 1.0, factor: 1.0 };
    for (name, scale) in [("scale 2^-20", 1.0 / 1_048_576.0), ("scale 2^20", 1_048_576.0)] {
        let glb = room(Glb::placed(scale, [0.0; 3]), scale * scale);
        all.push(Case::new(name, "a room in another unit has the same bits", glb, answer()).side(8));
    }
    let glb = room(Glb::placed(1.0, [1e7, -3e6, 1.0]), 1.0);
    all.push(Case::new("moved by 1e7", "a room far from the origin has the same bits", glb, answer()).side(8));
    all.push(far_vertices());
    all
}

/// A room with an area light, a point light, glass and a mirror; all coordinates are multiples of 2⁻²⁰.
fn room(mut glb: Glb, intensity: f64) -> Glb {
    let (wall, lamp) = (glb.lambert(0.7, 0.0), glb.emitter(6.0));
    let (glass, mirror) = (glb.glass(1.5, 0.0), glb.white_metal(0.2));
    glb.add(&Shape::room([-2.0; 3], [2.0; 3]), wall);
    glb.add(&Shape::quad([-0.5, 1.75, -0.5], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]), lamp);
    glb.add(&Shape::cuboid([0.25, -1.75, 0.0], [1.25, -0.75, 1.0]), glass);
    glb.add(&Shape::cuboid([-1.25, -1.75, -1.0], [-0.25, -0.25, 0.0]), mirror);
    glb.point(2.0 * intensity, [-1.0, 1.0, 1.0]);
    glb.camera([0.25, 0.125, 1.75], [0.25, -0.875, -0.25], 1.2);
    glb
}

/// The floor with a speck of dust 1e4 away, so that what is seen is 1e-4 of the scene.
fn far_vertices() -> Case {
    let mut glb = Glb::new();
    floor(&mut glb, 0.5);
    let dust = glb.lambert(0.5, 0.0);
    glb.add(&Shape::quad([1e4, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]), dust);
    glb.point(3.0, [0.0, 1.0, 0.0]);
    camera_on_floor(&mut glb);
    // Positions are single precision of 1e4: 3e-4 at most, of the height and of what the narrow pixel sees.
    let answer = Answer::Mean { radiance: under_point(0.5, 3.0, 1.0), slack: 2e-3, blur: 0.0 };
    Case::new("detail of 1e-4 of the scene", "the lit floor, and a speck of dust 1e4 away", glb, answer)
}

//! Scenes about light.

use super::shapes::{Shape, Side};
use super::writer::Writer;
use serde_json::json;

/// A closed box with red and green walls whose only lamp is a cube of light inside a block of glass, so that every
/// photon and every camera path reaches it through refraction. All faces are flat: no shading normal comes between
/// a light path and its reverse. The lamp is large enough that paths find it by chance.
pub(super) fn lamp_through_glass() -> Vec<u8> {
    let mut w = Writer::new(
        "lamp-through-glass",
        &[
            "KHR_materials_emissive_strength",
            "KHR_materials_ior",
            "KHR_materials_specular",
            "KHR_materials_transmission",
            "KHR_materials_volume",
        ],
    );
    let white = w.lambert("white", [0.6, 0.6, 0.6]);
    let red = w.lambert("red", [0.6, 0.1, 0.1]);
    let green = w.lambert("green", [0.1, 0.5, 0.1]);
    let glass = w.glass("glass", 1.5);
    let light = w.emitter("light", 8.0);
    let (low, high) = ([-0.5, 0.0, -0.5], [0.5, 1.0, 0.5]);
    for (name, side, material) in [
        ("left", Side::Left, red),
        ("right", Side::Right, green),
        ("floor", Side::Bottom, white),
        ("ceiling", Side::Top, white),
        ("back", Side::Back, white),
        ("front", Side::Front, white),
    ] {
        w.object(name, &Shape::side(side, low, high).plain().turned(), material);
    }
    w.object("glass block", &Shape::cuboid([-0.2, 0.5, -0.25], [0.2, 0.8, 0.15]).plain(), glass);
    w.object("lamp", &Shape::cuboid([-0.14, 0.56, -0.19], [0.14, 0.74, 0.09]).plain(), light);
    w.camera("camera", [0.0, 0.45, 0.49], [0.0, 0.45, -0.5], 80.0);
    w.glb()
}

/// A floor, a wall, a matt, a metal and a glass sphere under a point light, a spot light and a directional light of
/// three colours, so that each light's share can be told by its hue.
pub(super) fn lights() -> Vec<u8> {
    let mut w = Writer::new(
        "lights",
        &[
            "KHR_lights_punctual",
            "KHR_materials_ior",
            "KHR_materials_specular",
            "KHR_materials_transmission",
            "KHR_materials_volume",
        ],
    );
    let white = w.lambert("white", [0.7, 0.7, 0.7]);
    let clay = w.lambert("clay", [0.6, 0.4, 0.3]);
    let steel = w.metal("steel", [0.8, 0.8, 0.85], 0.3);
    let glass = w.glass("glass", 1.5);
    w.object("floor", &Shape::side(Side::Top, [-3.0, -1.0, -2.0], [3.0, 0.0, 3.0]).plain(), white);
    w.object("wall", &Shape::side(Side::Front, [-3.0, 0.0, -3.0], [3.0, 3.0, -2.0]).plain(), white);
    w.object("matt sphere", &Shape::sphere([-1.2, 0.5, 0.0], 0.5, 4), clay);
    w.object("metal sphere", &Shape::sphere([0.0, 0.5, -0.6], 0.5, 4), steel);
    w.object("glass sphere", &Shape::sphere([1.2, 0.5, 0.0], 0.5, 5), glass);
    let sun = json!({ "type": "directional", "color": [1.0, 0.9, 0.7], "intensity": 1.0 });
    w.light("sun", sun, [2.0, 4.0, 3.0], [0.0, 0.0, 0.0]);
    w.light(
        "bulb",
        json!({ "type": "point", "color": [0.4, 0.6, 1.0], "intensity": 3.0 }),
        [-1.5, 2.0, 1.0],
        [-1.5, 0.0, 1.0],
    );
    let cone = json!({ "innerConeAngle": 0.15, "outerConeAngle": 0.35 });
    let spot = json!({ "type": "spot", "color": [1.0, 0.4, 0.2], "intensity": 30.0, "spot": cone });
    w.light("spot", spot, [2.5, 2.5, 2.0], [1.2, 0.3, 0.0]);
    w.camera("camera", [0.0, 1.8, 5.0], [0.0, 0.6, 0.0], 38.0);
    w.glb()
}

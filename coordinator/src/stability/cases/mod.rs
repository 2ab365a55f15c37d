//! The cases, by what is extreme about them.

mod enclosed;
mod geometry;
mod glass;
mod image;
mod lights;
mod materials;
mod scale;

use super::glb::{Glb, Shape};
use super::{Answer, Case};
use gatherlight_render::settings::Method;
use std::f64::consts::PI;

/// All cases, in the order in which they are shown.
pub fn cases() -> Vec<Case> {
    [
        enclosed::cases(),
        glass::cases(),
        lights::cases(),
        scale::cases(),
        geometry::cases(),
        materials::cases(),
        image::cases(),
    ]
    .concat()
}

/// What `whitted` computes has no light between diffuse surfaces, and none that is focused on them.
const DIRECT_ONLY: (&[Method], &str) = (&[Method::Whitted], "leaves out what surfaces send each other");

/// Radiance that `intensity` from straight above at `height` gives a surface of `albedo`: ρ/π · I/h².
fn under_point(albedo: f64, intensity: f64, height: f64) -> f64 {
    albedo / PI * intensity / (height * height)
}

/// The width of the pixel and of its floor, seen under 0.002 rad: E falls by (3/2) · (0.001 · 1.2)² at its edge, and
/// positions have an error of 1e-7 of the scene.
const PIXEL: f64 = 3e-5;

/// A disc of radius r under a point light at height 1 receives 3/4 r² less than its centre: 0.2 % for the usual radius.
const DISC: f64 = 2e-3;

/// A mean that all methods must meet up to rounding and the pixel's width, and those that read photon maps up to a disc's.
fn mean(radiance: f64) -> Answer {
    Answer::Mean { radiance, slack: PIXEL, blur: DISC }
}

/// A floor of Lambertian `albedo` in the plane y = 0, and a narrow camera that looks at the origin.
fn floor(glb: &mut Glb, albedo: f64) {
    let material = glb.lambert(albedo, 0.0);
    glb.add(&Shape::quad([-2.0, 0.0, 2.0], [4.0, 0.0, 0.0], [0.0, 0.0, -4.0]), material);
    camera_on_floor(glb);
}

fn camera_on_floor(glb: &mut Glb) {
    glb.camera([0.7, 0.5, 0.0], [0.0, 0.0, 0.0], 0.002);
}

/// The floor with a point light of intensity 3 straight above, at height 1.
fn lit_floor(mut glb: Glb, intensity: f64) -> Glb {
    floor(&mut glb, 0.5);
    glb.point(intensity, [0.0, 1.0, 0.0]);
    glb
}

/// A closed black box whose walls emit `radiance`, 8 wide.
fn surroundings(glb: &mut Glb, radiance: f64) {
    let sky = glb.emitter(radiance);
    glb.add(&Shape::room([-4.0; 3], [4.0; 3]), sky);
}

//! Triangles that are hardly there, or there twice.

use super::{Answer, Case, DIRECT_ONLY, Glb, Shape, floor, lit_floor, mean, under_point};

pub(super) fn cases() -> Vec<Case> {
    vec![
        no_area(),
        slivers(),
        sliver_lamp(),
        coincident(),
        not_a_number(),
        grazing_view(),
        no_lights(),
        no_geometry(),
        nothing(),
    ]
}

/// Triangles on a line, in a point, and with one corner twice are left out, and that is said.
fn no_area() -> Case {
    let mut glb = Glb::new();
    let white = glb.lambert(0.5, 0.0);
    let mut shape = Shape::quad([-2.0, 0.0, 2.0], [4.0, 0.0, 0.0], [0.0, 0.0, -4.0]);
    let first = shape.positions.len() as u32;
    shape.positions.extend([[-1.0, 0.5, 0.0], [0.0, 0.5, 0.0], [1.0, 0.5, 0.0]]);
    shape.triangles.extend([[first, first + 1, first + 2], [first; 3], [first, first + 1, first]]);
    glb.add(&shape, white);
    super::camera_on_floor(&mut glb);
    glb.point(3.0, [0.0, 1.0, 0.0]);
    let of = lit_floor(Glb::new(), 3.0).bundle("lit floor");
    let answer = Answer::SameBits { of, scale: 1.0, factor: 1.0 };
    Case::new("triangles without area", "they are left out and change no bit", glb, answer).warns("have no area")
}

/// A furnace whose wall is cut into strips of 2 by 2e-6 where the camera looks.
fn slivers() -> Case {
    let (whitted, why) = DIRECT_ONLY;
    let (strips, height) = (64, 2e-6f32);
    let mut walls = Shape::room([-1.0; 3], [1.0; 3]);
    // Not the wall at x = −1: it is put together again, seen from the inside.
    walls.triangles.drain(..2);
    let top = strips as f32 * height;
    let mut strip = |low: f32, high: f32| {
        walls.join(&Shape::quad([-1.0, low, 1.0], [0.0, 0.0, -2.0], [0.0, high - low, 0.0]));
    };
    strip(-1.0, 0.0);
    (0..strips).for_each(|i| strip(i as f32 * height, (i + 1) as f32 * height));
    strip(top, 1.0);
    let mut glb = Glb::new();
    let wall = glb.lambert(0.5, 0.5);
    glb.add(&walls, wall);
    glb.camera([0.5, 6e-5, 0.1], [-1.0, 6e-5, -0.1], 8e-5);
    let answer = Answer::Mean { radiance: 1.0, slack: 1e-4, blur: 0.05 };
    Case::new("slivers of 1e6 to 1", "a furnace with a wall of strips 2 by 2e-6", glb, answer)
        .side(4)
        .photons(40_000)
        .without(whitted, why)
}

/// A lamp of 1 by 1e-6 above the floor.
fn sliver_lamp() -> Case {
    let (half, width) = (0.5f32, 1.0f32 / 1_048_576.0);
    let mut glb = Glb::new();
    floor(&mut glb, 0.5);
    let lamp = glb.emitter(3.0 / f64::from(width));
    glb.add(&Shape::quad([-half, 1.0, 0.0], [2.0 * half, 0.0, 0.0], [0.0, 0.0, width]), lamp);
    // The lamp and the floor both face each other with cosine h/√(h² + x²): E = L w ∫ h²/(h² + x²)² dx, and
    // ∫ dx/(1 + x²)² = (x/(1 + x²) + atan x)/2.
    let q = f64::from(half);
    let irradiance = 3.0 * (q / (1.0 + q * q) + q.atan());
    Case::new(
        "lamp of 1e6 to 1",
        "a line of light above the floor, as two triangles",
        glb,
        mean(0.5 / std::f64::consts::PI * irradiance),
    )
    .samples(4)
}

/// The floor twice in one plane: light must not be lost between the two, nor come twice.
fn coincident() -> Case {
    let mut glb = Glb::new();
    floor(&mut glb, 0.5);
    let again = glb.lambert(0.5, 0.0);
    glb.add(&Shape::quad([-2.0, 0.0, 2.0], [4.0, 0.0, 0.0], [0.0, 0.0, -4.0]), again);
    glb.point(3.0, [0.0, 1.0, 0.0]);
    Case::new("coincident faces", "the lit floor, there twice", glb, mean(under_point(0.5, 3.0, 1.0)))
}

fn not_a_number() -> Case {
    let mut glb = Glb::new();
    floor(&mut glb, 0.5);
    let broken = glb.lambert(0.5, 0.0);
    let mut shape = Shape::quad([0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]);
    shape.positions[2][1] = f32::NAN;
    glb.add(&shape, broken);
    glb.point(3.0, [0.0, 1.0, 0.0]);
    Case::new(
        "mesh with NaN",
        "the file is refused, and the message names the vertex",
        glb,
        Answer::Refused("is not finite"),
    )
}

/// The lit floor seen from 0.06° above it.
fn grazing_view() -> Case {
    let mut glb = Glb::new();
    let white = glb.lambert(0.5, 0.0);
    glb.add(&Shape::quad([-2.0, 0.0, 2.0], [4.0, 0.0, 0.0], [0.0, 0.0, -4.0]), white);
    glb.point(3.0, [0.0, 1.0, 0.0]);
    glb.camera([1.0, 0.001, 0.0], [0.0, 0.0, 0.0], 2e-6);
    // The pixel is 2e-6/1e-3 long on the floor, and positions of 1e-7 lengthen by 1e3 under that angle: E is flat to 1e-4.
    let answer = Answer::Mean { radiance: under_point(0.5, 3.0, 1.0), slack: 2e-4, blur: 0.0 };
    Case::new("view at a grazing angle", "the lit floor from 0.06° above it", glb, answer)
}

fn no_lights() -> Case {
    let mut glb = Glb::new();
    floor(&mut glb, 0.5);
    Case::new("no lights", "a floor in the dark", glb, Answer::Black).side(2).warns("no light")
}

fn no_geometry() -> Case {
    let mut glb = Glb::new();
    glb.point(3.0, [0.0, 1.0, 0.0]);
    super::camera_on_floor(&mut glb);
    Case::new("no geometry", "a light that meets nothing", glb, Answer::Black).side(2)
}

fn nothing() -> Case {
    Case::new("nothing at all", "neither light, nor mesh, nor camera", Glb::new(), Answer::Black)
        .side(2)
        .warns("no camera")
}

//! Roughness and albedo at their ends.

use super::{Answer, Case, Glb, PIXEL, Shape, camera_on_floor, mean, surroundings, under_point};

pub(super) fn cases() -> Vec<Case> {
    let mut all = Vec::new();
    for (name, roughness) in [("roughness 0", 0.0), ("roughness 1e-6", 1e-6)] {
        // Schlick's 1 − F₀ is 0, so that the metal reflects everything; a lobe this narrow masks nothing.
        let answer = Answer::Mean { radiance: 1.0, slack: 1e-4, blur: 0.0 };
        all.push(Case::new(name, "a white metal in uniform light", metal(roughness), answer));
    }
    // With α = 1 and height-correlated Smith masking the lobe is 1/(2π(μo + μi)), which reflects 1 − μo ln(1 + 1/μo).
    let cosine = 0.5 / f64::sqrt(0.7 * 0.7 + 0.5 * 0.5);
    let rough = 1.0 - cosine * (1.0 + 1.0 / cosine).ln();
    let answer = Answer::Mean { radiance: rough, slack: 1e-3, blur: 0.0 };
    all.push(
        Case::new("roughness 1", "a white metal in uniform light: 1 − μ ln(1 + 1/μ)", metal(1.0), answer).samples(8),
    );
    for (name, albedo, reflected) in [("albedo 0", 0.0, 0.0), ("albedo 1", 1.0, 1.0), ("albedo above 1", 2.5, 1.0)] {
        let what = "a lit floor; what is above 1 is taken as 1, and said";
        let answer = if reflected == 0.0 { Answer::Black } else { mean(under_point(reflected, 3.0, 1.0)) };
        let case = Case::new(name, what, lambert(albedo), answer);
        all.push(if albedo > 1.0 { case.warns("clamped") } else { case });
    }
    all.push(coat());
    all
}

fn metal(roughness: f64) -> Glb {
    let mut glb = Glb::new();
    let plate = glb.white_metal(roughness);
    glb.add(&Shape::quad([-2.0, 0.0, 2.0], [4.0, 0.0, 0.0], [0.0, 0.0, -4.0]), plate);
    surroundings(&mut glb, 1.0);
    camera_on_floor(&mut glb);
    glb
}

fn lambert(albedo: f64) -> Glb {
    let mut glb = Glb::new();
    let material = glb.lambert(albedo, 0.0);
    glb.add(&Shape::quad([-2.0, 0.0, 2.0], [4.0, 0.0, 0.0], [0.0, 0.0, -4.0]), material);
    glb.point(3.0, [0.0, 1.0, 0.0]);
    camera_on_floor(&mut glb);
    glb
}

/// Rough glass of index 1 bends nothing and reflects nothing, so that its roughness cannot be seen.
fn coat() -> Case {
    let mut glb = Glb::new();
    let (lamp, glass) = (glb.emitter(1.0), glb.glass(1.0, 1.0));
    glb.add(&Shape::quad([-1.0, -1.0, -1.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]), lamp);
    glb.add(&Shape::cuboid([-1.0, -1.0, -0.2], [1.0, 1.0, 0.2]), glass);
    glb.camera([0.0, 0.0, 2.0], [0.0, 0.0, 0.0], 0.002);
    let answer = Answer::Mean { radiance: 1.0, slack: PIXEL, blur: 0.0 };
    Case::new("rough glass of index 1", "a slab that is not there, before a lamp", glb, answer)
}

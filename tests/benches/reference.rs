//! Path tracing of whole reference images: the mean within 0.5 % at 1,024 samples, and the error falling as one over the
//! samples. Fails where they do not. Some 100 s of CPU time.

use gatherlight_render::job::PreparedJob;
use gatherlight_render::settings::{Method, RenderSettings};
use gatherlight_tests::references::{Errors, SIDE, against, reference};
use gatherlight_tests::{scene, single};

const SCENE: &str = "cornell-diffuse";
/// Samples per pixel; the last is held against the mean.
const SAMPLES: [u32; 4] = [16, 64, 256, 1024];
/// Largest difference of the means.
const MAX_BIAS: f64 = 0.005;
/// relMSE of the reference image itself (`tests/reference/README.md`), which is in every comparison with it.
const REFERENCE_RELATIVE_MSE: f64 = 3.8e-5;

fn errors(samples: u32) -> Errors {
    let settings = RenderSettings { method: Method::Path, width: SIDE, height: SIDE, samples, ..Default::default() };
    let job = PreparedJob::prepare(&scene(&format!("{SCENE}.glb")), &settings).unwrap_or_else(|e| panic!("{e}"));
    against(&format!("{SCENE}, path, {samples:4} samples"), &single::render(&job).rgb(), &reference(SCENE))
}

fn main() {
    // `cargo test --benches` would run it too.
    if !std::env::args().any(|a| a == "--bench") {
        return;
    }
    let errors = SAMPLES.map(errors);
    for (samples, pair) in SAMPLES.windows(2).zip(errors.windows(2)) {
        let [before, after] = [0, 1].map(|i| pair[i].relative_mse - REFERENCE_RELATIVE_MSE);
        let slope = (after / before).ln() / (f64::from(samples[1]) / f64::from(samples[0])).ln();
        println!("from {:4} to {:4} samples: relMSE falls with slope {slope:.2}", samples[0], samples[1]);
        assert!((-1.3..-0.9).contains(&slope), "one over the samples would be -1");
    }
    let bias = errors[SAMPLES.len() - 1].bias;
    assert!(bias.abs() <= MAX_BIAS, "the mean is off by {:+.3} %", bias * 100.0);
}

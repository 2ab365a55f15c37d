//! Images of other renderers: `tests/reference/*.exr`, made as its README says.

use gatherlight_render::job::PreparedJob;
use gatherlight_render::math::Rgb;
use gatherlight_render::settings::{Method, RenderSettings};
use gatherlight_tests::references::{SIDE, against, block_means, reference};
use gatherlight_tests::{scene, single};

fn render(name: &str, settings: &RenderSettings) -> Vec<Rgb> {
    let job = PreparedJob::prepare(&scene(&format!("{name}.glb")), settings).unwrap_or_else(|e| panic!("{e}"));
    single::render(&job).rgb()
}

/// 64 × 64 pixels see the same as 256 × 256 in blocks of four: 1,024 samples there are 1,024 samples here. The whole image:
/// `cargo bench -p gatherlight-tests --bench reference`.
#[test]
fn path_tracing_agrees_in_mean_and_its_error_falls_as_one_over_samples() {
    let truth = block_means(&reference("cornell-diffuse"), 4);
    let at = |samples, seed| {
        let s = RenderSettings { method: Method::Path, width: 64, height: 64, samples, seed, ..Default::default() };
        against(&format!("path, {samples} samples"), &render("cornell-diffuse", &s), &truth)
    };
    let fine = at(1024, 0);
    assert!(fine.bias.abs() < 0.005, "mean is off by {:+.3} %", fine.bias * 100.0);
    // Slope of log relMSE over log samples from 4 to 64, over several seeds. Stratified samples do at least as well as
    // independent ones (−1); smooth pixels do better, never −2 on this scene.
    let mean = |samples: u32| (1..5).map(|seed| at(samples, seed).relative_mse).sum::<f64>() / 4.0;
    let slope = (mean(64) / mean(4)).ln() / 16f64.ln();
    assert!((-1.3..-0.9).contains(&slope), "relMSE falls with slope {slope}");
}

/// relMSE at 64 × 64 of `work(n)` over a few seeds, the reference's own taken off.
fn error_of(name: &str, work: impl Fn(u64) -> RenderSettings) -> f64 {
    let truth = block_means(&reference(name), 4);
    let at = |seed| {
        let settings = RenderSettings { width: 64, height: 64, ..work(seed) };
        against(&format!("{name}, {}", settings.method.name()), &render(name, &settings), &truth).relative_mse
    };
    (1..5).map(at).sum::<f64>() / 4.0
}

/// Slope of log relMSE over log work, from 16 to 256 samples and from 16 to 256 mutations a pixel, in
/// chains that are long beside what they remember. Chains give −1; samples that are
/// stratified over camera and light paths do better on smooth pixels (−1.23 here).
#[test]
fn errors_of_the_other_unbiased_methods_fall_as_one_over_the_work() {
    let bdpt = |samples, seed| RenderSettings { method: Method::Bdpt, samples, seed, ..Default::default() };
    let mlt =
        |mutations, seed| RenderSettings { method: Method::Mlt, mutations, seed, chains: 128, ..Default::default() };
    let error = |work: &dyn Fn(u64) -> RenderSettings| error_of("cornell-diffuse", work);
    for (name, steepest, few, many) in [
        ("mlt", -1.15, error(&|seed| mlt(16, seed)), error(&|seed| mlt(256, seed))),
        ("bdpt", -1.35, error(&|seed| bdpt(16, seed)), error(&|seed| bdpt(256, seed))),
    ] {
        let slope = (many / few).ln() / 16f64.ln();
        println!("{name}: relMSE falls with slope {slope:.2}");
        assert!((steepest..=-0.85).contains(&slope), "{name}: relMSE falls with slope {slope}");
    }
}

/// With α = 2/3 the variance of density estimates falls as N^(−2/3), and so does their squared blur inside smooth light; what does not
/// depend on a radius, direct light above all, falls as 1/N (Knaus and Zwicker 2011, §4): the whole lies between.
#[test]
fn the_error_of_progressive_photon_mapping_falls_at_the_rate_of_the_paper() {
    let with = |rounds: u32, seed| {
        let photons = 20_000 * u64::from(rounds);
        let base = RenderSettings { method: Method::Progressive, rounds, seed, ..Default::default() };
        RenderSettings { photons, caustic_photons: 2 * photons, ..base }
    };
    // Without lamps seen in glass, whose glints are direct light and rare.
    for name in ["cornell-diffuse", "caustic-ring"] {
        let slope = (error_of(name, |s| with(64, s)) / error_of(name, |s| with(8, s))).ln() / 8f64.ln();
        println!("{name}: relMSE falls with slope {slope:.2}");
        assert!((-1.15..=-0.55).contains(&slope), "{name}: relMSE falls with slope {slope}");
    }
}

/// The defaults, at the references' size.
fn photon_defaults(name: &str, limit: f64) {
    let settings = RenderSettings { width: SIDE, height: SIDE, ..Default::default() };
    let c = against(name, &render(name, &settings), &reference(name));
    assert!(c.relative_mse <= limit, "{name}: relMSE {} over {limit}", c.relative_mse);
    assert!(c.bias.abs() <= 0.01, "{name}: mean is off by {:+.3} %", c.bias * 100.0);
}

#[test]
fn photon_mapping_by_defaults_on_cornell_diffuse() {
    photon_defaults("cornell-diffuse", 0.01);
}

#[test]
fn photon_mapping_by_defaults_on_cornell_caustic() {
    photon_defaults("cornell-caustic", 0.02);
}

#[test]
fn photon_mapping_by_defaults_on_the_caustic_ring() {
    photon_defaults("caustic-ring", 0.02);
}

/// Four times the photons, with k scaled along by the root, so that more photons are averaged within a smaller radius and both
/// noise and blur fall: less error. (With k/N fixed the radius stays, and so does the blur, which is most of the ring's error.)
#[test]
fn error_falls_with_photons() {
    for name in ["cornell-caustic", "caustic-ring"] {
        let truth = reference(name);
        let at = |root: u32| {
            let factor = root * root;
            let settings = RenderSettings {
                width: SIDE,
                height: SIDE,
                samples: 16,
                photons: 25_000 * u64::from(factor),
                caustic_photons: 50_000 * u64::from(factor),
                k: 20 * root,
                ..Default::default()
            };
            against(&format!("{name}, {factor} × photons"), &render(name, &settings), &truth).relative_mse
        };
        let (few, many) = (at(1), at(2));
        assert!(many < few, "{name}: relMSE {few} with few photons, {many} with four times as many");
    }
}

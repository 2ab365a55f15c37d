//! Progressive photon mapping: consistent, the same by one merged map a round and by independent rounds, bounded memory.

use gatherlight_render::film::LightImage;
use gatherlight_render::integrator::radius::radius_of_round;
use gatherlight_render::job::{Inputs, Phase, PreparedJob};
use gatherlight_render::photon::EmissionRange;
use gatherlight_render::settings::{Layer, Merge, Method, RenderSettings};
use gatherlight_tests::agree::{assert_agree, block_means, column};
use gatherlight_tests::{scene, single, transport};

const SIDE: u32 = 24;

fn settings(rounds: u32) -> RenderSettings {
    let base = RenderSettings { method: Method::Progressive, width: SIDE, height: SIDE, ..Default::default() };
    RenderSettings { rounds, photons: 2_000 * u64::from(rounds), caustic_photons: 2_000 * u64::from(rounds), ..base }
}

fn room(name: &str) -> gatherlight_render::scene::description::SceneDescription {
    let found = transport::rooms().into_iter().find(|(n, _)| *n == name);
    found.expect("a room").1
}

/// Root-mean-square difference of the block means from those of bidirectional path tracing, relative; noise taken out.
fn bias(scene: &gatherlight_render::scene::description::SceneDescription, rounds: u32, truth: &[Vec<f64>]) -> f64 {
    let own = block_means(scene, &settings(rounds), 8);
    let n = own[0].len();
    let squares = (0..n).map(|i| {
        let ((a, va), (b, vb)) = (column(&own, i), column(truth, i));
        ((a - b).powi(2) - va - vb) / (b * b)
    });
    (squares.sum::<f64>() / n as f64).max(0.0).sqrt()
}

/// The blur vanishes as the radii do. At edges and corners it goes with the radius itself, elsewhere with its square (Knaus and
/// Zwicker 2011, §4), so the bias falls at a rate between those of the mean radius and of the mean squared radius; a tenth of
/// it is left to noise.
#[test]
fn blur_falls_with_the_rounds() {
    let scene = room("diffuse");
    let bdpt = RenderSettings { method: Method::Bdpt, samples: 64, seed: 100, ..settings(1) };
    let truth = block_means(&scene, &bdpt, 12);
    let (few, many) = (bias(&scene, 2, &truth), bias(&scene, 128, &truth));
    println!("bias {few:.4} after 2 rounds, {many:.4} after 128");
    assert!(few > 0.01, "nothing to see: {few}");
    let mean = |power: i32, rounds: u32| {
        let radii = (0..rounds).map(|i| f64::from(radius_of_round(1.0, settings(1).radius_alpha, i)).powi(power));
        radii.sum::<f64>() / f64::from(rounds)
    };
    let [slow, fast] = [1, 2].map(|power| mean(power, 128) / mean(power, 2));
    let ratio = many / few;
    assert!(0.9 * fast <= ratio && ratio <= 1.1 * slow, "{ratio} is not between {fast} and {slow}");
}

#[test]
fn one_map_or_independent_rounds_show_the_same_light() {
    for name in ["specular", "sunny"] {
        let shared = settings(16);
        let independent = RenderSettings { merge: Merge::Independent, seed: 100, ..settings(16) };
        assert_agree(name, &room(name), [&shared, &independent], 12, 0.0, 0.05);
    }
}

/// Apart from rounding each tile to f32, independent rounds of the same seed are the same rounds.
#[test]
fn independent_rounds_are_the_rounds_of_the_merged_maps() {
    let scene = room("glossy");
    let shared = single::render_description(scene.clone(), &settings(8));
    let independent = RenderSettings { merge: Merge::Independent, ..settings(8) };
    let apart = single::render_description(scene.clone(), &independent);
    for (a, b) in shared.pixels.iter().zip(&apart.pixels) {
        assert!((a - b).abs() <= 1e-6 * a.abs().max(1e-6), "{a} {b}");
    }
    let job = single::prepare(scene, &independent);
    let splat = |round, units| Phase::Splat { round, units };
    assert_eq!(job.phases(), (0..8).map(|round| splat(round, 1)).collect::<Vec<_>>());
    // Four of them make a round of the image.
    let job = single::prepare(room("glossy"), &RenderSettings { rounds: 32, ..independent });
    assert_eq!(job.phases()[4], splat(4, 4));
    let rounds = |cuts: &[(u64, u64)]| -> LightImage {
        let mut light = job.light_image().expect("a light image");
        let inputs = Inputs::default();
        cuts.iter().for_each(|&(first, end)| job.splat(&inputs, 4, EmissionRange { first, end }, &mut light));
        light
    };
    assert_eq!(rounds(&[(0, 4)]), rounds(&[(3, 4), (0, 1), (1, 3)]));
}

#[test]
fn photons_are_shared_out_over_the_rounds() {
    let job = single::prepare(room("specular"), &RenderSettings { photons: 1_003, ..settings(4) });
    let mut emitted = [0u64; 2];
    let phases = job.phases();
    for phase in &phases {
        if let Phase::Emission { map, paths, .. } = phase {
            emitted[*map as usize] += paths;
        }
    }
    assert_eq!(emitted, [1_003, 8_000]);
    assert_eq!(phases.len(), 12);
    assert!(matches!(phases[11], Phase::Gather { round: 3, .. }));
}

#[test]
fn independent_rounds_have_no_layers() {
    let s = RenderSettings { merge: Merge::Independent, layers: vec![Layer::Depth], ..settings(2) };
    let error = s.validate().expect_err("refused");
    assert!(error.to_string().contains("--merge shared"), "{error}");
}

/// As the command line asks for it where no number of photons is given.
fn by_default(name: &str, change: RenderSettings) -> (RenderSettings, PreparedJob) {
    let [photons, caustic_photons] = change.default_photons();
    let s = RenderSettings { photons, caustic_photons, divide_photons: true, ..change };
    let job = PreparedJob::prepare(&scene(&format!("{name}.glb")), &s).unwrap_or_else(|e| panic!("{e}"));
    (s, job)
}

fn small(rounds: u32) -> RenderSettings {
    RenderSettings { rounds, width: SIDE, height: SIDE, ..RenderSettings::for_method(Method::Progressive) }
}

/// On caustic-ring nearly all indirect light is focused, on cornell-caustic one part in eight.
#[test]
fn photons_go_where_the_light_is() {
    for (name, least, most) in [("caustic-ring", 0.25, 0.25), ("cornell-caustic", 0.6, 0.75)] {
        let (given, job) = by_default(name, small(8));
        let [global, caustic] = [job.plan().global, job.plan().caustic].map(|e| e.map_or(0, |e| e.paths));
        assert_eq!(global + caustic, given.photons + given.caustic_photons, "{name}");
        let share = global as f64 / (global + caustic) as f64;
        assert!((least..=most).contains(&share), "{name}: the global map has {share} of the paths");
        assert_eq!([global % 8, caustic % 8], [0, 0], "{name}: all rounds are alike");
    }
    // One map is divided with none.
    let (given, job) = by_default("cornell-diffuse", small(8));
    assert_eq!((job.plan().global.map(|e| e.paths), job.plan().caustic), (Some(given.photons), None));
    // Nor with one that is kept for comparison.
    let kept = RenderSettings { keep_all: true, ..given.clone() };
    let job = PreparedJob::prepare(&scene("cornell-diffuse.glb"), &kept).unwrap_or_else(|e| panic!("{e}"));
    let paths = [job.plan().global, job.plan().caustic].map(|e| e.map(|e| e.paths));
    assert_eq!(paths, [Some(given.photons), Some(given.caustic_photons)]);
}

/// Light that the floor and the ring throw back and forth leaves one photon in a thousand. A radius that holds a number of those alone
/// spread them over the scene: it was 20 to 100 times that of the caustic map, and a fifth of a per cent of the image's light was astray.
#[test]
fn a_sparse_map_is_not_spread_over_the_scene() {
    for seed in 0..6 {
        let s = RenderSettings { width: 256, height: 256, seed, ..RenderSettings::for_method(Method::Progressive) };
        let (_, job) = by_default("caustic-ring", s);
        let [global, caustic] = [job.plan().global, job.plan().caustic].map(|e| e.expect("is kept"));
        let ratio = global.first_radius / caustic.first_radius;
        println!("seed {seed}: {} and {}, {ratio:.1} times", global.first_radius, caustic.first_radius);
        assert!((1.0..12.0).contains(&ratio), "{ratio}");
    }
}

/// Who reads the counts from an image and asks for them gets that image.
#[test]
fn what_was_divided_can_be_asked_for() {
    let radii =
        |job: &PreparedJob| [job.plan().global, job.plan().caustic].map(|e| e.map(|e| (e.paths, e.first_radius)));
    // The second has a sparse map, which takes more paths to know than it has here.
    for name in ["cornell-caustic", "caustic-ring"] {
        let (_, divided) = by_default(name, small(2));
        let asked = divided.settings().clone();
        assert!(!asked.divide_photons);
        let again = PreparedJob::prepare(&scene(&format!("{name}.glb")), &asked).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(radii(&again), radii(&divided), "{name}");
        assert_eq!(single::render(&again).rgb(), single::render(&divided).rgb(), "{name}");
    }
}

/// However few the paths of a round are, no map is without.
#[test]
fn each_map_has_a_path_in_each_round() {
    let few = RenderSettings { photons: 8, caustic_photons: 8, divide_photons: true, ..small(8) };
    let job = PreparedJob::prepare(&scene("caustic-ring.glb"), &few).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!([job.plan().global, job.plan().caustic].map(|e| e.map(|e| e.paths)), [Some(8), Some(8)]);
}

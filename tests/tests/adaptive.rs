//! Adaptive sampling: the mean stays what it is, and where some pixels are harder than others the error gets less.

use gatherlight_render::film::{Accumulator, ChannelSet, Film, Tile, TileGrid};
use gatherlight_render::job::{Phase, PreparedJob};
use gatherlight_render::math::{Purpose, Stream};
use gatherlight_render::settings::{Layer, Method, RenderSettings};
use gatherlight_tests::references::reduced;
use gatherlight_tests::welch::Mean;
use gatherlight_tests::{scene, single};

const SIDE: u32 = 32;

fn settings(method: Method, samples: u32) -> RenderSettings {
    let base = RenderSettings { method, width: SIDE, height: SIDE, samples, adaptive: true, ..Default::default() };
    RenderSettings { photons: 10_000, caustic_photons: 20_000, final_gather: 1, k: 30, ..base }
}

/// One sample of pixel (x, y), with a mean of 1 everywhere: constant on the left; on the right 12.5 with probability 0.08.
fn draw(x: u32, random: &mut Stream) -> f32 {
    match x {
        0..16 => 1.0,
        _ if random.next_f32() < 0.08 => 12.5,
        _ => 0.0,
    }
}

/// An image of such samples, and whether all pixels had equally many.
fn draw_image(seed: u64) -> (Film, bool) {
    let settings = settings(Method::Path, 32);
    let grid = TileGrid { width: SIDE, height: SIDE };
    let rounds = settings.passes().count() as u32;
    let weights = settings.passes().map(|b| b.len).collect();
    let mut film =
        Accumulator::new(grid, ChannelSet::new(&[]), weights).with_pilot(settings.pilot_rounds().expect("is adaptive"));
    for round in 0..rounds {
        let even = settings.samples_of_round(round);
        for index in 0..grid.len() {
            let rect = grid.rect(index).expect("is there");
            let mut pixels = Vec::new();
            for (x, y) in (0..rect.height).flat_map(|y| (0..rect.width).map(move |x| (rect.x + x, rect.y + y))) {
                let pixel = y * SIDE + x;
                let own = film.sample_map().map_or(even.clone(), |map| map.range(pixel as usize, &even));
                let n = own.len().max(1) as f32;
                let value = |s| draw(x, &mut Stream::new(seed, Purpose::Test, s, u64::from(pixel)));
                let mean = own.map(value).sum::<f32>() / n;
                pixels.extend([mean, mean, mean, 1.0]);
            }
            film.insert(round, &Tile { index, pixels, non_finite: 0, rays: 0 }).expect("fits");
        }
        film.close(None);
    }
    let is_even = film.sample_map().expect("was decided").is_even();
    (film.finish(), is_even)
}

/// Pixels that have met none of their rare bright samples must not be left with few: then the mean would be too dark. With the
/// pixels' own samples deciding it would be, by far more than this test's noise.
#[test]
fn rare_bright_samples_are_not_lost() {
    let images: Vec<(Film, bool)> = (0..200).map(draw_image).collect();
    let uneven = images.iter().filter(|(_, is_even)| !is_even).count();
    assert!(uneven > 150, "only {uneven} images were not even");
    let mean = |columns: std::ops::Range<u32>| {
        let of = |film: &Film| {
            let pixels = (0..SIDE).flat_map(|y| columns.clone().map(move |x| f64::from(film.pixel(x, y)[0])));
            pixels.sum::<f64>() / f64::from(columns.len() as u32 * SIDE)
        };
        Mean::of(images.iter().map(|(film, _)| of(film)))
    };
    let (left, right) = (mean(0..16), mean(16..SIDE));
    assert!((left.value - 1.0).abs() < 1e-6, "{left:?}");
    assert!((right.value - 1.0).abs() < 4.0 * right.sigma(), "{right:?}");
    assert!(right.sigma() < 0.003, "{right:?}");
}

/// By independent seeds, block by block, against the same method without it: caustics by path tracing have heavy tails.
#[test]
fn the_mean_is_that_of_even_sampling() {
    for (name, method) in [("caustic-ring", Method::Path), ("cornell-caustic", Method::Path), ("pool", Method::Photon)]
    {
        let bundle = scene(&format!("{name}.glb"));
        let blocks = |adaptive: bool, first: u64| {
            let of = |seed: u64| {
                let settings = RenderSettings { adaptive, seed, ..settings(method, 32) };
                let job = PreparedJob::prepare(&bundle, &settings).unwrap_or_else(|e| panic!("{e}"));
                let film = single::render(&job);
                block_sums(&film)
            };
            (first..first + 24).map(of).collect::<Vec<_>>()
        };
        let (even, adaptive) = (blocks(false, 0), blocks(true, 1_000));
        for block in 0..even[0].len() {
            let of = |rows: &[Vec<f64>]| Mean::of(rows.iter().map(|r| r[block]));
            let difference = of(&adaptive).combined(1.0, of(&even), -1.0);
            // 17 blocks of three scenes: all pass with a probability of 0.999 if nothing is wrong.
            assert!(difference.p_value() > 2e-5, "{name}, block {block}: {difference:?}");
        }
    }
}

/// Sums of the 4 × 4 blocks of the image, and of all of it.
fn block_sums(film: &Film) -> Vec<f64> {
    let mut sums = vec![0.0; 17];
    for (x, y) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y))) {
        let value: f64 = film.pixel(x, y)[..3].iter().map(|&v| f64::from(v)).sum();
        sums[(y * 4 / SIDE * 4 + x * 4 / SIDE) as usize] += value;
        sums[16] += value;
    }
    sums
}

/// Relative MSE against another renderer's image, the same as stated, and samples a pixel: evenly and adaptively, mean of 8 seeds.
fn errors(name: &str, method: Method, samples: u32) -> [[f64; 3]; 2] {
    let (width, height, truth) = reduced(name, 64);
    let bundle = scene(&format!("{name}.glb"));
    let errors = [false, true].map(|adaptive| {
        let of = |seed| {
            let layers = vec![Layer::Samples, Layer::StandardError];
            // A map whose own error is small beside that of the samples, which is what is compared.
            let photons = 200_000;
            let settings =
                RenderSettings { adaptive, seed, layers, width, height, photons, ..settings(method, samples) };
            let job = PreparedJob::prepare(&bundle, &settings).unwrap_or_else(|e| panic!("{e}"));
            let sums = single::accumulate(&job);
            let stated = sums.noise().expect("is known").relative;
            let film = sums.finish();
            let n = film.channels.len();
            let taken = film.pixels.chunks_exact(n).map(|p| f64::from(p[4])).sum::<f64>() / f64::from(width * height);
            [relative_mse(&film, &truth), stated * stated, taken]
        };
        let runs: Vec<[f64; 3]> = (0..8).map(of).collect();
        [0, 1, 2].map(|i| runs.iter().map(|r| r[i]).sum::<f64>() / runs.len() as f64)
    });
    println!("{name}, {}: {errors:?}", method.name());
    errors
}

fn relative_mse(film: &Film, truth: &[f64]) -> f64 {
    let values = film.pixels.chunks_exact(film.channels.len()).flat_map(|p| &p[..3]).map(|&v| f64::from(v));
    let floor = truth.iter().sum::<f64>() / truth.len() as f64;
    let square = |(v, t): (f64, &f64)| ((v - t) / t.abs().max(floor)).powi(2);
    values.zip(truth).map(square).sum::<f64>() / truth.len() as f64
}

#[test]
fn the_error_falls_where_some_pixels_are_harder_and_is_stated() {
    // Half of the image is lit directly, where a photon map's samples differ much from pixel to pixel.
    let [even, adaptive] = errors("cornell-diffuse", Method::Photon, 64);
    assert_eq!(even[2], 64.0);
    assert!((adaptive[2] / 64.0 - 1.0).abs() < 0.03, "{adaptive:?}");
    assert!(adaptive[0] < 0.8 * even[0], "{even:?} {adaptive:?}");
    // Where the samples go changes nothing about how well the error is stated, whatever the map's part in it.
    let [even, adaptive] = [even, adaptive].map(|[real, stated, _]| stated / real);
    assert!((0.5..2.0).contains(&(adaptive / even)), "stated over real, squared: {even} evenly, {adaptive} adaptively");
}

#[test]
fn even_light_is_not_sampled_worse() {
    let [even, adaptive] = errors("cornell-diffuse", Method::Path, 32);
    assert!(adaptive[0] < 1.05 * even[0], "{even:?} {adaptive:?}");
}

#[test]
fn the_map_is_decided_on_once_and_other_methods_refuse_it() {
    let bundle = scene("cornell-diffuse.glb");
    let count = |settings: &RenderSettings| {
        let job = PreparedJob::prepare(&bundle, settings).unwrap_or_else(|e| panic!("{e}"));
        job.phases().iter().filter(|p| matches!(p, Phase::SampleMap { .. })).count()
    };
    let adaptive = settings(Method::Photon, 32);
    assert_eq!(count(&adaptive), 1);
    assert_eq!(count(&RenderSettings { adaptive: false, ..adaptive.clone() }), 0);
    let refused = |settings: RenderSettings| settings.validate().expect_err("is refused").to_string();
    assert!(refused(RenderSettings { samples: 15, ..adaptive }).contains("--samples 16"));
    for method in Method::ALL.into_iter().filter(|m| ![Method::Path, Method::Photon].contains(m)) {
        let text = refused(RenderSettings { adaptive: true, ..RenderSettings::for_method(method) });
        assert!(text.contains("--adaptive: not used by method"), "{text}");
    }
}

//! Bidirectional path tracing: the same light as path tracing, weights that sum to 1, and the same bits in any order.

use gatherlight_render::film::{Film, LightImage};
use gatherlight_render::job::Inputs;
use gatherlight_render::settings::strategies::MAX_EDGES;
use gatherlight_render::settings::{Layer, Method, RenderSettings, Strategy};
use gatherlight_tests::agree::assert_agree;
use gatherlight_tests::welch::Mean;
use gatherlight_tests::{single, transport};

const SIDE: u32 = 24;

fn settings(method: Method, samples: u32) -> RenderSettings {
    RenderSettings { method, width: SIDE, height: SIDE, samples, ..Default::default() }
}

/// `samples` of bidirectional path tracing, four times as many of path tracing.
fn agrees_with_path(room: &str, samples: u32) {
    let (name, scene) = transport::rooms().into_iter().find(|(name, _)| *name == room).expect("a room");
    let (bdpt, path) =
        (settings(Method::Bdpt, samples), RenderSettings { seed: 100, ..settings(Method::Path, 4 * samples) });
    assert_agree(name, &scene, [&bdpt, &path], 12, 0.0, 0.03);
}

#[test]
fn diffuse_surfaces() {
    agrees_with_path("diffuse", 16);
}

#[test]
fn glossy_to_glossy() {
    agrees_with_path("glossy", 16);
}

#[test]
fn mirrors_and_absorbing_glass() {
    agrees_with_path("specular", 16);
}

#[test]
fn rough_glass_that_absorbs() {
    agrees_with_path("rough glass", 64);
}

#[test]
fn textures_and_shading_normals() {
    agrees_with_path("bumpy", 16);
}

#[test]
fn point_spot_and_directional_lights() {
    agrees_with_path("sunny", 16);
}

#[test]
fn orthographic_camera() {
    agrees_with_path("orthographic", 16);
}

/// The light image is a sum over tiles, exact in any order and partition.
#[test]
fn the_order_of_tiles_changes_no_bit() {
    let settings = RenderSettings { width: 40, height: 33, ..settings(Method::Bdpt, 2) };
    let job = single::prepare(transport::glossy_room(), &settings);
    let inputs = Inputs::default();
    let image = |order: &[u32], parts: usize| -> LightImage {
        let mut sum = job.light_image().expect("a light image");
        for part in order.chunks(order.len().div_ceil(parts)) {
            let mut light = job.light_image().expect("a light image");
            part.iter().for_each(|&t| drop(job.gather(&inputs, 0, t, Some(&mut light))));
            sum.add(&light).expect("the same job");
        }
        sum
    };
    let tiles: Vec<u32> = (0..job.grid().len()).collect();
    let reversed: Vec<u32> = tiles.iter().rev().copied().collect();
    let whole = image(&tiles, 1);
    assert!(whole.blocks().count() > 1, "nothing was splatted");
    assert_eq!(whole, image(&reversed, 1));
    assert_eq!(whole, image(&reversed, 4));
}

/// RGB of one strategy's layer at a pixel, weighted or not.
fn strategy(film: &Film, pixel: &[f32], s: Strategy, weighted: bool) -> [f32; 3] {
    let first = film.channels.offset(Layer::Strategies).expect("asked for");
    let plane = s.planes()[usize::from(!weighted)];
    let at = first + 3 * (plane as usize - 1);
    [pixel[at], pixel[at + 1], pixel[at + 2]]
}

/// The layers of all strategies of paths of up to five edges, weighted, are the image of such paths.
#[test]
fn weighted_strategies_add_up_to_the_image() {
    for (name, scene) in transport::rooms() {
        let settings = RenderSettings {
            max_depth: Some(MAX_EDGES),
            layers: vec![Layer::Albedo, Layer::Strategies],
            ..settings(Method::Bdpt, 2)
        };
        let film = single::render_description(scene, &settings);
        for pixel in film.pixels.chunks_exact(film.channels.len()) {
            let sum = Strategy::all().fold([0.0f64; 3], |mut sum, s| {
                strategy(&film, pixel, s, true).iter().zip(&mut sum).for_each(|(v, t)| *t += f64::from(*v));
                sum
            });
            for (c, sum) in sum.iter().enumerate() {
                let value = f64::from(pixel[c]);
                assert!((sum - value).abs() <= 1e-5 * value, "{name}: {sum} instead of {value}");
            }
        }
    }
}

/// Without weights every strategy shows all paths of its length, where no surface, light or lens is out of its reach
/// (Veach 1997, §10.2): their means are equal.
#[test]
fn unweighted_strategies_show_the_same_light_each() {
    let settings = RenderSettings { max_depth: Some(4), layers: vec![Layer::Strategies], ..settings(Method::Bdpt, 64) };
    let films: Vec<Film> = (0..8)
        .map(|seed| single::render_description(transport::diffuse_room(), &RenderSettings { seed, ..settings.clone() }))
        .collect();
    let mean = |s: Strategy| {
        Mean::of(films.iter().map(|film| {
            let pixels = film.pixels.chunks_exact(film.channels.len());
            pixels.map(|p| strategy(film, p, s, false).iter().sum::<f32>()).map(f64::from).sum::<f64>()
        }))
    };
    for edges in 2..=4 {
        let means: Vec<(Strategy, Mean)> =
            Strategy::all().filter(|s| s.edges() == edges).map(|s| (s, mean(s))).collect();
        let best = means.iter().min_by(|a, b| a.1.sigma().total_cmp(&b.1.sigma())).expect("some").1;
        for (s, m) in &means {
            let difference = m.combined(1.0, best, -1.0);
            println!("{s:?}: {:.4} ± {:.4} against {:.4}", m.value, m.sigma(), best.value);
            assert!(*m == best || difference.p_value() > 1e-4, "{s:?}: p = {:.1e}", difference.p_value());
            assert!(m.sigma() < 0.05 * m.value, "{s:?} is too noisy to show anything");
        }
    }
}

#[test]
fn layers_it_does_not_have_are_refused_with_those_it_has() {
    let with = |layers: Vec<Layer>| RenderSettings { layers, ..settings(Method::Bdpt, 1) }.validate();
    assert_eq!(with(vec![Layer::Albedo, Layer::Normal, Layer::Depth, Layer::Position, Layer::Samples]), Ok(()));
    let error = with(vec![Layer::Caustic]).expect_err("no caustic layer");
    assert_eq!(error.setting, "layers");
    assert_eq!(
        error.message,
        "method bdpt has no caustic; it has albedo, normal, depth, position, samples, standard-error and strategies"
    );
}

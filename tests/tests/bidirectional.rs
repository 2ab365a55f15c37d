//! Bidirectional path tracing: the same light as path tracing, weights that sum to 1, and the same bits in any order.

use gatherlight_render::film::LightImage;
use gatherlight_render::job::Inputs;
use gatherlight_render::settings::{Layer, Method, RenderSettings};
use gatherlight_tests::agree::assert_agree;
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

#[test]
fn layers_it_does_not_have_are_refused_with_those_it_has() {
    let with = |layers: Vec<Layer>| RenderSettings { layers, ..settings(Method::Bdpt, 1) }.validate();
    assert_eq!(with(vec![Layer::Albedo, Layer::Normal, Layer::Depth, Layer::Position, Layer::Samples]), Ok(()));
    let error = with(vec![Layer::Caustic]).expect_err("no caustic layer");
    assert_eq!(error.setting, "layers");
    assert_eq!(error.message, "method bdpt has no caustic; it has albedo, normal, depth, position and samples");
}

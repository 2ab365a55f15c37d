//! The scenes under `scenes/` that are written by a program, file by file. `cargo run -p gatherlight-tests --example
//! make_scenes` writes them; a test checks that the files are what this module says.
//!
//! The three scenes that have reference images come from elsewhere (see `scenes/README.md`) and are not made here.

mod lit;
mod placed;
mod png;
mod shapes;
pub mod spare;
mod textured;
mod transport;
mod writer;

/// File name below `scenes/` and contents of every generated file.
pub fn generated() -> Vec<(&'static str, Vec<u8>)> {
    let (gltf, bin, png) = textured::labelled_box();
    vec![
        ("lamp-through-glass.glb", lit::lamp_through_glass()),
        ("lights.glb", lit::lights()),
        ("instances.glb", placed::instances()),
        ("orthographic.glb", placed::orthographic()),
        ("textured.glb", textured::textured()),
        ("rough-gold-ring.glb", transport::rough_gold_ring()),
        ("hidden-lamp.glb", transport::hidden_lamp()),
        ("door-ajar.glb", transport::door_ajar()),
        ("pool.glb", transport::pool()),
        ("glossy-plates.glb", transport::glossy_plates()),
        ("gltf/box.gltf", gltf),
        ("gltf/box.bin", bin),
        ("gltf/box.png", png),
    ]
}

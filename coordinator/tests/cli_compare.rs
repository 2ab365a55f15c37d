//! `compare` on files of its own making: figures, picture, exit codes.

mod common;

use common::run;
use gatherlight_render::export::{ImageMetadata, encode};
use gatherlight_render::film::{ChannelSet, Film};
use gatherlight_render::settings::RenderSettings;
use std::path::Path;

fn write(path: &Path, width: u32, height: u32, pixel: impl Fn(usize) -> [f32; 3]) {
    let mut film = Film::new(width, height, ChannelSet::new(&[]));
    for (i, p) in film.pixels.chunks_exact_mut(4).enumerate() {
        p[..3].copy_from_slice(&pixel(i));
        p[3] = 1.0;
    }
    let meta = ImageMetadata {
        scene_digest: String::new(),
        settings: RenderSettings::default(),
        maps: Vec::new(),
        plan: Vec::new(),
        non_finite: 0,
        samples: None,
        noise: None,
        bias: None,
        rounds: None,
        units: None,
    };
    std::fs::write(path, encode(&film, &meta).unwrap()).unwrap();
}

#[test]
fn figures_are_those_of_the_definition() {
    let dir = tempfile::tempdir().unwrap();
    write(&dir.path().join("r.exr"), 20, 10, |_| [1.0, 0.5, 0.25]);
    write(&dir.path().join("a.exr"), 20, 10, |_| [1.5, 0.5, 0.25]);
    let json = run(dir.path(), "compare a.exr r.exr --json").json();
    let is = |name: &str, expected: f64| {
        let value = json[name].as_f64().unwrap_or(f64::NAN);
        assert!((value - expected).abs() < 1e-12, "{name} = {value}, not {expected}");
    };
    is("relative_mse", 0.25 / 1.01 / 3.0);
    is("trimmed_relative_mse", 0.25 / 1.01 / 3.0);
    is("mse", 0.25 / 3.0);
    is("rmse", (0.25f64 / 3.0).sqrt());
    is("bias", 2.25 / 1.75 - 1.0);
    is("pixels", 200.0);
    let text = run(dir.path(), "compare a.exr r.exr");
    assert!(text.out.contains("relMSE") && text.out.contains("8.2508e-2") && text.err.is_empty(), "{text:?}");
}

#[test]
fn the_picture_shows_where_and_the_legend_says_how_much() {
    let dir = tempfile::tempdir().unwrap();
    write(&dir.path().join("r.exr"), 8, 8, |_| [1.0; 3]);
    write(&dir.path().join("a.exr"), 8, 8, |i| if i == 9 { [9.0; 3] } else { [1.0; 3] });
    let text = run(dir.path(), "compare a.exr r.exr --diff d.png");
    assert!(text.out.contains("d.png") && text.out.contains("yellow 10 %"), "{text:?}");
    let picture = std::fs::read(dir.path().join("d.png")).unwrap();
    assert_eq!(&picture[..8], b"\x89PNG\r\n\x1a\n");
}

#[test]
fn a_limit_turns_into_the_exit_code() {
    let dir = tempfile::tempdir().unwrap();
    write(&dir.path().join("r.exr"), 8, 8, |_| [1.0; 3]);
    write(&dir.path().join("a.exr"), 8, 8, |_| [1.1; 3]);
    run(dir.path(), "compare a.exr r.exr --fail-above 0.02").says(0, &[]);
    run(dir.path(), "compare a.exr r.exr --fail-above 0.005").says(1, &["relMSE", "above 0.005"]);
    run(dir.path(), "compare a.exr r.exr --fail-above nan").says(2, &["--fail-above", "nan"]);
}

#[test]
fn images_of_different_size_are_not_compared() {
    let dir = tempfile::tempdir().unwrap();
    write(&dir.path().join("r.exr"), 8, 8, |_| [1.0; 3]);
    write(&dir.path().join("a.exr"), 8, 9, |_| [1.0; 3]);
    run(dir.path(), "compare a.exr r.exr").says(1, &["8 × 9", "8 × 8"]);
}

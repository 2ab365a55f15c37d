//! What the program says about bad input, read from the real program: what was wrong, where, and what to do; with the
//! exit codes 1 (the work failed) and 2 (wrong usage).

mod common;

use common::{run, scene, triangle_dir};
use gatherlight_render::settings::{Method, Setting};

#[test]
fn a_missing_scene_is_named() {
    let dir = tempfile::tempdir().unwrap();
    run(dir.path(), "render nowhere/lamp.glb -o x.exr").says(2, &["error:", "no file nowhere/lamp.glb"]);
    run(dir.path(), "plan .").says(2, &["is a directory", ".glb or .gltf"]);
    run(dir.path(), "compare a.exr b.exr").says(2, &["no file a.exr"]);
}

/// A file where a directory should be: unreadable for the superuser too.
#[test]
fn an_unreadable_scene_is_named_with_the_reason() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("notes"), "only words").unwrap();
    run(dir.path(), "render notes/lamp.glb -o x.exr").says(2, &["error: cannot read notes/lamp.glb: ", "irectory"]);
}

#[test]
fn a_file_that_is_no_scene_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("notes.glb"), "only words").unwrap();
    run(dir.path(), "render notes.glb -o x.exr").says(1, &["notes.glb", "glTF"]);
    std::fs::write(dir.path().join("notes.exr"), "only words").unwrap();
    run(dir.path(), "compare notes.exr notes.exr").says(1, &["notes.exr", "EXR"]);
}

#[test]
fn a_truncated_glb_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let whole = std::fs::read(scene("cornell-diffuse.glb")).unwrap();
    std::fs::write(dir.path().join("half.glb"), &whole[..whole.len() / 2]).unwrap();
    run(dir.path(), "render half.glb -o x.exr").says(1, &["half.glb"]);
    assert!(!dir.path().join("x.exr").exists());
}

#[test]
fn a_missing_external_file_is_named_with_the_scene() {
    let dir = triangle_dir();
    std::fs::remove_file(dir.path().join("the triangle.bin")).unwrap();
    run(dir.path(), "render triangle.gltf -o x.exr").says(1, &["the triangle.bin", "triangle.gltf needs"]);
}

#[test]
fn each_nonsense_setting_names_its_option_and_what_is_valid() {
    let dir = triangle_dir();
    for (option, parts) in [
        ("--width 0", ["--width", "1 … 65536"]),
        ("--height 100000", ["--height", "65536"]),
        ("--width 65536 --height 65536", ["--width", "1073741824 pixels"]),
        ("--samples 0", ["--samples", "1 … 16777216"]),
        ("--samples 1.5", ["--samples", "1.5"]),
        ("--samples -1", ["-1", "--"]),
        ("--photons 2000G", ["--photons", "1099511627776"]),
        ("--photons many", ["--photons", "500k, 10M"]),
        ("--caustic-photons 2000G", ["--caustic-photons", "1099511627776"]),
        ("--k 1", ["--k", "2 … 100000"]),
        ("--max-radius 0", ["--max-radius", "above 0"]),
        ("--max-radius nan", ["--max-radius", "finite"]),
        ("--max-depth 0", ["--max-depth", "at least 1"]),
        ("--final-gather 100k", ["--final-gather", "65536"]),
        ("--seed x", ["--seed", "x"]),
        ("--method radiosity", ["radiosity", "auto, "]),
        ("--method path --k 20", ["--k: not used by method path", "takes --samples, --adaptive and --max-depth"]),
        ("--method path --photons 1k --final-gather 0", ["--photons", "method path"]),
        ("--method photon --max-depth 3", ["--max-depth", "photon, which takes --samples, --adaptive, --photons,"]),
        ("--max-depth 3 --k 20", ["--method: no method takes all", "--k (photon)"]),
        ("--rounds 0", ["--rounds", "1 … 65536"]),
        ("--radius-alpha 1", ["--radius-alpha", "between 0 and 1"]),
        ("--rounds 100 --photons 10", ["--photons", "all rounds"]),
        ("--chains 0", ["--chains", "1 … 16777216"]),
        ("--method bdpt --width 8192 --height 8192", ["--width", "at most 39000000"]),
        ("--large-step 0", ["--large-step", "above 0"]),
        ("--memory 64M --k 20", ["--k (photon)", "--memory (progressive)"]),
        ("--mutations 2 --layers depth", ["--method: no method takes all", "--mutations (mlt)"]),
        ("--direct-from-map --final-gather 2", ["--final-gather", "--direct-from-map"]),
        ("--direct-from-map --layers caustic", ["--layers", "no caustic"]),
        ("--estimator tree", ["tree", "kdtree, hash"]),
        ("--kernel round", ["round", "constant, cone, epanechnikov"]),
        ("--layers direct,shadow", ["shadow", "caustic"]),
        ("--layers direct,direct", ["--layers", "once"]),
        ("--threads 1000000", ["--threads", "4096"]),
        ("--quiet --verbose", ["--quiet", "--verbose"]),
    ] {
        run(dir.path(), &format!("render triangle.gltf -o x.exr {option}")).says(2, &parts);
    }
    assert!(!dir.path().join("x.exr").exists());
}

#[test]
fn every_option_is_in_the_help_and_in_the_manual() {
    let dir = tempfile::tempdir().unwrap();
    let help = run(dir.path(), "render --help").out;
    let manual = include_str!("../../docs/command-line.md");
    for setting in Setting::ALL.into_iter().filter(|s| s.methods().next().is_some()) {
        let option = format!("--{}", setting.name());
        assert!(help.contains(&format!("{option} ")) || help.contains(&format!("{option}\n")), "{option} in {help}");
        assert!(manual.contains(&format!("`{option}")), "{option} in docs/command-line.md");
    }
    for method in Method::ALL {
        assert!(help.contains(method.name()) && manual.contains(&format!("`{}`", method.name())), "{}", method.name());
    }
}

#[test]
fn an_output_that_cannot_be_written_is_found_before_the_work() {
    let dir = triangle_dir();
    // The scene is not there: were it looked for first, the message would be about it.
    let render = |out: &str| run(dir.path(), &format!("render not-there.glb -o {out}"));
    render("no/such/x.exr").says(2, &["x.exr", "no directory no/such", "make it first"]);
    render("x.jpg").says(2, &["x.jpg", ".exr", ".png"]);
    std::fs::create_dir(dir.path().join("y.exr")).unwrap();
    render("y.exr").says(2, &["y.exr", "is a directory"]);
    run(dir.path(), "fetch 0123456789abcdef -o no/x.exr").says(2, &["no directory no"]);
    run(dir.path(), "compare a.exr b.exr --diff no/x.png").says(2, &["no directory no"]);
    run(dir.path(), "compare a.exr b.exr --diff x.exr").says(2, &["--diff", ".png"]);
    if cfg!(target_os = "linux") {
        // Not even root writes there.
        render("/proc/x.exr").says(2, &["cannot write in the directory /proc"]);
    }
}

#[test]
fn help_has_examples_and_every_command_has_help() {
    let dir = tempfile::tempdir().unwrap();
    let commands = [
        "render",
        "plan",
        "compare",
        "serve",
        "submit",
        "jobs",
        "watch",
        "fetch",
        "cancel",
        "workers",
        "stability",
        "completions",
    ];
    let all = run(dir.path(), "--help");
    for name in commands {
        assert!(all.out.contains(&format!("\n  {name} ")), "{name} in {}", all.out);
        let help = run(dir.path(), &format!("{name} --help"));
        assert_eq!(help.code, 0);
        assert!(help.out.contains(&format!("Examples:\n  gatherlight {name}")), "{}", help.out);
    }
    run(dir.path(), "").says(2, &["Usage: gatherlight", "<COMMAND>"]);
    run(dir.path(), "rendr").says(2, &["rendr", "render"]);
}

#[test]
fn completions_name_every_command() {
    let dir = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish"] {
        let script = run(dir.path(), &format!("completions {shell}"));
        assert_eq!(script.code, 0);
        assert!(
            ["render", "--caustic-photons", "submit"].iter().all(|w| script.out.contains(w.trim_matches('-'))),
            "{shell}"
        );
    }
    run(dir.path(), "completions cmd").says(2, &["cmd", "bash"]);
}

#[test]
fn job_ids_and_addresses_are_checked() {
    let dir = tempfile::tempdir().unwrap();
    run(dir.path(), "watch 12").says(2, &["12", "16 hexadecimal digits"]);
    run(dir.path(), "serve --listen nowhere").says(2, &["--listen", "nowhere"]);
    run(dir.path(), "jobs --attempts 0").says(2, &["--attempts"]);
    run(dir.path(), "serve --max-store 1.5G").says(2, &["--max-store", "whole number"]);
    run(dir.path(), "jobs --log a=b=c").says(2, &["--log", "a=b=c"]);
}

//! `render` from the scene file to the image file, by the real program.

mod common;

use common::{Triangle, command, run, scene, triangle_dir};
use gatherlight_render::export::decode;
use gatherlight_render::film::Image;
use std::path::Path;

/// Few photons and samples: these tests are about the program, not the picture.
const QUICK: &str = "--height 16 --samples 2 --photons 2k --caustic-photons 2k";

fn image(path: &Path) -> Image {
    decode(&std::fs::read(path).unwrap()).unwrap()
}

fn files(dir: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn an_image_comes_with_its_layers_and_says_how_it_was_made() {
    let dir = triangle_dir();
    let run =
        run(dir.path(), &format!("render triangle.gltf -o x.exr {QUICK} --seed 5 --layers samples,normal --json"));
    run.says(0, &[]);
    let json = run.json();
    assert_eq!((&json["files"][0], &json["width"], &json["height"]), (&"x.exr".into(), &32.into(), &16.into()));
    assert!(json["elapsed_s"].as_f64().unwrap() > 0.0 && json["stats"]["rays"].as_u64().unwrap() > 0, "{json}");

    let image = image(&dir.path().join("x.exr"));
    assert_eq!((image.width, image.height), (32, 16));
    let names: Vec<&str> = image.channels.iter().map(|(n, _)| n.as_str()).collect();
    assert_eq!(names, ["A", "B", "G", "R", "normal.X", "normal.Y", "normal.Z", "samples.V"]);
    let attribute = |name: &str| image.attributes.get(name).map_or("", String::as_str);
    assert_eq!((attribute("gatherlight:method"), attribute("gatherlight:seed")), ("photon", "5"));
    assert_eq!(attribute("gatherlight:global.emitted"), "2000");
    assert_eq!(attribute("gatherlight:scene_digest").len(), 64);
    assert!(attribute("gatherlight:plan").contains("global photon map"));
    assert!(attribute("gatherlight:settings").contains("--seed 5"));
    // The triangle is lit, and faces the camera.
    let centre = 8 * 32 + 16;
    assert!(image.rgb().unwrap()[centre].r > 0.0);
    assert_eq!(image.channel("normal.Z").unwrap()[centre], 1.0);
    assert_eq!(image.channel("samples.V").unwrap()[centre], 2.0);
}

#[test]
fn the_file_has_the_same_bytes_for_any_number_of_threads_and_every_run() {
    let dir = tempfile::tempdir().unwrap();
    let render = |name: &str, threads: u32| {
        let glb = scene("cornell-diffuse.glb");
        let args = format!("render {} -o {name} {QUICK} --threads {threads}", glb.display());
        run(dir.path(), &args).says(0, &[]);
        std::fs::read(dir.path().join(name)).unwrap()
    };
    let first = render("a.exr", 1);
    assert_eq!(first, render("b.exr", 1));
    assert_eq!(first, render("c.exr", 2));
    assert_eq!(first, render("d.exr", 3));
}

#[test]
fn a_png_comes_with_its_exr_and_old_files_are_replaced() {
    let dir = triangle_dir();
    std::fs::write(dir.path().join("x.exr"), "old").unwrap();
    let run = run(dir.path(), &format!("render triangle.gltf -o x.png {QUICK} --no-report"));
    run.says(0, &[]);
    assert!(run.out.contains("x.exr, x.png"), "{run:?}");
    assert_eq!(files(dir.path()), ["the triangle.bin", "triangle.gltf", "x.exr", "x.png"]);
    assert_eq!(image(&dir.path().join("x.exr")).width, 32);
    assert!(std::fs::read(dir.path().join("x.png")).unwrap().starts_with(b"\x89PNG\r\n\x1a\n"));
}

#[test]
fn stderr_is_quiet_when_it_is_no_terminal_unless_asked() {
    let dir = triangle_dir();
    let quiet = run(dir.path(), &format!("render triangle.gltf -o x.exr {QUICK}"));
    assert_eq!((quiet.code, quiet.err.as_str()), (0, ""));
    assert!(quiet.out.contains("x.exr: 32 × 16, photon, 2 samples in"), "{quiet:?}");
    let loud = run(dir.path(), &format!("render triangle.gltf -o x.exr {QUICK} --verbose"));
    loud.says(0, &["computed  global photon map", "left out", "peak memory about", "gather "]);
}

#[test]
fn no_light_is_a_black_image_and_a_warning() {
    let dir = tempfile::tempdir().unwrap();
    Triangle { light: false, cameras: true }.write(dir.path());
    run(dir.path(), &format!("render triangle.gltf -o x.exr {QUICK}")).says(0, &["warning:", "no light"]);
    assert!(image(&dir.path().join("x.exr")).rgb().unwrap().iter().all(|p| p.is_black()));
}

#[test]
fn no_photons_at_all_is_a_valid_request() {
    let dir = triangle_dir();
    let args = "render triangle.gltf -o x.exr --height 16 --samples 1 --photons 0 --caustic-photons 0";
    run(dir.path(), args).says(0, &[]);
    assert!(image(&dir.path().join("x.exr")).rgb().unwrap().iter().all(|p| p.is_finite()));
}

/// Of two samples the noise is known, of one it is not.
#[test]
fn noise_is_stated_where_there_is_something_to_compare() {
    let dir = triangle_dir();
    let text = run(dir.path(), &format!("render triangle.gltf -o x.exr {QUICK}"));
    assert!(text.out.contains("relative standard error"), "{text:?}");
    let stated = image(&dir.path().join("x.exr")).attributes["gatherlight:relative_standard_error"].clone();
    assert!(stated.parse::<f64>().is_ok_and(|e| e > 0.0), "{stated}");
    let one =
        run(dir.path(), "render triangle.gltf -o x.exr --height 16 --samples 1 --photons 2k --caustic-photons 2k");
    assert!(one.code == 0 && !one.out.contains("standard error"), "{one:?}");
}

#[test]
fn a_report_is_written_beside_the_image() {
    let dir = triangle_dir();
    let args = "render triangle.gltf -o x.exr --height 256 --samples 64 --photons 2k --caustic-photons 2k";
    run(dir.path(), args).says(0, &[]);
    let names = ["the triangle.bin", "triangle.gltf", "x.exr", "x.report.html", "x.report.json"];
    assert_eq!(files(dir.path()), names);
    let read = |name: &str| std::fs::read_to_string(dir.path().join(name)).unwrap();
    let report: serde_json::Value = serde_json::from_str(&read("x.report.json")).unwrap();
    let (timeline, stats) = (&report["timeline"], &report["summary"]["stats"]);
    assert_eq!(report["summary"]["files"][0], "x.exr");
    assert!(report["plan"].as_array().unwrap().iter().any(|l| l.as_str().unwrap().contains("global photon map")));
    assert!(stats["rays"].as_u64().unwrap() > 0 && report["peak_memory_bytes"].as_u64().is_none_or(|b| b > 1 << 20));
    // The last error is the image's.
    let last = &timeline["error"].as_array().unwrap().last().unwrap()["relative_standard_error"];
    assert_eq!(*last, report["summary"]["relative_standard_error"]);
    assert!(timeline["phases"].as_array().unwrap().iter().any(|p| p["phase"] == "gather"), "{timeline}");
    let page = read("x.report.html");
    assert!(page.starts_with("<!DOCTYPE html>") && page.contains("global photon map") && !page.contains("http"));
}

#[test]
fn progress_is_a_stream_of_events_for_scripts() {
    let dir = triangle_dir();
    let run = run(dir.path(), &format!("render triangle.gltf -o x.exr {QUICK} --progress json"));
    run.says(0, &[]);
    let events: Vec<serde_json::Value> = run.out.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    let (last, progress) = events.split_last().unwrap();
    assert_eq!((&last["event"], &last["result"]["files"][0]), (&"end".into(), &"x.exr".into()));
    assert!(!progress.is_empty() && progress.iter().all(|e| e["event"] == "progress"));
    assert!(progress.iter().all(|e| e["job"]["elapsed_s"].is_number() && e["job"]["state"].is_string()));
    assert_eq!(run.err, "");
}

#[test]
fn a_target_error_ends_a_job_or_is_refused() {
    let dir = triangle_dir();
    let render = |more: &str| run(dir.path(), &format!("render triangle.gltf -o x.exr --height 16 {more}"));
    let ended = render("--samples 64 --photons 2k --caustic-photons 2k --target-error 500%");
    ended.says(0, &[]);
    assert!(ended.err.contains("whose own noise and blur count in the error and do not fall"), "{ended:?}");
    assert!(ended.out.contains("ended by the error limit: the image is the mean of 8 of 64 samples"), "{ended:?}");
    assert_eq!(image(&dir.path().join("x.exr")).attributes["gatherlight:samples"], "8");
    for (more, message) in [
        ("--method path --samples 1 --target-error 1%", "--target-error needs rounds to know the error by"),
        ("--method mlt --chains 1 --target-error 1%", "more than one sample, round or chain"),
        ("--target-error 0", "is no error above 0"),
        ("--target-error x%", "is no error above 0"),
    ] {
        let refused = render(more);
        assert!(refused.code == 2 && refused.err.contains(message), "{more}: {refused:?}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_leaves_nothing_half_written() {
    // The shell's limit on file size stands for the full disk; 512 × 512 pixels do not fit in one block of it.
    let dir = triangle_dir();
    std::fs::write(dir.path().join("x.exr"), "old").unwrap();
    let program = command(dir.path()).get_program().to_owned();
    let script = format!(
        "trap '' XFSZ; ulimit -f 1; exec '{}' render triangle.gltf -o x.exr --samples 1 --photons 1k",
        program.to_string_lossy()
    );
    let mut shell = std::process::Command::new("sh");
    shell.args(["-c", &script]).current_dir(dir.path());
    let run: common::Run = shell.output().unwrap().into();
    run.says(1, &["cannot write x.exr"]);
    assert_eq!(std::fs::read(dir.path().join("x.exr")).unwrap(), b"old");
    assert_eq!(files(dir.path()), ["the triangle.bin", "triangle.gltf", "x.exr"]);
}

#[test]
fn without_a_count_a_limit_is_the_end() {
    let dir = triangle_dir();
    let small = "--photons 2k --caustic-photons 2k";
    // Far more than the default number of samples fits into the time.
    for (method, options) in [("path", ""), ("photon", small), ("mlt", "--bootstrap 100")] {
        let limited = format!("render triangle.gltf -o x.exr --method {method} --height 16 {options}");
        let run_with = |more: &str| {
            let run = run(dir.path(), &format!("{limited} {more} --json"));
            run.says(0, &[]);
            run.json()
        };
        let done = |json: &serde_json::Value| {
            json[if method == "mlt" { "mutations" } else { "samples" }].as_f64().unwrap_or_else(|| panic!("{json}"))
        };
        let json = run_with("--time-limit 2s");
        assert_eq!(json["stats"]["ended_by"], "time", "{method}: {json}");
        assert!(done(&json) > 64.0 && done(&json) < 1e6, "{method}: {json}");
        // A count is an end of its own.
        let count = if method == "mlt" { "--mutations 3" } else { "--samples 3" };
        let json = run_with(&format!("{count} --time-limit 1h"));
        assert_eq!((done(&json), &json["stats"]["ended_by"]), (3.0, &serde_json::Value::Null), "{method}: {json}");
    }
    let run_rounds =
        run(dir.path(), "render triangle.gltf -o x.exr --method vcm --height 16 --target-error 90% --json");
    run_rounds.says(0, &[]);
    let json = run_rounds.json();
    assert_eq!(
        (&json["stats"]["ended_by"], &json["samples"]),
        (&"error".into(), &json["stats"]["rounds_done"]),
        "{json}"
    );
}

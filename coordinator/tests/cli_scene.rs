//! What the program says about a scene before it renders: cameras, lights, warnings, the plan.

mod common;

use common::{Triangle, run, scene, triangle_dir};

#[test]
fn an_unknown_camera_lists_those_there_are() {
    let dir = triangle_dir();
    run(dir.path(), "plan triangle.gltf --camera narrow").says(2, &["--camera", "\"narrow\"", "wide", "tall"]);
    run(dir.path(), "plan triangle.gltf --camera 2").says(2, &["--camera", "wide", "tall"]);
}

#[test]
fn a_scene_without_camera_or_light_gives_warnings_or_with_strict_errors() {
    let dir = tempfile::tempdir().unwrap();
    Triangle { light: true, cameras: false }.write(dir.path());
    run(dir.path(), "plan triangle.gltf").says(0, &["warning:", "no camera", "frames"]);
    run(dir.path(), "plan triangle.gltf --strict").says(1, &["error:", "no camera", "--strict"]);
    Triangle { light: false, cameras: true }.write(dir.path());
    run(dir.path(), "plan triangle.gltf").says(0, &["warning:", "no light", "black"]);
    run(dir.path(), "render triangle.gltf -o x.exr --strict").says(1, &["error:", "no light", "--strict"]);
    assert!(!dir.path().join("x.exr").exists());
}

#[test]
fn the_image_has_the_camera_s_shape_unless_told_otherwise() {
    let dir = triangle_dir();
    let size = |options: &str| {
        let plan = run(dir.path(), &format!("plan triangle.gltf --json {options}")).json();
        let words: Vec<String> = plan["settings"].as_str().unwrap().split(' ').map(String::from).collect();
        let after = |option: &str| {
            let at = words.iter().position(|w| w == option).unwrap();
            words[at + 1].parse::<u32>().unwrap()
        };
        (after("--width"), after("--height"))
    };
    assert_eq!(size(""), (1024, 512));
    assert_eq!(size("--camera tall"), (256, 512));
    assert_eq!(size("--camera 1 --width 300"), (300, 600));
    assert_eq!(size("--height 100"), (200, 100));
    assert_eq!(size("--width 64 --height 64"), (64, 64));
    // A side that follows from the camera may be out of range, too.
    run(dir.path(), "plan triangle.gltf --height 40000").says(2, &["--width", "65536"]);
}

#[test]
fn the_plan_says_what_is_left_out_and_why() {
    let dir = tempfile::tempdir().unwrap();
    let plan = |name: &str, options: &str| {
        let path = scene(name);
        let all = run(dir.path(), &format!("plan {} {options} --json", path.display())).json();
        let entries = all["plan"]["entries"].as_array().unwrap().clone();
        move |what: &str| {
            let entry = entries.iter().find(|e| e["what"] == what);
            entry.and_then(|e| e["kept"].as_bool())
        }
    };
    let diffuse = plan("cornell-diffuse.glb", "");
    assert_eq!((diffuse("global photon map"), diffuse("caustic photon map")), (Some(true), Some(false)));
    assert_eq!(plan("cornell-caustic.glb", "")("caustic photon map"), Some(true));
    let path = plan("cornell-caustic.glb", "--method path");
    assert_eq!((path("global photon map"), path("caustic photon map")), (Some(false), Some(false)));
    let text = run(dir.path(), &format!("plan {}", scene("cornell-diffuse.glb").display()));
    assert!(text.out.contains("left out  caustic photon map: ") && text.out.contains("peak memory about"), "{text:?}");
}

#[test]
fn the_plan_says_what_leaving_out_saves_and_on_demand_what_it_rests_on() {
    let dir = tempfile::tempdir().unwrap();
    let path = scene("cornell-diffuse.glb");
    let plan = |options: &str| run(dir.path(), &format!("plan {} --method photon {options}", path.display()));
    let (plain, explained) = (plan("").out, plan("--explain").out);
    let line = "caustic photon map: no surface is specular or glossy; saves 1000000 photon paths";
    let evidence = "0 of 4 materials in use are specular or glossy";
    assert!(plain.contains(line) && !plain.contains(evidence), "{plain}");
    assert!(explained.contains(line) && explained.contains(evidence), "{explained}");
    let json = plan("--json").json();
    let entries = json["plan"]["entries"].as_array().unwrap();
    let directions = entries.iter().find(|e| e["what"] == "photon directions").unwrap();
    assert!(directions["saves"]["wire_bytes"].as_u64().unwrap() > 0, "{directions}");
    let kept = plan("--keep-all").out;
    assert!(kept.contains("computed  caustic photon map: "), "{kept}");
}

#[test]
fn the_plan_chooses_a_method_and_says_why() {
    let dir = triangle_dir();
    let method = |options: &str| {
        let plan = run(dir.path(), &format!("plan triangle.gltf {options} --json")).json();
        let of = |key: &str| plan["plan"]["method"][key].as_str().unwrap().to_owned();
        let settings = plan["settings"].as_str().unwrap().to_owned();
        assert!(settings.starts_with(&format!("--method {} ", of("name"))), "{settings}");
        (of("name"), of("reason"))
    };
    assert_eq!(method("").0, "progressive");
    assert_eq!(method("--method path"), ("path".to_string(), "asked for".to_string()));
    let (name, reason) = method("--max-depth 4 --samples 2");
    assert!(name != "photon" && reason.contains("--max-depth"), "{name}: {reason}");
    let diffuse = scene("cornell-diffuse.glb");
    let plan = |options: &str| run(dir.path(), &format!("plan {} {options} --json", diffuse.display())).json();
    let bounded = plan("--photons 10M --memory 2M");
    let words: Vec<&str> = bounded["settings"].as_str().unwrap().split(' ').collect();
    assert_eq!(words[1], "progressive");
    let rounds: u64 = words[words.iter().position(|w| *w == "--rounds").unwrap() + 1].parse().unwrap();
    // What all photons would take, at 40 bytes a photon, in rounds of 2 MiB; the next lower number of rounds would not do.
    let photons = bounded["plan"]["global"]["expected_stored"].as_u64().unwrap();
    assert!(rounds > 128 && rounds.abs_diff(photons * 40 / (2 << 20)) <= 1, "{rounds} rounds of {photons} photons");
    let refused = |options: &str| run(dir.path(), &format!("plan {} {options}", diffuse.display()));
    refused("--photons 10M --memory 1").says(2, &["--memory", "would need", "emit fewer --photons"]);
    refused("--photons 10M --memory 8M --rounds 2").says(2, &["--memory: 8.00 MiB needs", "--rounds is 2"]);
    // Whether the scene is read for the camera's shape or not makes no difference.
    assert_eq!(method("--width 8 --height 8"), method(""));
    let text = run(dir.path(), "plan triangle.gltf");
    assert!(text.out.lines().nth(1).is_some_and(|l| l.starts_with("method: progressive — ")), "{text:?}");
}

//! The plan states a job's peak memory beforehand, and it holds: within a quarter for one process, and for the processes of a cluster,
//! which may take less.
#![cfg(target_os = "linux")]

use gatherlight_tests::processes::{high_water, program, serve, worker};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

fn scene(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes").join(name)
}

/// What `gatherlight plan` states for a process, in bytes: `single_process_bytes`, `worker_bytes` or `coordinator_bytes`.
fn stated(scene_file: &Path, arguments: &[&str], which: &str) -> u64 {
    let output = Command::new(program("gatherlight"))
        .arg("plan")
        .arg(scene_file)
        .args(arguments)
        .arg("--json")
        .output()
        .expect("the program starts");
    let plan: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    plan["plan"][which].as_u64().unwrap_or_else(|| panic!("no plan.{which} in {plan}"))
}

/// The most resident memory that `gatherlight render` ever had, in bytes: the kernel's high-water mark, read until the
/// process ends.
fn used(scene_file: &Path, arguments: &[&str]) -> u64 {
    let directory = tempfile::tempdir().expect("a directory");
    let mut child = Command::new(program("gatherlight"))
        .arg("render")
        .arg(scene_file)
        .arg("-o")
        .arg(directory.path().join("image.exr"))
        .args(arguments)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the program starts");
    let mut peak = 0;
    while child.try_wait().expect("a child").is_none() {
        peak = high_water(child.id()).unwrap_or(peak);
        std::thread::sleep(Duration::from_millis(3));
    }
    assert!(child.wait().expect("a child").success());
    peak
}

/// `threads` of `render`; the plan says the same for any number.
fn check_threads(name: &str, arguments: &[&str], threads: &str) {
    let file = scene(name);
    let with_threads = [arguments, &["--threads", threads]].concat();
    let (stated, used) = (stated(&file, arguments, "single_process_bytes"), used(&file, &with_threads));
    let ratio = used as f64 / stated as f64;
    println!("{name} {with_threads:?}: stated {} MiB, used {} MiB ({ratio:.2})", stated >> 20, used >> 20);
    assert!((0.75..=1.25).contains(&ratio), "{name}: stated {stated} bytes, used {used} ({ratio:.2} of it)");
}

/// With one thread per core.
fn check(name: &str, arguments: &[&str]) {
    check_threads(name, arguments, "0");
}

const TINY: [&str; 4] = ["--width", "16", "--samples", "1"];

#[test]
fn a_job_of_photons_takes_what_the_plan_states() {
    check("cornell-diffuse.glb", &[&TINY[..], &["--photons", "2M"]].concat());
    check("cornell-caustic.glb", &[&TINY[..], &["--photons", "1M", "--caustic-photons", "2M"]].concat());
}

/// Few photons, which the allocator keeps in its own heap, and many, whose arrays each go back to the system.
#[test]
fn a_job_of_photons_takes_that_with_one_thread_too() {
    for photons in ["300k", "1M", "8M"] {
        check_threads("cornell-diffuse.glb", &[&TINY[..], &["--photons", photons]].concat(), "1");
    }
}

#[test]
fn a_job_of_pixels_takes_what_the_plan_states() {
    check("cornell-diffuse.glb", &["--method", "path", "--width", "1536", "--samples", "1"]);
    // Several rounds, whose sums are kept beside the film.
    check("cornell-diffuse.glb", &["--method", "path", "--width", "1536", "--samples", "3"]);
}

/// A coordinator, a worker and a client as processes: the most that the first two ever had.
#[test]
fn coordinator_and_worker_take_what_the_plan_states() {
    for arguments in [
        &["--samples", "1", "--method", "photon", "--photons", "2M", "--final-gather", "0"][..],
        &["--method", "progressive", "--photons", "4M", "--rounds", "4"],
    ] {
        let (file, arguments) = (scene("cornell-diffuse.glb"), [&["--width", "16"], arguments].concat());
        let directory = tempfile::tempdir().expect("a directory");
        let (coordinator, url) = serve(&directory.path().join("store"));
        let worker = worker(&url, "w");
        let submitted = Command::new(program("gatherlight"))
            .arg("submit")
            .arg(&file)
            .args(["--coordinator", &url, "-o"])
            .arg(directory.path().join("image.exr"))
            .args(&arguments)
            .stderr(Stdio::null())
            .status();
        assert!(submitted.is_ok_and(|s| s.success()), "{arguments:?}");
        for (process, which) in [(&worker, "worker_bytes"), (&coordinator, "coordinator_bytes")] {
            let (stated, used) = (stated(&file, &arguments, which), high_water(process.id()).expect("runs"));
            let ratio = used as f64 / stated as f64;
            println!("{arguments:?}: {which} {} MiB, used {} MiB ({ratio:.2})", stated >> 20, used >> 20);
            assert!((0.6..=1.25).contains(&ratio), "{arguments:?}: {which} {stated}, used {used} ({ratio:.2} of it)");
        }
    }
}

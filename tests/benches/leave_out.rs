//! What leaving out saves: each scene of `scenes::spare` rendered by `gatherlight render --threads 1` with and without
//! `--keep-all`, in turns, as processes. The pixels must be equal, bit for bit; prints the bytes of the scene that a cluster is
//! sent, the best time from start to end and the peak memory of the process.

use gatherlight_render::job;
use gatherlight_render::settings::{Method, RenderSettings};
use gatherlight_tests::pixel_sha256;
use gatherlight_tests::processes::built_program;
use gatherlight_tests::scenes::spare::{self, Spare};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

/// Texels along each side of the scenes' images.
const TEXELS: u32 = 512;
/// Turns of each side; the best counts.
const TURNS: usize = 3;

/// One render.
struct Run {
    seconds: f64,
    peak_bytes: u64,
    pixels: String,
}

fn method(scene: &Spare) -> Method {
    match scene.name {
        "one of a hundred" | "one in view of a hundred" | "cameras and animations" => Method::Path,
        _ => Method::Photon,
    }
}

fn render(program: &Path, directory: &Path, scene: &Spare, keep_all: bool) -> Run {
    let (file, image) = (directory.join(&scene.bundle.name), directory.join("image.exr"));
    let method = method(scene);
    let mut command = Command::new(program);
    command.arg("render").arg(&file).arg("-o").arg(&image);
    command.args(["--threads", "1", "--width", "128", "--height", "128", "--samples", "4", "--method", method.name()]);
    if method == Method::Photon {
        command.args(["--photons", "100k", "--caustic-photons", "200k"]);
    }
    command.args(keep_all.then_some("--keep-all"));
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let begin = Instant::now();
    assert!(command.status().expect("starts").success(), "{}", scene.name);
    let seconds = begin.elapsed().as_secs_f64();
    let report = std::fs::read(image.with_extension("report.json")).expect("a report");
    let report: serde_json::Value = serde_json::from_slice(&report).expect("JSON");
    let pixels = pixel_sha256(&std::fs::read(&image).expect("an image"));
    Run { seconds, peak_bytes: report["peak_memory_bytes"].as_u64().expect("Linux"), pixels }
}

fn sent(scene: &Spare, keep_all: bool) -> u64 {
    let settings = RenderSettings { keep_all, ..RenderSettings::for_method(method(scene)) };
    let cut = job::cut(&scene.bundle, &settings).unwrap_or_else(|e| panic!("{e}"));
    cut.root.len() as u64
}

fn main() {
    let program = built_program("gatherlight");
    let directory = tempfile::tempdir().expect("a directory");
    println!("| scene | method | sent, KiB | time, s | peak memory, MiB |");
    println!("|---|---|---|---|---|");
    for scene in spare::scenes(TEXELS) {
        std::fs::write(directory.path().join(&scene.bundle.name), &scene.bundle.root).expect("is written");
        let mut best = [f64::INFINITY; 2];
        let mut peak = [u64::MAX; 2];
        for _ in 0..TURNS {
            let runs = [true, false].map(|keep_all| render(&program, directory.path(), &scene, keep_all));
            assert_eq!(runs[0].pixels, runs[1].pixels, "{}", scene.name);
            for (i, run) in runs.iter().enumerate() {
                best[i] = best[i].min(run.seconds);
                peak[i] = peak[i].min(run.peak_bytes);
            }
        }
        let sent = [true, false].map(|keep_all| sent(&scene, keep_all).div_ceil(1024));
        println!(
            "| {} | {} | {} → {} | {:.2} → {:.2} | {} → {} |",
            scene.name,
            method(&scene).name(),
            sent[0],
            sent[1],
            best[0],
            best[1],
            peak[0] >> 20,
            peak[1] >> 20
        );
    }
}

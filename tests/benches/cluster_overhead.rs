//! What the cluster costs: CPU time of coordinator, one worker and client as processes, joined by gRPC over TCP, against
//! the same job in one process; in turns, one compute thread each. The images must be equal byte for byte; the ratio of the
//! medians is meant to be at most [`AIM`].
//!
//! `GATHERLIGHT_BENCH_PHOTONS` sets another number of photon paths for each map. `-- --journal [photon | path | progressive]`: what
//! the journal costs instead.

#[path = "cluster_overhead/journal.rs"]
mod journal;

use gatherlight_tests::processes::{Whose, built_program, cpu_seconds};
use std::ffi::OsStr;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// Photon paths of each map; both maps hold about 10⁷ photons together.
const PATHS: u64 = 5_000_000;
/// Turns of each side; the median counts.
const TURNS: usize = 5;
/// CPU time through gRPC over CPU time in one process.
const AIM: f64 = 1.05;

fn start(program: &Path, arguments: &[&OsStr], stdout: Stdio) -> Child {
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::null()).stdout(stdout).stderr(Stdio::null());
    command.spawn().unwrap_or_else(|e| panic!("{}: {e}", program.display()))
}

fn succeed(mut child: Child) {
    assert!(child.wait().expect("a child").success(), "a program failed");
}

fn end(mut child: Child) {
    drop(child.kill());
    drop(child.wait());
}

/// A command line in words, paths among them.
fn words<'a>(text: &'a str, paths: &[&'a Path]) -> Vec<&'a OsStr> {
    let mut paths = paths.iter();
    let path = |w| if w == "PATH" { paths.next().expect("a path for each").as_os_str() } else { OsStr::new(w) };
    text.split(' ').map(path).collect()
}

struct Bench {
    gatherlight: std::path::PathBuf,
    worker: std::path::PathBuf,
    scene: std::path::PathBuf,
    settings: String,
}

impl Bench {
    fn one_process(&self, image: &Path) {
        let line = format!("render PATH -o PATH --threads 1 {}", self.settings);
        succeed(start(&self.gatherlight, &words(&line, &[&self.scene, image]), Stdio::null()));
    }

    fn cluster(&self, image: &Path, store: &Path) {
        let line = "serve --listen 127.0.0.1:0 --threads 1 --store PATH";
        let mut coordinator = start(&self.gatherlight, &words(line, &[store]), Stdio::piped());
        let mut said = String::new();
        BufReader::new(coordinator.stdout.take().expect("is piped")).read_line(&mut said).expect("a line");
        let url = said.trim().strip_prefix("listening on ").expect("says where it listens");
        let worker = start(&self.worker, &words(&format!("--coordinator {url} --threads 1"), &[]), Stdio::null());
        let line = format!("submit PATH -o PATH --coordinator {url} {}", self.settings);
        succeed(start(&self.gatherlight, &words(&line, &[&self.scene, image]), Stdio::null()));
        end(worker);
        end(coordinator);
    }
}

fn seconds(work: impl FnOnce()) -> f64 {
    let before = cpu_seconds(Whose::Children);
    work();
    cpu_seconds(Whose::Children) - before
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn main() {
    // `cargo test --benches` would run it too.
    if !std::env::args().any(|a| a == "--bench") {
        return;
    }
    let has = |flag: &str| std::env::args().any(|a| a == flag);
    if has("--journal") {
        return journal::compare(has);
    }
    let paths = std::env::var("GATHERLIGHT_BENCH_PHOTONS").ok().and_then(|v| v.parse().ok()).unwrap_or(PATHS);
    let bench = Bench {
        gatherlight: built_program("gatherlight"),
        worker: built_program("gatherlight-worker"),
        scene: Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes/cornell-caustic.glb"),
        settings: format!("--photons {paths} --caustic-photons {paths} --width 256 --samples 4"),
    };
    let directory = tempfile::tempdir().expect("a directory");
    let at = |name: &str| directory.path().join(name);
    println!("cornell-caustic, {}", bench.settings);
    let (mut alone, mut joined) = (Vec::new(), Vec::new());
    for turn in 0..TURNS {
        alone.push(seconds(|| bench.one_process(&at("one.exr"))));
        joined.push(seconds(|| bench.cluster(&at("cluster.exr"), &at(&format!("store{turn}")))));
        let read = |name| std::fs::read(at(name)).expect("an image");
        assert!(read("one.exr") == read("cluster.exr"), "the images differ");
        println!(
            "one process {:6.2} s   cluster {:6.2} s   {:.3}",
            alone[turn],
            joined[turn],
            joined[turn] / alone[turn]
        );
    }
    let ratio = median(joined) / median(alone);
    println!("medians: {ratio:.3}, {} the aim of {AIM}", if ratio <= AIM { "within" } else { "above" });
}

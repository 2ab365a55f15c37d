//! `serve`, `submit`, `jobs`, `workers`, `watch`, `fetch` and `cancel` by the real program, with workers in this process.

mod common;

use common::{Run, command, run, triangle_dir};
use gatherlight_worker::{Connector, WorkerConfig};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tokio::sync::oneshot;

const QUICK: &str = "--height 16 --samples 2 --photons 2k --caustic-photons 2k";
/// Far beyond what anything here takes; only keeps a failure from hanging.
const PATIENCE: Duration = Duration::from_secs(120);

/// A coordinator, ended when dropped.
struct Coordinator {
    child: Child,
    url: String,
    _store: tempfile::TempDir,
}

impl Coordinator {
    fn start() -> Self {
        let store = tempfile::tempdir().unwrap();
        let mut child = command(store.path())
            .args(["serve", "--listen", "127.0.0.1:0", "--store", "store"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let url = line.trim().strip_prefix("listening on ").unwrap_or_else(|| panic!("{line:?}")).to_string();
        Coordinator { child, url, _store: store }
    }

    /// Runs a command that speaks to it.
    fn run(&self, dir: &Path, args: &str) -> Run {
        run(dir, &format!("{args} --coordinator {}", self.url))
    }

    fn worker(&self) -> Worker {
        let (stop, stopped) = oneshot::channel::<()>();
        let connector = Connector::url(&self.url).unwrap();
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
            let config = WorkerConfig { threads: 1, ..WorkerConfig::new("test-worker") };
            runtime.block_on(gatherlight_worker::run(config, connector, async {
                let _ = stopped.await;
            }))
        });
        Worker { stop: Some(stop), thread: Some(thread) }
    }
}

impl Drop for Coordinator {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A worker in this process, sent away when dropped.
struct Worker {
    stop: Option<oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<Result<(), gatherlight_worker::WorkerError>>>,
}

impl Drop for Worker {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn signal(child: &Child, name: &str) {
    let sent = Command::new("kill").args([name, &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
}

fn wait_until<T>(mut ready: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(value) = ready() {
            return value;
        }
        assert!(start.elapsed() < PATIENCE, "nothing happened for {PATIENCE:?}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn read(dir: &Path, name: &str) -> Vec<u8> {
    std::fs::read(dir.join(PathBuf::from(name))).unwrap()
}

#[test]
fn the_cluster_s_file_is_that_of_render_byte_for_byte() {
    let dir = triangle_dir();
    let coordinator = Coordinator::start();
    let _workers = [coordinator.worker(), coordinator.worker()];
    let there = coordinator.run(dir.path(), &format!("submit triangle.gltf -o there.exr {QUICK} --json"));
    there.says(0, &[]);
    assert_eq!(there.json()["files"][0], "there.exr");
    run(dir.path(), &format!("render triangle.gltf -o here.exr {QUICK}")).says(0, &[]);
    assert!(read(dir.path(), "there.exr") == read(dir.path(), "here.exr"), "the files differ");
}

#[test]
fn a_detached_job_is_listed_watched_and_fetched() {
    let dir = triangle_dir();
    let coordinator = Coordinator::start();
    let submitted = coordinator.run(dir.path(), &format!("submit triangle.gltf -o x.exr {QUICK} --detach --name lamp"));
    submitted.says(0, &[]);
    let id = submitted.out.trim();
    assert_eq!(id.len(), 16, "{submitted:?}");
    // Nobody works yet.
    assert!(coordinator.run(dir.path(), "workers").out.contains("gatherlight-worker --coordinator http://127.0.0.1:"));
    let listed = coordinator.run(dir.path(), "jobs --json").json();
    assert_eq!(
        (&listed[0]["id"], &listed[0]["name"], &listed[0]["state"]),
        (&id.into(), &"lamp".into(), &"waiting".into())
    );
    coordinator.run(dir.path(), &format!("fetch {id} -o x.exr")).says(1, &["error:", "waiting"]);
    assert!(!dir.path().join("x.exr").exists());

    let _worker = coordinator.worker();
    let watched = coordinator.run(dir.path(), &format!("watch {id}"));
    // Which phases it saw depends on how fast they went by.
    watched.says(0, &[]);
    assert!(watched.out.contains(&format!("{id} done after")), "{watched:?}");
    let workers = coordinator.run(dir.path(), "workers");
    assert!(workers.out.contains("test-worker") && workers.out.starts_with("ID "), "{workers:?}");
    coordinator.run(dir.path(), &format!("fetch {id} -o x.png")).says(0, &[]);
    assert!(read(dir.path(), "x.exr").len() > 1000 && read(dir.path(), "x.png").starts_with(b"\x89PNG"));
    let cancelled = coordinator.run(dir.path(), &format!("cancel {id}"));
    assert!(cancelled.out.contains("had ended already: done"), "{cancelled:?}");
    assert!(coordinator.run(dir.path(), "jobs").out.contains("lamp"));
}

#[test]
fn a_cancelled_job_ends_with_code_1_for_who_watches() {
    let dir = triangle_dir();
    let coordinator = Coordinator::start();
    let submitted = coordinator.run(dir.path(), &format!("submit triangle.gltf -o x.exr {QUICK} --detach"));
    let id = submitted.out.trim();
    assert!(coordinator.run(dir.path(), &format!("cancel {id}")).out.contains("is cancelled"));
    coordinator.run(dir.path(), &format!("watch {id}")).says(1, &[id, "cancelled"]);
}

#[test]
fn interrupting_submit_leaves_the_job_and_says_how_to_return() {
    let dir = triangle_dir();
    let coordinator = Coordinator::start();
    // No worker: the job waits for as long as it takes.
    let submit = command(dir.path())
        .args(["submit", "triangle.gltf", "-o", "x.exr"])
        .env("GATHERLIGHT_COORDINATOR", &coordinator.url)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let id = wait_until(|| {
        let jobs = coordinator.run(dir.path(), "jobs --json").json();
        jobs[0]["id"].as_str().map(String::from)
    });
    // The job is there before its id has reached the program that submitted it, which then begins to watch.
    std::thread::sleep(Duration::from_millis(500));
    signal(&submit, "-INT");
    let run: Run = submit.wait_with_output().unwrap().into();
    let url = &coordinator.url;
    run.says(
        130,
        &[
            &format!("job {id} goes on"),
            &format!("gatherlight watch {id} --coordinator {url}"),
            &format!("gatherlight fetch {id} -o x.exr --coordinator {url}"),
            &format!("gatherlight cancel {id} --coordinator {url}"),
        ],
    );
    assert_eq!(coordinator.run(dir.path(), "jobs --json").json()[0]["state"], "waiting");
}

#[test]
fn an_unreachable_coordinator_is_named_after_bounded_attempts() {
    let dir = triangle_dir();
    // A port that was just free, and that nobody listens on.
    let address = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let url = format!("http://{address}");
    run(dir.path(), &format!("jobs --coordinator {url} --attempts 2"))
        .says(1, &[&url, "2 attempts", "gatherlight serve"]);
    run(dir.path(), &format!("submit triangle.gltf -o x.exr --coordinator {url} --attempts 1")).says(1, &[&url]);
    run(dir.path(), "jobs --coordinator not/a/url").says(2, &["not/a/url", "http://localhost:7420"]);
}

#[test]
fn a_job_that_is_not_there_is_named() {
    let dir = triangle_dir();
    let coordinator = Coordinator::start();
    for command in ["watch", "cancel", "fetch -o x.exr"] {
        coordinator.run(dir.path(), &format!("{command} 00000000000000ab")).says(1, &["00000000000000ab"]);
    }
    assert_eq!(coordinator.run(dir.path(), "jobs").out.trim(), "no jobs");
}

#[test]
fn serve_says_what_it_cannot_have_and_ends_when_asked() {
    let dir = tempfile::tempdir().unwrap();
    let mut coordinator = Coordinator::start();
    let address = coordinator.url.strip_prefix("http://").unwrap().to_string();
    run(dir.path(), &format!("serve --listen {address} --store s")).says(1, &["cannot listen on", &address]);
    std::fs::write(dir.path().join("file"), "").unwrap();
    run(dir.path(), "serve --listen 127.0.0.1:0 --store file").says(1, &["file", "store"]);
    signal(&coordinator.child, "-TERM");
    let status = wait_until(|| coordinator.child.try_wait().unwrap());
    assert_eq!(status.code(), Some(0));
}

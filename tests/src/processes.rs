//! The real programs as child processes.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// Where the programs of this build are: `target/<profile>`.
fn profile_directory() -> PathBuf {
    let test = std::env::current_exe().expect("a test is a file");
    // …/target/<profile>/deps/<test>: programs are two levels up.
    test.parent().and_then(Path::parent).expect("is in target/<profile>/deps").to_owned()
}

/// The program `name` of this build. `cargo test --workspace` has built it; a test run of this package alone may not.
///
/// # Panics
/// When it is not there and cannot be built.
pub fn program(name: &str) -> PathBuf {
    let path = profile_directory().join(name);
    if path.is_file() { path } else { built_program(name) }
}

/// The program `name`, built from the sources as they are now: `cargo bench` builds none.
///
/// # Panics
/// When it cannot be built.
pub fn built_program(name: &str) -> PathBuf {
    let profile = profile_directory();
    let path = profile.join(name);
    let mut build = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    build.args(["build", "-p", name, "--bin", name]).current_dir(env!("CARGO_MANIFEST_DIR"));
    if profile.file_name().is_some_and(|p| p == "release") {
        build.arg("--release");
    }
    assert!(build.status().is_ok_and(|s| s.success()) && path.is_file(), "cannot build {}", path.display());
    path
}

/// Whose computing time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Whose {
    /// This process.
    Own,
    /// All its children that have been waited for.
    Children,
}

/// Clock ticks per second in /proc, on every Linux architecture that Rust supports.
const TICKS: f64 = 100.0;

/// CPU seconds, user and system (proc(5): utime, stime, cutime, cstime).
///
/// # Panics
/// Where there is no /proc.
pub fn cpu_seconds(whose: Whose) -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").expect("Linux");
    let fields = stat.rsplit(") ").next().expect("fields after the name");
    let first = if whose == Whose::Own { 11 } else { 13 };
    fields.split(' ').skip(first).take(2).map(|t| t.parse::<f64>().expect("ticks")).sum::<f64>() / TICKS
}

/// A child process, killed with SIGKILL when dropped.
pub struct Process(Child);

impl Process {
    /// Kills it at once (SIGKILL) and waits until it is gone.
    pub fn kill(mut self) {
        drop(self.0.kill());
        drop(self.0.wait());
    }
    /// Sends a signal by name, e.g. `TERM` or `STOP`.
    ///
    /// # Panics
    /// When that fails.
    pub fn signal(&self, name: &str) {
        let sent = Command::new("sh").args(["-c", &format!("kill -{name} {}", self.0.id())]).status();
        assert!(sent.is_ok_and(|s| s.success()), "cannot send {name}");
    }
    /// Waits for its end; returns the exit code, `None` after a signal.
    ///
    /// # Panics
    /// When it cannot be waited for.
    pub fn exit_code(mut self) -> Option<i32> {
        self.0.wait().expect("can be waited for").code()
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        drop(self.0.kill());
        drop(self.0.wait());
    }
}

/// A coordinator on a free port; returns its URL as well.
///
/// # Panics
/// When it does not start.
pub fn serve(store: &Path) -> (Process, String) {
    spawn_coordinator("127.0.0.1:0", store)
}

/// A coordinator at `address`.
///
/// # Panics
/// When it does not start.
pub fn serve_at(address: &str, store: &Path) -> Process {
    spawn_coordinator(address, store).0
}

fn spawn_coordinator(address: &str, store: &Path) -> (Process, String) {
    let mut command = Command::new(program("gatherlight"));
    command.args(["serve", "--listen", address, "--threads", "1", "--store"]).arg(store);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().expect("starts");
    let mut line = String::new();
    BufReader::new(child.stdout.take().expect("is piped")).read_line(&mut line).expect("says where it listens");
    let url = line.trim().strip_prefix("listening on ").expect("says where it listens").to_owned();
    (Process(child), url)
}

/// A worker with one thread.
///
/// # Panics
/// When it does not start.
pub fn worker(url: &str, name: &str) -> Process {
    let mut command = Command::new(program("gatherlight-worker"));
    command.args(["--coordinator", url, "--threads", "1", "--memory", "1G", "--log", "error", "--name", name]);
    Process(command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("starts"))
}

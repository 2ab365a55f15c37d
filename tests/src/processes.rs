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
    /// From now on the system gives it no more memory.
    ///
    /// # Panics
    /// When that cannot be had.
    pub fn starve(&self) {
        let limited = Command::new("prlimit").args(["--as=1", "--pid", &self.0.id().to_string()]).status();
        assert!(limited.is_ok_and(|s| s.success()), "cannot limit its memory");
    }
    /// Its number.
    pub fn id(&self) -> u32 {
        self.0.id()
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

/// The most resident memory that the process of this number ever had, in bytes: the kernel's high-water mark.
pub fn high_water(id: u32) -> Option<u64> {
    status(id, "VmHWM:")
}

/// Memory of the process `id` that is resident now, bytes.
pub fn resident(id: u32) -> Option<u64> {
    status(id, "VmRSS:")
}

fn status(id: u32, field: &str) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{id}/status")).ok()?;
    let kib = status.lines().find_map(|l| l.strip_prefix(field)?.trim().strip_suffix(" kB")?.trim().parse().ok());
    kib.map(|k: u64| k * 1024)
}

/// A program's arguments as the system shows them to everyone.
///
/// # Panics
/// When they cannot be read.
pub fn shown_arguments(process: &Process) -> String {
    let path = format!("/proc/{}/cmdline", process.0.id());
    std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{path}: {e}")).replace('\0', " ")
}

/// The program `name` with its messages going to the file `log`.
///
/// # Panics
/// When it does not start.
pub fn logged(name: &str, arguments: &[&str], log: &Path) -> Process {
    let file = std::fs::File::create(log).unwrap_or_else(|e| panic!("{}: {e}", log.display()));
    let mut command = Command::new(program(name));
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::null()).stderr(file);
    Process(command.spawn().expect("starts"))
}

/// A coordinator on a free port; returns its URL as well.
///
/// # Panics
/// When it does not start.
pub fn serve(store: &Path) -> (Process, String) {
    spawn_coordinator("127.0.0.1:0", store, &[])
}

/// The same with further arguments.
///
/// # Panics
/// When it does not start.
pub fn serve_with(store: &Path, arguments: &[&str]) -> (Process, String) {
    spawn_coordinator("127.0.0.1:0", store, arguments)
}

/// A coordinator at `address`.
///
/// # Panics
/// When it does not start.
pub fn serve_at(address: &str, store: &Path) -> Process {
    spawn_coordinator(address, store, &[]).0
}

/// A coordinator at `address` to whom a disk seems full where a file would grow beyond `bytes`.
///
/// # Panics
/// When it does not start.
pub fn serve_with_files_up_to(bytes: u64, address: &str, store: &Path) -> Process {
    let mut command = Command::new("sh");
    // Without the signal, writing fails as on a full disk.
    let limited = format!("trap '' XFSZ; ulimit -f {}; exec \"$0\" \"$@\"", bytes / 512);
    command.args(["-c", &limited]).arg(program("gatherlight"));
    coordinator(command, address, store, &[]).0
}

fn spawn_coordinator(address: &str, store: &Path, arguments: &[&str]) -> (Process, String) {
    coordinator(Command::new(program("gatherlight")), address, store, arguments)
}

fn coordinator(mut command: Command, address: &str, store: &Path, arguments: &[&str]) -> (Process, String) {
    command.args(["serve", "--listen", address, "--threads", "1", "--store"]).arg(store).args(arguments);
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

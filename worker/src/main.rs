//! `gatherlight-worker`: arguments → run → exit code.

use clap::Parser;
use gatherlight_worker::config::{DEFAULT_ATTEMPTS, DEFAULT_MEMORY_BYTES};
use gatherlight_worker::relay::Listen;
use gatherlight_worker::{Connector, WorkerConfig, WorkerError, run};
use std::net::SocketAddr;
use std::process::ExitCode;
use tracing_subscriber::EnvFilter;

const EXAMPLES: &str = "\
Examples:
  gatherlight-worker --coordinator http://localhost:7420
  gatherlight-worker --coordinator http://render.lan:7420 --threads 8 --memory 16G

It connects out, so it may sit behind NAT. Ctrl-C or SIGTERM lets it finish the task it computes and return the others.
Exit codes: 0 left as asked, 1 could not go on, 2 wrong usage.";

/// A Gatherlight worker: joins a coordinator, computes what it is given, returns the results
#[derive(Parser, Debug)]
#[command(name = "gatherlight-worker", version, after_help = EXAMPLES)]
struct Arguments {
    /// The coordinator's URL
    #[arg(long, value_name = "URL", env = "GATHERLIGHT_COORDINATOR", default_value = "http://localhost:7420")]
    coordinator: String,
    /// Compute threads; 0: one per core
    #[arg(long, value_name = "N", env = "GATHERLIGHT_THREADS", default_value_t = 0)]
    threads: usize,
    /// Memory for scene files and photon maps, e.g. 8G
    #[arg(long, value_name = "BYTES", env = "GATHERLIGHT_MEMORY", value_parser = bytes, default_value_t = DEFAULT_MEMORY_BYTES)]
    memory: u64,
    /// Name in the coordinator's listings; by default the host's name
    #[arg(long, value_name = "NAME", env = "GATHERLIGHT_NAME")]
    name: Option<String>,
    /// Failed attempts in a row to reach the coordinator before giving up
    #[arg(long, value_name = "N", default_value_t = DEFAULT_ATTEMPTS)]
    attempts: u32,
    /// Address on which other workers fetch scenes and maps from this one; by default a free port of the address from which it
    /// reaches the coordinator
    #[arg(long, value_name = "ADDR", env = "GATHERLIGHT_RELAY_LISTEN")]
    relay_listen: Option<SocketAddr>,
    /// Listen for no other workers, and fetch from the coordinator alone
    #[arg(long, conflicts_with = "relay_listen")]
    no_relay: bool,
    /// What to log to stderr: error, warn, info, debug, or a filter like gatherlight_worker=debug
    #[arg(long, value_name = "FILTER", env = "GATHERLIGHT_LOG", default_value = "info")]
    log: String,
}

/// `8G` → bytes; K, M, G and T are powers of 1024.
fn bytes(text: &str) -> Result<u64, String> {
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let shift = match text[digits.len()..].to_ascii_uppercase().as_str() {
        "" | "B" => 0,
        "K" | "KB" | "KIB" => 10,
        "M" | "MB" | "MIB" => 20,
        "G" | "GB" | "GIB" => 30,
        "T" | "TB" | "TIB" => 40,
        unit => return Err(format!("unknown unit {unit:?}; use K, M, G or T")),
    };
    let number: u64 = digits.parse().map_err(|_| "write a whole number, with K, M, G or T behind it".to_owned())?;
    number.checked_mul(1 << shift).ok_or_else(|| "is more than 16 EiB".to_owned())
}

fn default_name() -> String {
    let name = std::fs::read_to_string("/etc/hostname").unwrap_or_default();
    let name = name.trim();
    if name.is_empty() { format!("worker-{}", std::process::id()) } else { name.to_owned() }
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let filter = match EnvFilter::try_new(&arguments.log) {
        Ok(filter) => filter,
        Err(error) => {
            eprintln!("error: --log {:?}: {error}", arguments.log);
            return ExitCode::from(2);
        }
    };
    let ansi = std::io::IsTerminal::is_terminal(&std::io::stderr());
    tracing_subscriber::fmt().with_env_filter(filter).with_ansi(ansi).with_writer(std::io::stderr).init();
    let code = |error: &WorkerError| if matches!(error, WorkerError::Url { .. }) { 2 } else { 1 };
    match start(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(code(&error))
        }
    }
}

fn start(arguments: Arguments) -> Result<(), WorkerError> {
    let connector = Connector::url(&arguments.coordinator)?;
    let config = WorkerConfig {
        threads: arguments.threads,
        memory_bytes: arguments.memory,
        max_attempts: arguments.attempts,
        relay: match (arguments.no_relay, arguments.relay_listen) {
            (true, _) => Listen::Off,
            (false, None) => Listen::Auto,
            (false, Some(address)) => Listen::On(address),
        },
        ..WorkerConfig::new(arguments.name.unwrap_or_else(default_name))
    };
    let runtime = tokio::runtime::Builder::new_multi_thread()
        // Waiting and copying only: the compute threads are others.
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(|e| WorkerError::Threads(e.to_string()))?;
    let ended = runtime.block_on(run(config, connector, stop_asked()));
    runtime.shutdown_background();
    ended
}

/// Ready at Ctrl-C or, on Unix, SIGTERM.
async fn stop_asked() {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        if let Ok(mut terminate) = signal(SignalKind::terminate()) {
            tokio::select! {
                _ = terminate.recv() => return,
                pressed = tokio::signal::ctrl_c() => if pressed.is_ok() { return },
            }
        }
    }
    if tokio::signal::ctrl_c().await.is_err() {
        std::future::pending::<()>().await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_with_their_units() {
        assert_eq!(bytes("123"), Ok(123));
        assert_eq!(bytes("8G"), Ok(8 << 30));
        assert_eq!(bytes("512mb"), Ok(512 << 20));
        for bad in ["", "G", "-1", "1.5G", "3X", "99999999T"] {
            assert!(bytes(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn the_arguments_are_consistent() {
        use clap::CommandFactory;
        Arguments::command().debug_assert();
    }
}

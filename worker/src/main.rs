//! `gatherlight-worker`: arguments → run → exit code.

use clap::Parser;
use gatherlight_proto::credentials::{CredentialFiles, Credentials};
use gatherlight_telemetry::{LogOptions, MakePage};
use gatherlight_worker::config::{DEFAULT_ATTEMPTS, DEFAULT_MEMORY_BYTES};
use gatherlight_worker::counters::Counters;
use gatherlight_worker::relay::Listen;
use gatherlight_worker::{Connector, WorkerConfig, WorkerError, run};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use tokio::net::TcpListener;

/// What is logged unless told.
const DEFAULT_LOG: &str = "info";

const EXAMPLES: &str = "\
Examples:
  gatherlight-worker --coordinator http://localhost:7420
  gatherlight-worker --coordinator http://render.lan:7420 --token-file gatherlight.token --threads 8 --memory 16G

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
    /// File with the token that proves who joins; never the token itself, which listings of processes would show
    #[arg(long, value_name = "FILE", env = "GATHERLIGHT_TOKEN_FILE")]
    token_file: Option<PathBuf>,
    /// Certificates (PEM) of the authorities to trust, for an https:// URL
    #[arg(long, value_name = "FILE", env = "GATHERLIGHT_TLS_CA")]
    tls_ca: Option<PathBuf>,
    /// Own certificate (PEM), where the coordinator asks for one
    #[arg(long, value_name = "FILE", env = "GATHERLIGHT_TLS_CERT")]
    tls_cert: Option<PathBuf>,
    /// Its key (PEM)
    #[arg(long, value_name = "FILE", env = "GATHERLIGHT_TLS_KEY")]
    tls_key: Option<PathBuf>,
    /// Serve metrics for Prometheus at http://ADDR/metrics
    #[arg(long, value_name = "ADDR", env = "GATHERLIGHT_METRICS")]
    metrics: Option<SocketAddr>,
    /// What to log to stderr: error, warn, info, debug, or a filter like gatherlight_worker=debug.
    /// `json` makes each message a JSON object on a line of its own, as in --log json or --log json,debug
    #[arg(long, value_name = "[json,]FILTER", env = "GATHERLIGHT_LOG", default_value = DEFAULT_LOG)]
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
    if let Err(error) = LogOptions::parse(&arguments.log, DEFAULT_LOG).init() {
        eprintln!("error: {error}");
        return ExitCode::from(2);
    }
    let code = |error: &WorkerError| match error {
        WorkerError::Url { .. } | WorkerError::Credentials(_) => 2,
        _ => 1,
    };
    match start(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(code(&error))
        }
    }
}

fn start(arguments: Arguments) -> Result<(), WorkerError> {
    let files = CredentialFiles {
        token: arguments.token_file,
        authority: arguments.tls_ca,
        certificate: arguments.tls_cert,
        key: arguments.tls_key,
    };
    let credentials = Credentials::read(&files).map_err(WorkerError::Credentials)?;
    if let Some(warning) = credentials.warning(&arguments.coordinator) {
        tracing::warn!("{warning}");
    }
    let connector = Connector::with(&arguments.coordinator, credentials)?;
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
    let ended = runtime.block_on(async {
        if let Some(address) = arguments.metrics {
            serve_metrics(address, config.counters.clone()).await?;
        }
        run(config, connector, stop_asked()).await
    });
    runtime.shutdown_background();
    ended
}

/// Serves metrics as long as the process lives.
async fn serve_metrics(address: SocketAddr, counters: Arc<Counters>) -> Result<(), WorkerError> {
    let failed = |source| WorkerError::Metrics { address, source };
    let listener = TcpListener::bind(address).await.map_err(failed)?;
    tracing::info!(address = %listener.local_addr().map_err(failed)?, "metrics");
    let make: MakePage = Arc::new(move || {
        let page = counters.page();
        Box::pin(async move { page })
    });
    tokio::spawn(gatherlight_telemetry::serve(listener, make));
    Ok(())
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

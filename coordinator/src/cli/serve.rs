//! `gatherlight serve`: a coordinator for a cluster.

use super::connection::runtime;
use super::error::CliResult;
use super::format::parse_bytes;
use super::{print_json, print_result};
use crate::access::AccessConfig;
use crate::server::{ServeConfig, Server};
use clap::Args;
use serde_json::json;
use std::net::SocketAddr;
use std::path::PathBuf;

const EXAMPLES: &str = "\
Workers join with `gatherlight-worker --coordinator URL`, clients speak to it with submit, jobs, watch, fetch, cancel \
and workers. On an address that other machines reach, they prove themselves by a token or a certificate; \
docs/security.md says how.

Examples:
  gatherlight serve
  gatherlight token > gatherlight.token
  gatherlight serve --listen 0.0.0.0:7420 --token-file gatherlight.token --store /var/lib/gatherlight";

/// Run a coordinator that workers join and clients submit jobs to
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct ServeArgs {
    /// Address to listen on; port 0 takes a free one, which is printed
    #[arg(
        long,
        value_name = "ADDR",
        env = "GATHERLIGHT_LISTEN",
        hide_env_values = true,
        default_value = "127.0.0.1:7420"
    )]
    listen: SocketAddr,
    /// Directory of scenes and finished images; made if missing
    #[arg(
        long,
        value_name = "DIR",
        env = "GATHERLIGHT_STORE",
        hide_env_values = true,
        default_value = "gatherlight-store"
    )]
    store: PathBuf,
    /// Threads for merging photons and encoding images; 0: one per core
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
    /// Most bytes kept in the store, e.g. 64G
    #[arg(long, value_name = "BYTES", value_parser = parse_bytes, default_value = "64G")]
    max_store: u64,
    /// Most jobs that have not ended
    #[arg(long, value_name = "N", default_value_t = 64)]
    max_jobs: usize,
    /// Most memory one job may need of the coordinator, by its plan, e.g. 16G
    #[arg(long, value_name = "BYTES", value_parser = parse_bytes, default_value = "16G")]
    max_job_memory: u64,
    /// Most memory for results that are not merged yet, e.g. 1G; workers wait for room
    #[arg(long, value_name = "BYTES", value_parser = parse_bytes, default_value = "1G")]
    max_result_memory: u64,
    /// File of tokens, each line TOKEN or NAME ROLES TOKEN, with the roles worker, client, admin
    #[arg(long, value_name = "FILE", env = "GATHERLIGHT_TOKEN_FILE", hide_env_values = true, help_heading = "Access")]
    token_file: Option<PathBuf>,
    /// The coordinator's certificate (PEM): connections are encrypted
    #[arg(long, value_name = "FILE", env = "GATHERLIGHT_TLS_CERT", hide_env_values = true, help_heading = "Access")]
    tls_cert: Option<PathBuf>,
    /// Its key (PEM)
    #[arg(long, value_name = "FILE", env = "GATHERLIGHT_TLS_KEY", hide_env_values = true, help_heading = "Access")]
    tls_key: Option<PathBuf>,
    /// Authority (PEM) that has to vouch for every worker's and client's certificate
    #[arg(
        long,
        value_name = "FILE",
        env = "GATHERLIGHT_TLS_CLIENT_CA",
        hide_env_values = true,
        help_heading = "Access"
    )]
    tls_client_ca: Option<PathBuf>,
    /// Listen on the network though nobody has to prove anything: whoever can connect may submit work
    #[arg(long, help_heading = "Access")]
    insecure: bool,
    /// Serve metrics for Prometheus at http://ADDR/metrics
    #[arg(long, value_name = "ADDR", env = "GATHERLIGHT_METRICS", hide_env_values = true)]
    metrics: Option<SocketAddr>,
    /// Print the address as JSON on stdout
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ServeArgs) -> CliResult {
    let config = ServeConfig {
        threads: args.threads,
        max_store_bytes: args.max_store,
        max_live_jobs: args.max_jobs,
        max_job_bytes: args.max_job_memory,
        max_result_bytes: args.max_result_memory,
        access: AccessConfig {
            token_file: args.token_file.clone(),
            tls_certificate: args.tls_cert.clone(),
            tls_key: args.tls_key.clone(),
            tls_client_ca: args.tls_client_ca.clone(),
            insecure: args.insecure,
        },
        metrics: args.metrics,
        ..ServeConfig::new(args.listen, args.store.clone())
    };
    runtime()?.block_on(async {
        let server = Server::bind(config).await?;
        let scheme = if server.is_encrypted() { "https" } else { "http" };
        let url = format!("{scheme}://{}", server.local_addr());
        let metrics = server.metrics_addr().map(|address| format!("http://{address}/metrics"));
        if let Some(metrics) = &metrics {
            tracing::info!(url = metrics, "metrics");
        }
        if args.json {
            print_json(&json!({ "listening": url, "metrics": metrics }));
        } else {
            print_result(&format!("listening on {url}"));
        }
        Ok(server.run(shutdown()).await?)
    })
}

/// Ready at Ctrl-C or, on Unix, SIGTERM (what `docker stop` sends).
async fn shutdown() {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        if let Ok(mut terminate) = signal(SignalKind::terminate()) {
            tokio::select! {
                () = super::watch::interrupted() => {}
                _ = terminate.recv() => {}
            }
            return;
        }
    }
    super::watch::interrupted().await;
}

//! Reaching a coordinator, for the commands that speak to one.

use super::error::CliError;
use crate::client::{self, Client, DEFAULT_ATTEMPTS};
use clap::Args;
use gatherlight_proto::connect::endpoint;
use gatherlight_proto::credentials::{CredentialFiles, Credentials};
use std::future::Future;
use std::path::PathBuf;
use tonic::transport::Endpoint;

/// Which coordinator.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Connection")]
pub(super) struct ConnectionArgs {
    /// Address of the coordinator
    #[arg(
        long,
        value_name = "URL",
        env = "GATHERLIGHT_COORDINATOR",
        hide_env_values = true,
        default_value = "http://localhost:7420"
    )]
    pub(super) coordinator: String,
    /// File with the token that proves who asks; never the token itself, which listings of processes would show
    #[arg(long, value_name = "FILE", env = "GATHERLIGHT_TOKEN_FILE", hide_env_values = true)]
    token_file: Option<PathBuf>,
    /// Certificates (PEM) of the authorities to trust, for an https:// URL
    #[arg(long, value_name = "FILE", env = "GATHERLIGHT_TLS_CA", hide_env_values = true)]
    tls_ca: Option<PathBuf>,
    /// Own certificate (PEM), where the coordinator asks for one
    #[arg(long, value_name = "FILE", env = "GATHERLIGHT_TLS_CERT", hide_env_values = true)]
    tls_cert: Option<PathBuf>,
    /// Its key (PEM)
    #[arg(long, value_name = "FILE", env = "GATHERLIGHT_TLS_KEY", hide_env_values = true)]
    tls_key: Option<PathBuf>,
    /// Attempts to reach it, with growing pauses
    #[arg(long, value_name = "N", default_value_t = DEFAULT_ATTEMPTS, value_parser = clap::value_parser!(u32).range(1..=100))]
    attempts: u32,
}

impl ConnectionArgs {
    fn credentials(&self, token: Option<PathBuf>) -> Result<Credentials, CliError> {
        let files = CredentialFiles {
            token,
            authority: self.tls_ca.clone(),
            certificate: self.tls_cert.clone(),
            key: self.tls_key.clone(),
        };
        Credentials::read(&files).map_err(CliError::Usage)
    }
    /// Where the coordinator is and how to reach it, for what asks for no token.
    ///
    /// # Errors
    /// When the URL or a certificate makes no sense.
    pub(super) fn endpoint(&self) -> Result<Endpoint, CliError> {
        let url = &self.coordinator;
        endpoint(url, &self.credentials(None)?)
            .map_err(|reason| CliError::Usage(format!("{url:?} is no coordinator URL: {reason}")))
    }
    /// Connects, and runs `work` until it is done.
    ///
    /// # Errors
    /// When the coordinator cannot be reached, or as `work` does.
    pub(super) fn run<F, T>(&self, work: impl FnOnce(Client) -> F) -> Result<T, CliError>
    where
        F: Future<Output = Result<T, CliError>>,
    {
        let credentials = self.credentials(self.token_file.clone())?;
        if let Some(warning) = credentials.warning(&self.coordinator) {
            tracing::warn!("{warning}");
        }
        runtime()?.block_on(async {
            let client = client::connect_with(&self.coordinator, self.attempts, &credentials).await?;
            work(client.noticing(|text| eprintln!("warning: {text}"))).await
        })
    }
}

/// The asynchronous runtime of a command.
///
/// # Errors
/// When the system gives no threads.
pub(super) fn runtime() -> Result<tokio::runtime::Runtime, CliError> {
    tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|e| CliError::Failed(format!("cannot start threads: {e}")))
}

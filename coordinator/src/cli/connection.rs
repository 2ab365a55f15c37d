//! Reaching a coordinator, for the commands that speak to one.

use super::error::CliError;
use crate::client::{self, Client, DEFAULT_ATTEMPTS};
use clap::Args;
use std::future::Future;

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
    /// Attempts to reach it, with growing pauses
    #[arg(long, value_name = "N", default_value_t = DEFAULT_ATTEMPTS, value_parser = clap::value_parser!(u32).range(1..=100))]
    attempts: u32,
}

impl ConnectionArgs {
    /// Connects, and runs `work` until it is done.
    ///
    /// # Errors
    /// When the coordinator cannot be reached, or as `work` does.
    pub(super) fn run<F, T>(&self, work: impl FnOnce(Client) -> F) -> Result<T, CliError>
    where
        F: Future<Output = Result<T, CliError>>,
    {
        runtime()?.block_on(async {
            let client = client::connect(&self.coordinator, self.attempts).await?;
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

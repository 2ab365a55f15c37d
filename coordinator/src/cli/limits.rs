//! When a job ends before all its rounds are done.

use super::error::CliError;
use super::format::parse_duration;
use crate::types::Limits;
use clap::Args;
use std::time::Duration;

/// Limits of a job.
#[derive(Args, Clone, Copy, Debug)]
#[command(next_help_heading = "Run")]
pub(super) struct LimitArgs {
    /// Begin no further round after this time, e.g. 30s, 5m or 1h30m, and make the image of the rounds that are done; for
    /// methods with rounds or Markov chains
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    time_limit: Option<Duration>,
}

impl LimitArgs {
    /// The limits of a job that can end early, or not.
    ///
    /// # Errors
    /// When there is a limit that can never end the job.
    pub(super) fn limits(self, can_end_early: bool) -> Result<Limits, CliError> {
        if self.time_limit.is_some() && !can_end_early {
            let text = "--time-limit ends a job between two rounds or Markov chains, and this one has a single round";
            return Err(CliError::Usage(text.into()));
        }
        Ok(Limits { time: self.time_limit })
    }
}

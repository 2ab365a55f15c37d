//! When a job ends before all its rounds are done.

use super::error::CliError;
use super::format::parse_duration;
use super::progress::warn;
use crate::types::Limits;
use clap::Args;
use gatherlight_render::settings::Method;
use std::time::Duration;

/// Limits of a job.
#[derive(Args, Clone, Copy, Debug)]
#[command(next_help_heading = "Run")]
pub(super) struct LimitArgs {
    /// Begin no further round after this time, e.g. 30s, 5m or 1h30m, and make the image of the rounds that are done. Without --samples,
    /// --rounds, --photons, --mutations or --chains the job goes on until then
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    time_limit: Option<Duration>,
    /// Begin no further round once the pixels' error (noise, and the bias of rounds that are blurred) is this share of their value,
    /// e.g. 1% or 0.01; goes on until then as --time-limit does
    #[arg(long, value_name = "E", value_parser = parse_share)]
    target_error: Option<f32>,
}

/// `1%` or `0.01` → 0.01.
fn parse_share(text: &str) -> Result<f32, String> {
    let (number, unit) = text.strip_suffix('%').map_or((text, 1.0), |number| (number, 0.01));
    let value = number.trim().parse::<f32>().ok().map(|v| v * unit).filter(|v| v.is_finite() && *v > 0.0);
    value.ok_or_else(|| format!("{text:?} is no error above 0, such as 1% or 0.01"))
}

impl LimitArgs {
    /// Whether there is a limit.
    pub(super) fn is_given(self) -> bool {
        self.time_limit.is_some() || self.target_error.is_some()
    }

    /// The limits of a job by `method` that has several rounds, or not.
    ///
    /// # Errors
    /// When there is a limit that can never end the job.
    pub(super) fn limits(self, method: Method, has_rounds: bool) -> Result<Limits, CliError> {
        let more = "this job has a single one: take more than one sample, round or chain";
        if self.time_limit.is_some() && !has_rounds {
            return Err(CliError::Usage(format!("--time-limit ends a job between two rounds, and {more}")));
        }
        if self.target_error.is_some() && !has_rounds {
            return Err(CliError::Usage(format!("--target-error needs rounds to know the error by, and {more}")));
        }
        if self.target_error.is_some() && method == Method::Photon {
            warn(
                "--target-error: all passes read the same photon maps, whose own noise and blur count in the error and do not fall; \
                 those of method progressive do",
            );
        }
        Ok(Limits { time: self.time_limit, error: self.target_error })
    }
}

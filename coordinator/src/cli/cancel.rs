//! `gatherlight cancel`: ends a job before its time.

use super::connection::ConnectionArgs;
use super::error::CliResult;
use super::{json, print_json, print_result};
use crate::types::{JobId, JobState};
use clap::Args;

const EXAMPLES: &str = "\
Examples:
  gatherlight cancel 00c0ffee00c0ffee --coordinator http://host:7420";

/// Cancel a job
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct CancelArgs {
    /// The job, as `gatherlight jobs` lists it
    job: JobId,
    #[command(flatten)]
    connection: ConnectionArgs,
    /// Print the job as JSON on stdout
    #[arg(long, help_heading = "Messages")]
    json: bool,
}

pub(super) fn run(args: &CancelArgs) -> CliResult {
    let id = args.job;
    let after = args.connection.run(|client| async move { Ok(client.cancel(id).await?) })?;
    if args.json {
        print_json(&json::job(&after));
    } else if after.state == JobState::Cancelled {
        print_result(&format!("{id} is cancelled"));
    } else {
        print_result(&format!("{id} had ended already: {}", after.state.name()));
    }
    Ok(())
}

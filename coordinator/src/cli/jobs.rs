//! `gatherlight jobs`: what a coordinator has to do and has done.

use super::connection::ConnectionArgs;
use super::error::CliResult;
use super::format::{duration, table};
use super::progress::round;
use super::{json, print_json, print_result};
use crate::types::{JobProgress, JobState};
use clap::Args;

const EXAMPLES: &str = "\
Examples:
  gatherlight jobs --coordinator http://host:7420
  gatherlight jobs --json | jq -r '.[] | select(.state == \"failed\") | .id'";

/// List the jobs of a coordinator, oldest first
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct JobsArgs {
    #[command(flatten)]
    connection: ConnectionArgs,
    /// Print the list as JSON on stdout
    #[arg(long, help_heading = "Messages")]
    json: bool,
}

pub(super) fn run(args: &JobsArgs) -> CliResult {
    let jobs = args.connection.run(|client| async move { Ok(client.list().await?) })?;
    if args.json {
        print_json(&jobs.iter().map(json::job).collect());
    } else if jobs.is_empty() {
        print_result("no jobs");
    } else {
        let mut header = vec!["ID", "NAME", "STATE", "DONE", "WORKERS", "TIME"];
        let mut rows: Vec<Vec<String>> = jobs.iter().map(row).collect();
        // Without tokens jobs have no owners.
        if jobs.iter().any(|j| !j.owner.is_empty()) {
            header.push("OWNER");
            rows.iter_mut().zip(&jobs).for_each(|(row, job)| row.push(job.owner.clone()));
        }
        print_result(&table(&header, &rows));
    }
    Ok(())
}

fn row(p: &JobProgress) -> Vec<String> {
    let state = match &p.state {
        JobState::Emission(map) | JobState::Merge(map) => format!("{} {}", p.state.name(), map.name()),
        JobState::Failed(reason) => format!("failed: {reason}"),
        other => other.name().into(),
    };
    let state = match round(p) {
        Some(round) => format!("{state}, {round}"),
        None => state,
    };
    let state = if p.waits_for.is_empty() { state } else { format!("{state}: {}", p.waits_for) };
    let done = match p.total {
        0 => String::new(),
        total => format!("{:.0} %", 100.0 * p.done as f64 / total as f64),
    };
    vec![p.id.to_string(), p.name.clone(), state, done, p.workers.to_string(), duration(p.elapsed)]
}

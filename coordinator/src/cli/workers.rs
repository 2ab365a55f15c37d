//! `gatherlight workers`: who works for a coordinator.

use super::connection::ConnectionArgs;
use super::error::CliResult;
use super::format::{bytes, duration, table};
use super::{json, print_json, print_result};
use crate::types::WorkerInfo;
use clap::Args;

const EXAMPLES: &str = "\
Examples:
  gatherlight workers --coordinator http://host:7420
  gatherlight workers --json";

/// List the workers of a coordinator
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct WorkersArgs {
    #[command(flatten)]
    connection: ConnectionArgs,
    /// Print the list as JSON on stdout
    #[arg(long, help_heading = "Messages")]
    json: bool,
}

pub(super) fn run(args: &WorkersArgs) -> CliResult {
    let workers = args.connection.run(|client| async move { Ok(client.workers().await?) })?;
    if args.json {
        print_json(&workers.iter().map(json::worker).collect());
    } else if workers.is_empty() {
        let url = &args.connection.coordinator;
        print_result(&format!("no workers; start some with: gatherlight-worker --coordinator {url}"));
    } else {
        let header = ["ID", "NAME", "STATE", "THREADS", "MEMORY", "LEASES", "COMPLETED", "HEARD", "JOINED"];
        print_result(&table(&header, &workers.iter().map(row).collect::<Vec<_>>()));
    }
    Ok(())
}

fn row(w: &WorkerInfo) -> Vec<String> {
    vec![
        w.id.to_string(),
        w.name.clone(),
        w.state.clone(),
        w.threads.to_string(),
        bytes(w.memory_bytes),
        w.leases.to_string(),
        w.completed.to_string(),
        format!("{} ago", duration(w.last_heard)),
        format!("{} ago", duration(w.joined)),
    ]
}

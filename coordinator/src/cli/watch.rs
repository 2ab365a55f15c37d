//! `gatherlight watch`: follows a job until it ends.

use super::connection::ConnectionArgs;
use super::error::{CliError, CliResult};
use super::format::duration;
use super::json;
use super::progress::{JobView, MessageArgs};
use crate::client::Client;
use crate::report::timeline::Timeline;
use crate::types::{JobId, JobProgress, JobState, Limits};
use clap::Args;
use tokio_stream::StreamExt;

const EXAMPLES: &str = "\
Ctrl-C stops watching; the job goes on.

Examples:
  gatherlight watch 00c0ffee00c0ffee --coordinator http://host:7420
  gatherlight watch 00c0ffee00c0ffee --json | jq .state";

/// Follow a job until it ends; exits with 1 when it fails or is cancelled
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct WatchArgs {
    /// The job, as `gatherlight jobs` lists it
    job: JobId,
    #[command(flatten)]
    connection: ConnectionArgs,
    #[command(flatten)]
    messages: MessageArgs,
}

pub(super) fn run(args: &WatchArgs) -> CliResult {
    let (last, _) = args.connection.run(|client| async move {
        tokio::select! {
            last = follow(&client, args.job, Limits::default(), args.messages) => last,
            () = interrupted() => {
                eprintln!("\njob {} goes on", args.job);
                Err(CliError::Interrupted)
            }
        }
    })?;
    let text = format!("{} {} after {}", last.id, last.state.name(), duration(last.elapsed));
    args.messages.print_end(json::job(&last), &text);
    outcome(&last)
}

/// Shows the progress of a job with these limits, as far as they are known, until it ends; its last snapshot and its course.
pub(super) async fn follow(
    client: &Client,
    job: JobId,
    limits: Limits,
    messages: MessageArgs,
) -> Result<(JobProgress, Timeline), CliError> {
    let mut snapshots = client.watch(job).await?;
    let (mut view, mut timeline) = (JobView::new(messages.style(), limits), Timeline::default());
    let mut last = None;
    while let Some(snapshot) = snapshots.next().await {
        let snapshot = snapshot?;
        timeline.record(&snapshot);
        view.update(&snapshot);
        last = Some(snapshot);
    }
    view.end();
    match last {
        Some(last) if last.state.is_final() => Ok((last, timeline)),
        _ => Err(CliError::Failed(format!("the coordinator at {} stopped reporting on {job}", client.url()))),
    }
}

/// Ready at Ctrl-C.
pub(super) async fn interrupted() {
    if tokio::signal::ctrl_c().await.is_err() {
        std::future::pending::<()>().await;
    }
}

/// Whether the job came to a good end.
pub(super) fn outcome(last: &JobProgress) -> CliResult {
    match &last.state {
        JobState::Done => Ok(()),
        JobState::Failed(reason) => Err(CliError::Failed(format!("job {} failed: {reason}", last.id))),
        other => Err(CliError::Failed(format!("job {} ended as {}", last.id, other.name()))),
    }
}

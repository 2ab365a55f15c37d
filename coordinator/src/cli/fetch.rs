//! `gatherlight fetch`: gets the image of a finished job.

use super::connection::ConnectionArgs;
use super::error::{CliError, CliResult};
use super::format::bytes;
use super::output::{Output, OutputArgs};
use super::progress::MessageArgs;
use super::{print_json, print_result};
use crate::client::Client;
use crate::types::JobId;
use clap::Args;
use serde_json::json;

const EXAMPLES: &str = "\
Examples:
  gatherlight fetch 00c0ffee00c0ffee -o image.exr --coordinator http://host:7420";

/// Fetch the image of a finished job
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct FetchArgs {
    /// The job, as `gatherlight jobs` lists it
    job: JobId,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    connection: ConnectionArgs,
    #[command(flatten)]
    messages: MessageArgs,
}

pub(super) fn run(args: &FetchArgs) -> CliResult {
    let output = args.output.check()?;
    let digest = args.connection.run(|client| fetch_to(client, args.job, &output))?;
    if args.messages.json {
        print_json(&json!({ "id": args.job.to_string(), "files": output.names(), "digest": digest }));
    } else {
        print_result(&output.names().join(", "));
    }
    Ok(())
}

/// Fetches the image of `job` and writes it; its digest.
pub(super) async fn fetch_to(client: Client, job: JobId, output: &Output) -> Result<String, CliError> {
    let image = client.fetch(job, |_, _| {}).await?;
    output.write(&image.exr).map_err(|e| {
        let size = bytes(image.exr.len() as u64);
        CliError::Failed(format!("{e} ({size}); the image is still there: gatherlight fetch {job} -o OUT.exr"))
    })?;
    Ok(image.digest)
}

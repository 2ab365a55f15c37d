//! `gatherlight health`: the standard health service, for container checks.

use super::connection::{ConnectionArgs, runtime};
use super::error::{CliError, CliResult};
use super::print_result;
use clap::Args;
use gatherlight_proto::connect::reason;
use std::time::Duration;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

/// Time an answer may take.
const PATIENCE: Duration = Duration::from_secs(5);

/// Ask whether a coordinator serves; needs no token
#[derive(Args, Debug)]
pub(super) struct HealthArgs {
    #[command(flatten)]
    connection: ConnectionArgs,
}

pub(super) fn run(args: &HealthArgs) -> CliResult {
    runtime()?.block_on(async {
        let endpoint = args.connection.endpoint()?.timeout(PATIENCE);
        let url = &args.connection.coordinator;
        let failed = |reason: String| CliError::Failed(format!("the coordinator at {url} is not healthy: {reason}"));
        let channel = endpoint.connect().await.map_err(|e| failed(reason(&e)))?;
        let reply = HealthClient::new(channel).check(HealthCheckRequest { service: String::new() }).await;
        match reply.map_err(|s| failed(s.message().to_owned()))?.into_inner().status() {
            ServingStatus::Serving => {
                print_result("serving");
                Ok(())
            }
            status => Err(failed(status.as_str_name().to_owned())),
        }
    })
}

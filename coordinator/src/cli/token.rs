//! `gatherlight token`: draws a token.

use super::error::{CliError, CliResult};
use super::print_result;
use crate::access::{Role, check_token_name};
use crate::random::random_bytes;
use clap::Args;

/// Random bytes of a token.
const TOKEN_BYTES: usize = 32;

const EXAMPLES: &str = "\
Without a name, the token allows everything, and the coordinator, its workers and its clients may share one file.
With a name, the line is one of the coordinator's token file; its owner gets that line, or the token alone.

Examples:
  gatherlight token > gatherlight.token
  gatherlight token alice --role client >> tokens
  gatherlight serve --listen 0.0.0.0:7420 --token-file tokens";

/// Draw a token by which workers and clients prove themselves
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct TokenArgs {
    /// Whom it belongs to; jobs belong to this name
    #[arg(value_name = "NAME", requires = "role")]
    name: Option<String>,
    /// What it allows: worker, client (its own jobs), admin (everyone's), with commas between them
    #[arg(long, value_name = "ROLES", requires = "name")]
    role: Option<String>,
}

pub(super) fn run(args: &TokenArgs) -> CliResult {
    let bytes: [u8; TOKEN_BYTES] = random_bytes();
    let token: String = bytes.iter().map(|b| format!("{b:02x}")).collect();
    match (&args.name, &args.role) {
        (Some(name), Some(roles)) => {
            check_token_name(name).map_err(CliError::Usage)?;
            Role::parse_list(roles).map_err(|e| CliError::Usage(format!("--role: {e}")))?;
            print_result(&format!("{name} {roles} {token}"));
        }
        _ => print_result(&token),
    }
    Ok(())
}

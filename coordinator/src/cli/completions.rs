//! `gatherlight completions`: scripts that complete options in a shell.

use super::error::CliResult;
use clap::{Args, CommandFactory};
use clap_complete::Shell;

const EXAMPLES: &str = "\
Examples:
  gatherlight completions bash > ~/.local/share/bash-completion/completions/gatherlight
  gatherlight completions zsh > ~/.zfunc/_gatherlight
  gatherlight completions fish > ~/.config/fish/completions/gatherlight.fish";

/// Print a completion script for a shell
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct CompletionsArgs {
    /// The shell
    shell: Shell,
}

pub(super) fn run(args: &CompletionsArgs) -> CliResult {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut super::Cli::command(), "gatherlight", &mut script);
    super::print_result(&String::from_utf8_lossy(&script));
    Ok(())
}

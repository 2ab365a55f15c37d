//! The command line `gatherlight`: one file a subcommand.
//!
//! Results go to stdout, progress, notes and errors to stderr. Exit codes: 0 done, 1 the work failed, 2 wrong usage,
//! 130 interrupted.

mod cancel;
mod compare;
mod completions;
mod connection;
mod converge;
mod error;
mod fetch;
pub(crate) mod format;
mod health;
mod jobs;
mod json;
mod limits;
mod options;
mod output;
mod plan;
mod preflight;
mod progress;
mod render;
mod scene;
mod serve;
mod settings;
mod stability;
mod submit;
mod token;
mod watch;
mod workers;

use clap::{Parser, Subcommand};
use gatherlight_telemetry::LogOptions;
use std::io::Write;
use std::process::ExitCode;

const EXAMPLES: &str = "\
Examples:
  gatherlight render scene.glb -o image.exr              render on this machine
  gatherlight render scene.glb -o image.png --samples 8  a quick look, with a preview
  gatherlight plan scene.glb                             what would be computed, and why
  gatherlight compare image.exr reference.exr            how far the image is from another
  gatherlight converge scene.glb --time 30s              error over time of all methods
  gatherlight serve                                      a coordinator for a cluster
  gatherlight submit scene.glb -o image.exr --coordinator http://host:7420

Exit codes: 0 done, 1 the work failed, 2 wrong usage, 130 interrupted.";

/// Renders glTF scenes by photon mapping and other light transport, on this machine or on a cluster
#[derive(Parser, Debug)]
#[command(name = "gatherlight", version, after_help = EXAMPLES, arg_required_else_help = true, max_term_width = 100)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
    /// What to log to stderr: error, warn, info, debug, or a filter like gatherlight=debug [default: warn; serve: info].
    /// `json` makes each message a JSON object on a line of its own, as in --log json or --log json,debug
    #[arg(
        long,
        global = true,
        value_name = "[json,]FILTER",
        env = "GATHERLIGHT_LOG",
        hide_env_values = true,
        help_heading = "Messages"
    )]
    log: Option<String>,
}

#[derive(Subcommand, Debug)]
enum Command {
    Render(render::RenderArgs),
    Plan(plan::PlanArgs),
    Compare(compare::CompareArgs),
    Converge(converge::ConvergeArgs),
    Serve(serve::ServeArgs),
    Submit(submit::SubmitArgs),
    Jobs(jobs::JobsArgs),
    Watch(watch::WatchArgs),
    Fetch(fetch::FetchArgs),
    Cancel(cancel::CancelArgs),
    Workers(workers::WorkersArgs),
    Health(health::HealthArgs),
    Token(token::TokenArgs),
    Stability(stability::StabilityArgs),
    Completions(completions::CompletionsArgs),
}

/// Reads the command line and does what it says.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let level = if matches!(cli.command, Command::Serve(_)) { "info" } else { "warn" };
    if let Err(error) = LogOptions::parse(cli.log.as_deref().unwrap_or_default(), level).init() {
        eprintln!("error: {error}");
        return ExitCode::from(2);
    }
    let result = match cli.command {
        Command::Render(args) => render::run(&args),
        Command::Plan(args) => plan::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Converge(args) => converge::run(&args),
        Command::Serve(args) => serve::run(&args),
        Command::Submit(args) => submit::run(&args),
        Command::Jobs(args) => jobs::run(&args),
        Command::Watch(args) => watch::run(&args),
        Command::Fetch(args) => fetch::run(&args),
        Command::Cancel(args) => cancel::run(&args),
        Command::Workers(args) => workers::run(&args),
        Command::Health(args) => health::run(&args),
        Command::Token(args) => token::run(&args),
        Command::Stability(args) => stability::run(&args),
        Command::Completions(args) => completions::run(&args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            if !matches!(error, error::CliError::Interrupted) {
                eprintln!("error: {error}");
            }
            ExitCode::from(error.exit_code())
        }
    }
}

/// Prints a result on stdout; a reader that has gone away is no error.
fn print_result(text: &str) {
    let _ = writeln!(std::io::stdout(), "{}", text.trim_end());
}

/// Prints a JSON result on stdout.
fn print_json(value: &serde_json::Value) {
    print_result(&serde_json::to_string_pretty(value).unwrap_or_default());
}

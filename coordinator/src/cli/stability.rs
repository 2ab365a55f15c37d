//! `gatherlight stability`: stiff and extreme scenes with known answers, on this machine.

use super::error::{CliError, CliResult};
use super::settings::choice;
use super::{print_json, print_result};
use crate::cli::format::duration;
use crate::stability::{Case, Effort, Outcome, Verdict, cases, run as run_case};
use clap::Args;
use gatherlight_render::settings::Method;
use serde_json::{Value, json};

const EXAMPLES: &str = "\
Each case is rendered by every method that applies, with one worker and with three, over several seeds. What is got must have \
the same bits from both, hold no sample that is not finite, and agree with what is expected within the interval that the spread \
over the seeds gives. docs/range.md says what follows.

Examples:
  gatherlight stability                                  all cases, all methods
  gatherlight stability --filter enclosure --method mlt
  gatherlight stability --list
  gatherlight stability --small                          as cargo test runs them";

/// Fewest seeds whose spread says anything.
const MIN_SEEDS: u32 = 4;
/// Most seeds: beyond them nothing new is seen.
const MAX_SEEDS: u32 = 4096;

/// Render stiff and extreme scenes and compare with their known answers
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct StabilityArgs {
    /// Only cases whose name contains this
    #[arg(long, value_name = "TEXT")]
    filter: Option<String>,
    /// Only this method
    #[arg(long, value_parser = choice(&Method::ALL, Method::name), value_name = "METHOD")]
    method: Option<Method>,
    /// Independent images of each case and method [default: 16; with --small: 6]
    #[arg(long, value_name = "N")]
    seeds: Option<u32>,
    /// As small as in the tests: wider intervals, and without the largest cases
    #[arg(long)]
    small: bool,
    /// Say what the cases are, and run none
    #[arg(long)]
    list: bool,
    /// Print the outcomes as JSON on stdout
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &StabilityArgs) -> CliResult {
    let effort = effort(args)?;
    let chosen: Vec<Case> = cases()
        .into_iter()
        .filter(|c| effort.large || !c.large)
        .filter(|c| args.filter.as_ref().is_none_or(|text| c.name.contains(text)))
        .collect();
    if chosen.is_empty() {
        let filter = args.filter.as_deref().unwrap_or_default();
        return Err(CliError::Usage(format!("--filter: no case has {filter:?} in its name; --list shows all")));
    }
    if args.list {
        list(&chosen, args);
        return Ok(());
    }
    let outcomes = run_all(&chosen, args, &effort);
    if args.json {
        print_json(&Value::Array(outcomes.iter().map(to_json).collect()));
    } else {
        print_result(&summary(&outcomes));
    }
    match outcomes.iter().filter(|o| matches!(o.verdict, Verdict::Wrong(_))).count() {
        0 => Ok(()),
        wrong => Err(CliError::Failed(format!("{wrong} of {} outcomes are wrong", outcomes.len()))),
    }
}

fn effort(args: &StabilityArgs) -> Result<Effort, CliError> {
    let base = if args.small { Effort::SMALL } else { Effort::FULL };
    let seeds = args.seeds.unwrap_or(base.seeds);
    if !(MIN_SEEDS..=MAX_SEEDS).contains(&seeds) {
        return Err(CliError::Usage(format!("--seeds: {seeds} is outside {MIN_SEEDS} … {MAX_SEEDS}")));
    }
    Ok(Effort { seeds, ..base })
}

fn methods(case: &Case, args: &StabilityArgs) -> impl Iterator<Item = Method> {
    Method::ALL.into_iter().filter(|&m| case.applies(m) && args.method.is_none_or(|only| only == m))
}

fn list(cases: &[Case], args: &StabilityArgs) {
    let describe = |c: &Case| {
        json!({
            "case": c.name,
            "what": c.what,
            "methods": methods(c, args).map(Method::name).collect::<Vec<_>>(),
            "not": c.leaves_out.iter().map(|(m, why)| format!("{}: {why}", m.name())).collect::<Vec<_>>(),
            "limits": c.limits.iter().map(|(m, why)| format!("{}: {why}", m.name())).collect::<Vec<_>>(),
        })
    };
    if args.json {
        return print_json(&Value::Array(cases.iter().map(describe).collect()));
    }
    for case in cases {
        let names: Vec<&str> = methods(case, args).map(Method::name).collect();
        print_result(&format!("{}: {} ({})", case.name, case.what, names.join(", ")));
        for (method, why) in &case.leaves_out {
            print_result(&format!("    not {}: {why}", method.name()));
        }
        for (method, why) in &case.limits {
            print_result(&format!("    limit of {}: {why}", method.name()));
        }
    }
}

/// Runs all, and prints each line of the table as it is known.
fn run_all(cases: &[Case], args: &StabilityArgs, effort: &Effort) -> Vec<Outcome> {
    if !args.json {
        let [case, method, expected, got, sigmas, time] = ["case", "method", "expected", "got", "error", "time"];
        print_result(&format!(
            "{case:<32} {method:<11} {expected:>10} {got:>10} {sigmas:>8} {time:>8}  finite  verdict"
        ));
    }
    let mut outcomes = Vec::new();
    for case in cases {
        for method in methods(case, args) {
            let outcome = run_case(case, method, effort);
            if !args.json {
                print_result(&line(&outcome));
            }
            outcomes.push(outcome);
        }
    }
    outcomes
}

fn line(o: &Outcome) -> String {
    let number = |v: Option<f64>| v.map_or("-".into(), |v| format!("{v:.4e}"));
    let sigmas = o.sigmas().map_or("-".into(), |s| format!("{s:+.1} σ"));
    let finite = if o.non_finite == 0 { "yes".into() } else { format!("{} no", o.non_finite) };
    let reason = o.verdict.reason().map_or(String::new(), |r| format!(": {r}"));
    format!(
        "{:<32} {:<11} {:>10} {:>10} {sigmas:>8} {:>8}  {finite:<6}  {}{reason}",
        o.case,
        o.method.name(),
        number(o.expected),
        number(o.got),
        duration(o.slowest),
        o.verdict.name(),
    )
}

fn summary(outcomes: &[Outcome]) -> String {
    let count = |name: &str| outcomes.iter().filter(|o| o.verdict.name() == name).count();
    let slowest = outcomes.iter().max_by_key(|o| o.slowest);
    let slowest = slowest.map_or(String::new(), |o| {
        format!("; the slowest image: {} by {}, {}", o.case, o.method.name(), duration(o.slowest))
    });
    format!("{} right, {} at a stated limit, {} wrong{slowest}", count("right"), count("limit"), count("WRONG"))
}

fn to_json(o: &Outcome) -> Value {
    json!({
        "case": o.case,
        "method": o.method.name(),
        "expected": o.expected,
        "got": o.got,
        "standard_error": o.standard_error,
        "error_in_standard_errors": o.sigmas(),
        "slowest_image_s": o.slowest.as_secs_f64(),
        "non_finite": o.non_finite,
        "verdict": o.verdict.name().to_lowercase(),
        "reason": o.verdict.reason(),
    })
}

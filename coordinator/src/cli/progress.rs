//! What a person sees while a job runs: one bar a phase with its rate and the time left, on stderr, and only on a
//! terminal unless asked for.

use super::format::{bytes, count, duration};
use super::{json, print_json, print_result};
use crate::types::{JobProgress, JobState, Limits};
use clap::Args;
use gatherlight_render::film::Noise;
use gatherlight_render::settings::ENDLESS;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// How much is said on stderr.
#[derive(Args, Clone, Copy, Debug)]
#[command(next_help_heading = "Messages")]
pub(super) struct MessageArgs {
    /// Say nothing but warnings and errors, as when stderr is not a terminal
    #[arg(short, long, conflicts_with = "verbose")]
    quiet: bool,
    /// Say what goes on even when stderr is not a terminal
    #[arg(short, long)]
    verbose: bool,
    /// Print results as JSON on stdout
    #[arg(long)]
    pub json: bool,
    /// How progress is shown; json: a line of JSON for each event on stdout, the result last
    #[arg(long, value_enum, default_value_t = Progress::Auto, value_name = "HOW")]
    progress: Progress,
}

/// How progress is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Progress {
    /// Bars on a terminal.
    Auto,
    /// Events for scripts.
    Json,
}

/// Where notes and progress go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Style {
    /// Nowhere.
    Quiet,
    /// One line when a phase ends.
    Lines,
    /// Moving bars.
    Bars,
    /// Lines of JSON on stdout.
    Json,
}

impl MessageArgs {
    /// What to show.
    pub(super) fn style(self) -> Style {
        if self.progress == Progress::Json {
            return Style::Json;
        }
        match (self.quiet, std::io::stderr().is_terminal(), self.verbose) {
            (true, _, _) | (_, false, false) => Style::Quiet,
            (_, true, _) => Style::Bars,
            (_, false, true) => Style::Lines,
        }
    }
    /// Prints a note on stderr unless quiet.
    pub(super) fn note(self, text: &str) {
        if !matches!(self.style(), Style::Quiet | Style::Json) {
            eprintln!("{text}");
        }
    }
    /// Prints how a job ended, for scripts or for people.
    pub(super) fn print_end(self, json: Value, text: &str) {
        if self.style() == Style::Json {
            print_result(&json!({ "event": "end", "result": json }).to_string());
        } else if self.json {
            print_json(&json);
        } else {
            print_result(text);
        }
    }
}

/// Prints a warning on stderr, always.
pub(super) fn warn(text: &str) {
    eprintln!("warning: {text}");
}

/// Shows snapshots of one job.
pub(super) struct JobView {
    style: Style,
    /// What may end the job before all is done.
    limits: Limits,
    /// The phase on show, its bar, and its last snapshot's figures.
    current: Option<(JobState, ProgressBar, Figures)>,
    /// What is on show is all rounds together.
    in_rounds: bool,
    /// When the last event was printed, and the state and rounds it told of.
    told: Option<(Instant, JobState, u32)>,
    /// What the job waits for, as it was last said.
    waits_for: String,
}

/// Least time between two events that tell of the same state and round.
const EVENT_INTERVAL: Duration = Duration::from_millis(250);

/// Name of the bar over all rounds.
const ROUNDS: &str = "rounds";

/// `round 3 of 64`, where there are several; `round 3` of a job that a limit is to end.
pub(super) fn round(p: &JobProgress) -> Option<String> {
    let going = p.rounds > 1 && !p.state.is_final() && p.state != JobState::Waiting;
    let of = if p.rounds < ENDLESS { format!(" of {}", p.rounds) } else { String::new() };
    going.then(|| format!("round {}{of}", u64::from(p.round) + 1))
}

/// The time until a limit ends the job, as far as can be told: noise falls with the root of the time.
fn left_until_limit(elapsed: Duration, noise: Option<Noise>, limits: Limits) -> Option<Duration> {
    let by_time = limits.time.map(|limit| limit.saturating_sub(elapsed));
    let by_error = limits.error.zip(noise).and_then(|(target, noise)| {
        let more = (noise.relative / f64::from(target)).powi(2) - 1.0;
        Duration::try_from_secs_f64(elapsed.as_secs_f64() * more.max(0.0)).ok()
    });
    by_time.into_iter().chain(by_error).min()
}

#[derive(Clone, Copy, Debug, Default)]
struct Figures {
    done: u64,
    total: u64,
    rate: f64,
    elapsed: Duration,
    /// Until a limit ends the job.
    left: Option<Duration>,
}

impl Figures {
    /// The time left at the rate so far, or until a limit.
    fn left(self) -> Option<Duration> {
        let rest = self.total.saturating_sub(self.done) as f64 / self.rate;
        let by_rate = if rest > 0.0 { Duration::try_from_secs_f64(rest).ok() } else { None };
        by_rate.into_iter().chain(self.left).min()
    }
    /// Moves `bar` to the share that is done, of the work or of the time.
    fn show_on(self, bar: &ProgressBar) {
        let (position, length) = match (self.left, self.left()) {
            (Some(limit), Some(left)) if limit == left => {
                (self.elapsed.as_millis() as u64, (self.elapsed + left).as_millis() as u64)
            }
            _ => (self.done, self.total),
        };
        bar.set_length(length.max(1));
        bar.set_position(position);
    }
}

impl JobView {
    /// A view that has seen nothing yet.
    pub(super) fn new(style: Style, limits: Limits) -> Self {
        JobView { style, limits, current: None, in_rounds: false, told: None, waits_for: String::new() }
    }

    /// Shows a snapshot.
    pub(super) fn update(&mut self, p: &JobProgress) {
        if self.style == Style::Quiet {
            return;
        }
        if self.style == Style::Json {
            return self.tell(p);
        }
        if p.waits_for != self.waits_for {
            self.waits_for.clone_from(&p.waits_for);
            if !p.waits_for.is_empty() {
                eprintln!("job {} waits: {}", p.id, p.waits_for);
            }
        }
        if p.rounds > 1 && !p.state.is_final() && p.state != JobState::Waiting && p.state != JobState::Assemble {
            return self.update_rounds(p);
        }
        if self.current.as_ref().is_none_or(|(state, ..)| *state != p.state) {
            let failed = matches!(p.state, JobState::Failed(_) | JobState::Cancelled);
            if let Some((_, _, figures)) = &mut self.current
                && !failed
                && p.stats.ended_by.is_none()
            {
                // The next phase has begun, so this one is complete, whatever the last snapshot of it said.
                figures.done = figures.total;
            }
            self.end_phase();
            if p.state.is_final() {
                return;
            }
            self.current = Some((p.state.clone(), new_bar(self.style, &phase_name(&p.state)), Figures::default()));
        }
        if let Some((state, bar, figures)) = &mut self.current {
            let makes_image = matches!(p.state, JobState::Gather | JobState::Splat);
            let left = left_until_limit(p.elapsed, p.stats.noise, self.limits).filter(|_| makes_image);
            *figures = Figures { done: p.done, total: p.total, rate: p.rate, elapsed: p.state_elapsed, left };
            figures.show_on(bar);
            bar.set_message(joined([running_text(Some(state), *figures, p.workers), noise_text(p)]));
        }
    }

    /// Prints a snapshot as an event, if it says something new.
    fn tell(&mut self, p: &JobProgress) {
        let now = Instant::now();
        let same = |t: &(Instant, JobState, u32)| {
            t.1 == p.state && t.2 == p.stats.rounds_done && now.duration_since(t.0) < EVENT_INTERVAL
        };
        if self.told.as_ref().is_some_and(same) {
            return;
        }
        self.told = Some((now, p.state.clone(), p.stats.rounds_done));
        print_result(&json!({ "event": "progress", "job": json::job(p) }).to_string());
    }

    /// Shows a snapshot of a job of many rounds: one bar for all of them.
    fn update_rounds(&mut self, p: &JobProgress) {
        if !self.in_rounds {
            self.end_phase();
            self.in_rounds = true;
            self.current = Some((p.state.clone(), new_bar(self.style, ROUNDS), Figures::default()));
        }
        let Some((_, bar, figures)) = &mut self.current else { return };
        let (done, total) = (u64::from(p.stats.rounds_done), u64::from(p.rounds));
        let seconds = p.elapsed.as_secs_f64();
        let rate = if done > 0 && seconds > 0.0 { done as f64 / seconds } else { 0.0 };
        let left = left_until_limit(p.elapsed, p.stats.noise, self.limits);
        *figures = Figures { done, total, rate, elapsed: p.elapsed, left };
        figures.show_on(bar);
        let now = format!("{}, {}", round(p).unwrap_or_default(), phase_name(&p.state));
        bar.set_message(joined([now, running_text(None, *figures, p.workers), noise_text(p)]));
    }

    /// Closes the bar on show; call when no more snapshots will come.
    pub(super) fn end(&mut self) {
        self.end_phase();
    }

    fn end_phase(&mut self) {
        let Some((state, bar, figures)) = self.current.take() else { return };
        bar.finish_and_clear();
        let in_rounds = std::mem::take(&mut self.in_rounds);
        if state != JobState::Waiting {
            eprintln!("{}", ended_text(Some(&state).filter(|_| !in_rounds), figures));
        }
    }
}

fn new_bar(style: Style, name: &str) -> ProgressBar {
    if style != Style::Bars {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(1);
    let template = "{prefix:<16} {bar:28} {percent:>3} %  {msg}";
    bar.set_style(ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.set_prefix(name.to_owned());
    bar
}

/// `emission caustic`, `gather` …
fn phase_name(state: &JobState) -> String {
    match state {
        JobState::Emission(map) | JobState::Merge(map) => format!("{} {}", state.name(), map.name()),
        other => other.name().into(),
    }
}

/// `state` is `None` for all rounds together.
fn units(state: Option<&JobState>, n: f64) -> String {
    match state {
        None => format!("{} rounds", count(n)),
        Some(JobState::Emission(_) | JobState::Bootstrap) => format!("{} paths", count(n)),
        Some(JobState::Merge(_)) => format!("{} photons", count(n)),
        Some(JobState::Broadcast) => bytes(n.max(0.0) as u64),
        Some(JobState::Splat) => format!("{} units", count(n)),
        Some(JobState::Gather) => format!("{} tiles", count(n)),
        Some(_) => count(n),
    }
}

fn running_text(state: Option<&JobState>, f: Figures, workers: u32) -> String {
    if state == Some(&JobState::Waiting) {
        return "no worker has begun".into();
    }
    let mut text = if f.rate > 0.0 { format!("{}/s", units(state, f.rate)) } else { String::new() };
    if let Some(left) = f.left() {
        text.push_str(&format!(", {} left", duration(left)));
    }
    if workers > 1 {
        text.push_str(&format!(", {workers} workers"));
    }
    text.trim_start_matches(", ").to_string()
}

/// The error so far, where it is known.
fn noise_text(p: &JobProgress) -> String {
    let noise = p.stats.noise.map(|n| format!("error {:.2} %", 100.0 * n.relative));
    let bias = p.stats.bias.map(|b| format!("bias {:.2} %", 100.0 * b.relative));
    [noise, bias].into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// The parts that say something.
fn joined<const N: usize>(parts: [String; N]) -> String {
    parts.into_iter().filter(|t| !t.is_empty()).collect::<Vec<_>>().join(", ")
}

fn ended_text(state: Option<&JobState>, f: Figures) -> String {
    let time = duration(f.elapsed);
    let what = if f.total > 0 { format!("{} in {time}", units(state, f.done as f64)) } else { time };
    let per_second = f.done as f64 / f.elapsed.as_secs_f64();
    let rate = if per_second.is_normal() { format!(" ({}/s)", units(state, per_second)) } else { String::new() };
    format!("{:<16} {what}{rate}", state.map_or_else(|| ROUNDS.into(), phase_name))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gatherlight_render::photon::MapKind;

    #[test]
    fn a_limit_tells_the_time_left() {
        let (elapsed, noise) = (Duration::from_secs(10), Some(Noise { standard_error: 0.1, relative: 0.04 }));
        let left =
            |time, error| left_until_limit(elapsed, noise, Limits { time, error }).map(|d| d.as_secs_f64().round());
        assert_eq!(left(None, None), None);
        assert_eq!(left(Some(Duration::from_secs(70)), None), Some(60.0));
        // Half the noise takes four times as long.
        assert_eq!(left(Some(Duration::from_secs(70)), Some(0.02)), Some(30.0));
        assert_eq!(left(Some(Duration::from_secs(70)), Some(0.01)), Some(60.0));
        assert_eq!(left(Some(Duration::from_secs(5)), Some(0.05)), Some(0.0));
    }

    #[test]
    fn a_phase_states_its_rate_and_the_time_left() {
        let state = JobState::Emission(MapKind::Caustic);
        let f =
            Figures { done: 250_000, total: 1_000_000, rate: 50_000.0, elapsed: Duration::from_secs(5), left: None };
        assert_eq!(running_text(Some(&state), f, 3), "50.0 k paths/s, 15.0 s left, 3 workers");
        assert_eq!(ended_text(Some(&state), f), "emission caustic 250 k paths in 5.00 s (50.0 k paths/s)");
        assert_eq!(running_text(Some(&JobState::Gather), Figures::default(), 1), "");
        let f = Figures { done: 3, total: 64, rate: 0.5, elapsed: Duration::from_secs(6), left: None };
        assert_eq!(running_text(None, f, 1), "0.50 rounds/s, 2 min 02 s left");
        assert_eq!(ended_text(None, f), "rounds           3 rounds in 6.00 s (0.50 rounds/s)");
        let limited = Figures { left: Some(Duration::from_secs(2)), ..f };
        assert_eq!(running_text(None, limited, 1), "0.50 rounds/s, 2.00 s left");
        let endless = Figures { rate: 1e-300, ..f };
        assert!(!running_text(Some(&state), endless, 1).contains("left"));
    }
}

//! What a person sees while a job runs: one bar a phase with its rate and the time left, on stderr, and only on a
//! terminal unless asked for.

use super::format::{bytes, count, duration};
use crate::types::{JobProgress, JobState};
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::time::Duration;

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
}

impl MessageArgs {
    /// What to show.
    pub(super) fn style(self) -> Style {
        match (self.quiet, std::io::stderr().is_terminal(), self.verbose) {
            (true, _, _) | (_, false, false) => Style::Quiet,
            (_, true, _) => Style::Bars,
            (_, false, true) => Style::Lines,
        }
    }
    /// Prints a note on stderr unless quiet.
    pub(super) fn note(self, text: &str) {
        if self.style() != Style::Quiet {
            eprintln!("{text}");
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
    /// The phase on show, its bar, and its last snapshot's figures.
    current: Option<(JobState, ProgressBar, Figures)>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Figures {
    done: u64,
    total: u64,
    rate: f64,
    elapsed: Duration,
}

impl JobView {
    /// A view that has seen nothing yet.
    pub(super) fn new(style: Style) -> Self {
        JobView { style, current: None }
    }

    /// Shows a snapshot.
    pub(super) fn update(&mut self, p: &JobProgress) {
        if self.style == Style::Quiet {
            return;
        }
        if self.current.as_ref().is_none_or(|(state, ..)| *state != p.state) {
            let failed = matches!(p.state, JobState::Failed(_) | JobState::Cancelled);
            if let Some((_, _, figures)) = &mut self.current
                && !failed
            {
                // The next phase has begun, so this one is complete, whatever the last snapshot of it said.
                figures.done = figures.total;
            }
            self.end_phase();
            if p.state.is_final() {
                return;
            }
            self.current = Some((p.state.clone(), new_bar(self.style, &p.state), Figures::default()));
        }
        if let Some((state, bar, figures)) = &mut self.current {
            *figures = Figures { done: p.done, total: p.total, rate: p.rate, elapsed: p.state_elapsed };
            bar.set_length(p.total.max(1));
            bar.set_position(p.done);
            bar.set_message(running_text(state, *figures, p.workers));
        }
    }

    /// Closes the bar on show; call when no more snapshots will come.
    pub(super) fn end(&mut self) {
        self.end_phase();
    }

    fn end_phase(&mut self) {
        let Some((state, bar, figures)) = self.current.take() else { return };
        bar.finish_and_clear();
        if state != JobState::Waiting {
            eprintln!("{}", ended_text(&state, figures));
        }
    }
}

fn new_bar(style: Style, state: &JobState) -> ProgressBar {
    if style != Style::Bars {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(1);
    let template = "{prefix:<16} {bar:28} {percent:>3} %  {msg}";
    bar.set_style(ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.set_prefix(phase_name(state));
    bar
}

/// `emission caustic`, `gather` …
fn phase_name(state: &JobState) -> String {
    match state {
        JobState::Emission(map) | JobState::Merge(map) => format!("{} {}", state.name(), map.name()),
        other => other.name().into(),
    }
}

fn units(state: &JobState, n: f64) -> String {
    match state {
        JobState::Emission(_) => format!("{} paths", count(n)),
        JobState::Merge(_) => format!("{} photons", count(n)),
        JobState::Broadcast => bytes(n.max(0.0) as u64),
        JobState::Gather => format!("{} tiles", count(n)),
        _ => count(n),
    }
}

fn running_text(state: &JobState, f: Figures, workers: u32) -> String {
    if *state == JobState::Waiting {
        return "no worker has begun".into();
    }
    let mut text = if f.rate > 0.0 { format!("{}/s", units(state, f.rate)) } else { String::new() };
    if f.rate > 0.0 && f.total > f.done {
        let left = (f.total - f.done) as f64 / f.rate;
        if let Ok(left) = Duration::try_from_secs_f64(left) {
            text.push_str(&format!(", {} left", duration(left)));
        }
    }
    if workers > 1 {
        text.push_str(&format!(", {workers} workers"));
    }
    text.trim_start_matches(", ").to_string()
}

fn ended_text(state: &JobState, f: Figures) -> String {
    let time = duration(f.elapsed);
    let what = if f.total > 0 { format!("{} in {time}", units(state, f.done as f64)) } else { time };
    let per_second = f.done as f64 / f.elapsed.as_secs_f64();
    let rate = if per_second.is_normal() { format!(" ({}/s)", units(state, per_second)) } else { String::new() };
    format!("{:<16} {what}{rate}", phase_name(state))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gatherlight_render::photon::MapKind;

    #[test]
    fn a_phase_states_its_rate_and_the_time_left() {
        let state = JobState::Emission(MapKind::Caustic);
        let f = Figures { done: 250_000, total: 1_000_000, rate: 50_000.0, elapsed: Duration::from_secs(5) };
        assert_eq!(running_text(&state, f, 3), "50.0 k paths/s, 15.0 s left, 3 workers");
        assert_eq!(ended_text(&state, f), "emission caustic 250 k paths in 5.00 s (50.0 k paths/s)");
        assert_eq!(running_text(&JobState::Gather, Figures::default(), 1), "");
        let endless = Figures { rate: 1e-300, ..f };
        assert!(!running_text(&state, endless, 1).contains("left"));
    }
}

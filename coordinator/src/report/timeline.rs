//! What a job did while it ran, read off its snapshots: error against time, and the time of each phase.

use crate::types::{JobProgress, JobState};
use serde_json::{Value, json};
use std::time::Duration;

/// The error at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorPoint {
    /// Wall time since the submission.
    pub elapsed: Duration,
    /// Compute time of all workers.
    pub busy: Duration,
    /// Rounds in the image.
    pub rounds: u32,
    /// Standard error, in radiance.
    pub standard_error: f64,
    /// The same relative to each pixel, see [`Noise`](gatherlight_render::film::Noise).
    pub relative: f64,
    /// Bias relative to each pixel, where it is known.
    pub relative_bias: Option<f64>,
}

/// Wall time that a job spent in one state, over all rounds.
#[derive(Clone, Debug, PartialEq)]
pub struct PhaseTime {
    /// What it did: `emission global`, `gather`, ….
    pub name: String,
    /// Wall time.
    pub time: Duration,
}

/// The course of one job.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Timeline {
    /// Error against time, in order of time; empty where no error is known.
    pub errors: Vec<ErrorPoint>,
    /// In the order in which they were first seen.
    pub phases: Vec<PhaseTime>,
    /// Most workers that were computing at once.
    pub workers: u32,
    last: Option<(String, Duration)>,
}

impl Timeline {
    /// Takes in a snapshot; they have to come in order.
    pub fn record(&mut self, p: &JobProgress) {
        let name = state_name(&p.state);
        if let Some((before, since)) = self.last.take() {
            let time = p.elapsed.saturating_sub(since);
            match self.phases.iter_mut().find(|phase| phase.name == before) {
                Some(phase) => phase.time += time,
                None => self.phases.push(PhaseTime { name: before, time }),
            }
        }
        if !p.state.is_final() {
            self.last = Some((name, p.elapsed));
        }
        self.workers = self.workers.max(p.workers);
        let rounds = p.stats.rounds_done;
        if let Some(noise) = p.stats.noise
            && self.errors.last().is_none_or(|e| e.standard_error != noise.standard_error)
        {
            let (standard_error, relative) = (noise.standard_error, noise.relative);
            let (elapsed, busy) = (p.elapsed, p.stats.busy);
            let relative_bias = p.stats.bias.map(|b| b.relative);
            self.errors.push(ErrorPoint { elapsed, busy, rounds, standard_error, relative, relative_bias });
        }
    }

    /// Slope of log error over log time by least squares, with wall time or with compute time; `None` for fewer than three
    /// moments. Independent samples give −1/2.
    pub fn slope(&self, time: impl Fn(&ErrorPoint) -> Duration) -> Option<f64> {
        logarithmic_slope(self.errors.iter().map(|e| [time(e).as_secs_f64(), e.relative]))
    }

    /// For scripts; units are the last part of a name.
    pub fn json(&self) -> Value {
        let errors: Vec<Value> = self
            .errors
            .iter()
            .map(|e| {
                json!({
                    "elapsed_s": e.elapsed.as_secs_f64(),
                    "busy_s": e.busy.as_secs_f64(),
                    "rounds": e.rounds,
                    "standard_error": e.standard_error,
                    "relative_standard_error": Some(e.relative).filter(|r| r.is_finite()),
                    "relative_bias": e.relative_bias,
                })
            })
            .collect();
        let phases: Vec<Value> =
            self.phases.iter().map(|p| json!({ "phase": p.name, "time_s": p.time.as_secs_f64() })).collect();
        json!({
            "error": errors,
            "slope_over_elapsed": self.slope(|e| e.elapsed),
            "slope_over_busy": self.slope(|e| e.busy),
            "phases": phases,
            "workers_most": self.workers,
        })
    }
}

/// Slope of log y over log x by least squares, over the points whose logarithms are finite; `None` for fewer than three.
pub fn logarithmic_slope(points: impl Iterator<Item = [f64; 2]>) -> Option<f64> {
    let points: Vec<[f64; 2]> = points.map(|p| p.map(f64::ln)).filter(|p| p.iter().all(|v| v.is_finite())).collect();
    let n = points.len() as f64;
    let mean = |i: usize| points.iter().map(|p| p[i]).sum::<f64>() / n;
    let (x, y) = (mean(0), mean(1));
    let (xy, xx) = points.iter().fold((0.0, 0.0), |(xy, xx), p| {
        let dx = p[0] - x;
        (xy + dx * (p[1] - y), xx + dx * dx)
    });
    (points.len() >= 3 && xx > 0.0).then(|| xy / xx)
}

fn state_name(state: &JobState) -> String {
    match state {
        JobState::Emission(map) | JobState::Merge(map) => format!("{} {}", state.name(), map.name()),
        _ => state.name().to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::{JobId, JobStats};
    use gatherlight_render::film::Noise;

    fn snapshot(state: JobState, seconds: u64, noise: Option<f64>) -> JobProgress {
        let noise = noise.map(|relative| Noise { standard_error: relative, relative });
        let stats = JobStats { noise, busy: Duration::from_secs(2 * seconds), ..JobStats::default() };
        JobProgress {
            owner: String::new(),
            id: JobId(1),
            name: String::new(),
            state,
            round: 0,
            rounds: 1,
            done: 0,
            total: 0,
            rate: 0.0,
            state_elapsed: Duration::ZERO,
            elapsed: Duration::from_secs(seconds),
            workers: 3,
            stats,
            result_digest: None,
            priority: 0,
            waits_for: String::new(),
        }
    }

    #[test]
    fn errors_are_noted_when_they_change_and_their_slope_is_fitted() {
        let mut t = Timeline::default();
        // Falls as the root of time.
        for seconds in [1u64, 4, 4, 16, 64] {
            t.record(&snapshot(JobState::Gather, seconds, Some(1.0 / (seconds as f64).sqrt())));
        }
        assert_eq!(t.errors.len(), 4);
        for slope in [t.slope(|e| e.elapsed), t.slope(|e| e.busy)] {
            assert!(slope.is_some_and(|s| (s + 0.5).abs() < 1e-12), "{slope:?}");
        }
        t.errors.truncate(2);
        assert_eq!(t.slope(|e| e.elapsed), None);
    }

    #[test]
    fn time_goes_to_the_state_that_was_seen_last() {
        let mut t = Timeline::default();
        t.record(&snapshot(JobState::Waiting, 0, None));
        t.record(&snapshot(JobState::Gather, 2, None));
        t.record(&snapshot(JobState::Assemble, 7, None));
        t.record(&snapshot(JobState::Gather, 8, None));
        t.record(&snapshot(JobState::Done, 9, None));
        let times: Vec<(&str, u64)> = t.phases.iter().map(|p| (p.name.as_str(), p.time.as_secs())).collect();
        assert_eq!(times, [("waiting", 2), ("gather", 6), ("assemble", 1)]);
        assert_eq!((t.workers, t.errors.len()), (3, 0));
    }
}

//! Runs a case by one method and judges what comes out.

use super::settings::settings;
use super::{Answer, Case, Effort};
use crate::embedded::{self, Config, RenderError};
use gatherlight_render::film::Film;
use gatherlight_render::import::SceneBundle;
use gatherlight_render::job::PreparedJob;
use gatherlight_render::settings::{Method, RenderSettings};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// What a case gave with one method.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Name of the case.
    pub case: String,
    /// The method.
    pub method: Method,
    /// Mean radiance that is expected, where the answer is a number.
    pub expected: Option<f64>,
    /// Mean radiance that came out, over all seeds.
    pub got: Option<f64>,
    /// Standard error of what came out, from the spread over seeds.
    pub standard_error: Option<f64>,
    /// How far off it may be besides: the width of the pixel, rounding, the blur of photon maps.
    pub slack: f64,
    /// Samples and splats that were not finite and left out, over all images.
    pub non_finite: u64,
    /// Wall time of the slowest image by one worker.
    pub slowest: Duration,
    /// Whether it is right.
    pub verdict: Verdict,
}

/// Whether what came out is right.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// It is.
    Right,
    /// It is not, in a way that docs/range.md states: what is wrong, and why.
    Limit(String),
    /// It is not: what is wrong.
    Wrong(String),
}

impl Verdict {
    /// One word.
    pub fn name(&self) -> &'static str {
        match self {
            Verdict::Right => "right",
            Verdict::Limit(_) => "limit",
            Verdict::Wrong(_) => "WRONG",
        }
    }
    /// What is wrong.
    pub fn reason(&self) -> Option<&str> {
        match self {
            Verdict::Right => None,
            Verdict::Limit(why) | Verdict::Wrong(why) => Some(why),
        }
    }
}

impl Outcome {
    /// How many standard errors lie between what came out and what is expected, beyond the slack.
    pub fn sigmas(&self) -> Option<f64> {
        let error = self.got? - self.expected?;
        let sigma = self.standard_error.filter(|s| *s > 0.0)?;
        Some((error.abs() - self.slack).max(0.0).copysign(error) / sigma)
    }
}

/// One image and what was counted.
struct Image {
    film: Film,
    non_finite: u64,
    warnings: Vec<String>,
    time: Duration,
}

/// Why there is no image.
struct Refused(String);

/// Renders `case` by `method`, with one worker for each seed and with three for the first, and judges the images.
pub fn run(case: &Case, method: Method, effort: &Effort) -> Outcome {
    let mut outcome = Outcome {
        case: case.name.clone(),
        method,
        expected: None,
        got: None,
        standard_error: None,
        slack: 0.0,
        non_finite: 0,
        slowest: Duration::ZERO,
        verdict: Verdict::Right,
    };
    if let Err(wrong) = judge(case, method, effort, &mut outcome) {
        outcome.verdict = match case.limit(method) {
            Some(why) => Verdict::Limit(format!("{wrong}; {why}")),
            None => Verdict::Wrong(wrong),
        };
    }
    outcome
}

fn judge(case: &Case, method: Method, effort: &Effort, outcome: &mut Outcome) -> Result<(), String> {
    let first = match image(&case.scene, &settings(case, method, effort, 0), 1) {
        Ok(image) => image,
        Err(Refused(message)) => {
            return match case.answer {
                Answer::Refused(text) if message.contains(text) => Ok(()),
                _ => Err(message),
            };
        }
    };
    outcome.slowest = first.time;
    outcome.non_finite = first.non_finite;
    let by_three = image(&case.scene, &settings(case, method, effort, 0), 3).map_err(|Refused(e)| e)?;
    if !same_bits(&first.film, &by_three.film, 1.0) {
        return Err("three workers give other bits than one".into());
    }
    if let Some(text) = case.warning.filter(|text| !first.warnings.iter().any(|w| w.contains(text))) {
        return Err(format!("no warning says {text:?}"));
    }
    let result = match &case.answer {
        Answer::Refused(text) => Err(format!("it was rendered, not refused with {text:?}")),
        Answer::Black => {
            let largest = colors(&first.film).fold(0.0, |m: f64, v| m.max(v.abs()));
            (outcome.expected, outcome.got) = (Some(0.0), Some(largest));
            if largest == 0.0 { Ok(()) } else { Err(format!("a pixel is {largest}, not 0")) }
        }
        Answer::SameBits { of, scale, factor } => {
            let other = Case { scene: of.clone(), scale: *scale, ..case.clone() };
            let other = image(&other.scene, &settings(&other, method, effort, 0), 1).map_err(|Refused(e)| e)?;
            let expected = mean(&other.film) * f64::from(*factor);
            (outcome.expected, outcome.got) = (Some(expected), Some(mean(&first.film)));
            if expected == 0.0 {
                Err("the image is black: nothing can be told from it".into())
            } else if same_bits(&other.film, &first.film, *factor) {
                Ok(())
            } else {
                Err("other bits".into())
            }
        }
        Answer::Mean { radiance, slack, blur } => {
            let reads = matches!(method, Method::Photon | Method::Progressive | Method::Vcm);
            let slack = slack + if reads { *blur } else { 0.0 };
            means(case, method, effort, first.film, outcome)?;
            by_spread(*radiance, slack, effort, outcome)
        }
    };
    if outcome.non_finite > 0 {
        return Err(format!("{} samples were not finite", outcome.non_finite));
    }
    result
}

/// Renders the remaining seeds: mean and standard error.
fn means(case: &Case, method: Method, effort: &Effort, first: Film, outcome: &mut Outcome) -> Result<(), String> {
    let mut values = vec![mean(&first)];
    for seed in 1..u64::from(effort.seeds) {
        let next = image(&case.scene, &settings(case, method, effort, seed), 1).map_err(|Refused(e)| e)?;
        outcome.non_finite += next.non_finite;
        outcome.slowest = outcome.slowest.max(next.time);
        values.push(mean(&next.film));
    }
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let square = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / (n - 1.0).max(1.0);
    (outcome.got, outcome.standard_error) = (Some(mean), Some((square / n).sqrt()));
    Ok(())
}

/// Compares with `radiance` by the spread over the seeds.
fn by_spread(radiance: f64, slack: f64, effort: &Effort, outcome: &mut Outcome) -> Result<(), String> {
    (outcome.expected, outcome.slack) = (Some(radiance), slack * radiance);
    let (got, sigma) = (outcome.got.unwrap_or(f64::NAN), outcome.standard_error.unwrap_or(f64::NAN));
    let interval = student(effort.seeds) * sigma;
    let error = (got - radiance).abs();
    if error > interval + slack * radiance || !error.is_finite() || !interval.is_finite() {
        let percent = 100.0 * (got / radiance - 1.0);
        return Err(format!("{got:.6e} ± {sigma:.1e} instead of {radiance:.6e} ({percent:+.3} %)"));
    }
    if interval > effort.resolution * radiance {
        let share = 100.0 * interval / radiance;
        return Err(format!("too noisy to tell: the interval is ±{share:.0} %"));
    }
    Ok(())
}

/// Two-sided quantile of Student's distribution with `seeds` − 1 degrees of freedom, passed by chance once in 10,000.
fn student(seeds: u32) -> f64 {
    match seeds {
        0..4 => f64::INFINITY,
        4 => 28.0,
        5 => 15.5,
        6 => 11.2,
        7 => 9.1,
        8 => 7.9,
        9..12 => 7.2,
        12..16 => 6.0,
        16..24 => 5.3,
        24..64 => 4.7,
        _ => 4.2,
    }
}

/// Renders by an embedded coordinator with `workers` workers of one thread.
fn image(bundle: &SceneBundle, settings: &RenderSettings, workers: usize) -> Result<Image, Refused> {
    let refused = |e: RenderError| Refused(e.to_string());
    let started = Instant::now();
    let job = Arc::new(PreparedJob::prepare(bundle, settings).map_err(|e| Refused(e.to_string()))?);
    let warnings = job.warnings().to_vec();
    let config = Config { threads: 1, workers, ..Config::default() };
    let result = embedded::render_prepared(bundle, job, &config, |_| ()).map_err(refused)?;
    let (film, non_finite) = (result.film, result.stats.non_finite.total());
    Ok(Image { film, non_finite, warnings, time: started.elapsed() })
}

/// Whether `b` is `a` times `factor`, bit for bit in its colours and exactly in its alpha.
fn same_bits(a: &Film, b: &Film, factor: f32) -> bool {
    let n = a.channels.len();
    let pairs = a.pixels.iter().zip(&b.pixels).enumerate();
    let scaled = |i: usize, v: f32| if i % n < 3 { v * factor } else { v };
    a.pixels.len() == b.pixels.len() && { pairs }.all(|(i, (&a, b))| scaled(i, a).to_bits() == b.to_bits())
}

fn colors(film: &Film) -> impl Iterator<Item = f64> {
    let n = film.channels.len();
    film.pixels.chunks_exact(n).flat_map(|p| &p[..3]).map(|v| f64::from(*v))
}

/// Mean over pixels and channels.
fn mean(film: &Film) -> f64 {
    let count = 3 * film.pixels.len() / film.channels.len();
    colors(film).sum::<f64>() / count as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(got: f64, standard_error: f64) -> Outcome {
        Outcome {
            case: String::new(),
            method: Method::Path,
            expected: None,
            got: Some(got),
            standard_error: Some(standard_error),
            slack: 0.0,
            non_finite: 0,
            slowest: Duration::ZERO,
            verdict: Verdict::Right,
        }
    }

    #[test]
    fn what_is_off_noisy_or_not_a_number_is_not_right() {
        let effort = Effort { seeds: 16, ..Effort::FULL };
        let judged = |got, sigma| by_spread(1.0, 1e-3, &effort, &mut outcome(got, sigma));
        assert_eq!(judged(1.04, 0.01), Ok(()));
        assert!(judged(1.07, 0.01).unwrap_err().contains("instead of"));
        assert!(judged(1.0, 0.1).unwrap_err().contains("too noisy"));
        assert!(judged(f64::NAN, 0.01).is_err() && judged(1.0, f64::NAN).is_err());
        assert!(judged(1.002, 0.0).is_err() && judged(1.0005, 0.0).is_ok());
    }

    #[test]
    fn fewer_seeds_make_wider_intervals() {
        assert!((4..100).all(|n| student(n) >= student(n + 1)));
        assert_eq!(student(3), f64::INFINITY);
    }
}

//! Error against time of several methods on one scene: each is given the same time, its image is looked at after every round.

use crate::report::timeline::logarithmic_slope;
use gatherlight_render::film::Accumulator;
use gatherlight_render::film::compare::compare;
use gatherlight_render::import::SceneBundle;
use gatherlight_render::job::{JobError, PreparedJob};
use gatherlight_render::local;
use gatherlight_render::math::Rgb;
use gatherlight_render::settings::{Method, RenderSettings};
use std::time::{Duration, Instant};

/// Parts (samples, rounds, chains) of the run that measures how fast a method is.
const PILOT_PARTS: u32 = 8;
/// Most parts that a run is cut to.
const MAX_PARTS: u32 = 1 << 16;

/// An image at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// Wall time spent computing, without looking.
    pub elapsed: Duration,
    /// Samples a pixel, rounds or chains in the image.
    pub parts: u64,
    /// Relative standard error that it states, where it is known.
    pub noise: Option<f64>,
    /// Relative bias that it states, where it is known.
    pub bias: Option<f64>,
    /// relMSE against the reference, where there is one.
    pub relative_mse: Option<f64>,
    /// The difference from the reference in the measure of `noise` and `bias`: [`gatherlight_render::film::compare::Comparison::relative_error`].
    pub error: Option<f64>,
}

/// The course of one method.
#[derive(Clone, Debug)]
pub struct Course {
    /// The method.
    pub method: Method,
    /// In order of time, one for each round.
    pub points: Vec<Point>,
    /// The image at the end.
    pub image: Vec<Rgb>,
}

impl Course {
    /// Slope of log relMSE over log time by least squares; `None` for fewer than three points.
    pub fn slope(&self) -> Option<f64> {
        logarithmic_slope(self.points.iter().filter_map(|p| Some([p.elapsed.as_secs_f64(), p.relative_mse?])))
    }
    /// Its last point.
    pub fn last(&self) -> Option<&Point> {
        self.points.last()
    }
}

/// `settings` with so many samples, rounds or chains; what is emitted and mutated in each of them stays as it is.
pub fn with_parts(settings: &RenderSettings, parts: u32) -> RenderSettings {
    let mut s = settings.clone();
    let scaled = |total: u64, old: u32| (u128::from(total) * u128::from(parts) / u128::from(old.max(1))) as u64;
    match s.method {
        Method::Mlt => {
            // As many mutations in each chain.
            s.mutations = (scaled(s.mutations.into(), s.chains) as u32).max(1);
            s.chains = parts;
        }
        m if m.has_rounds() => {
            s.photons = scaled(s.photons, s.rounds);
            s.caustic_photons = scaled(s.caustic_photons, s.rounds);
            s.rounds = parts;
        }
        _ => s.samples = parts,
    }
    s
}

/// Runs the method of `settings` for about `time` on the current rayon pool, with as many parts as a short run says fit into it, and
/// compares its image with `reference` after every round.
///
/// # Errors
/// When the scene or a setting makes no sense.
pub fn course(
    bundle: &SceneBundle,
    settings: &RenderSettings,
    time: Duration,
    reference: Option<&[Rgb]>,
) -> Result<Course, JobError> {
    let pilot = run(bundle, &with_parts(settings, settings.parts().min(PILOT_PARTS)), time, None)?;
    // The first round comes with the maps or the bootstrap of methods that make them once.
    let parts = match (pilot.points.first(), pilot.last()) {
        (Some(first), Some(last)) if last.parts > first.parts => {
            let seconds = last.elapsed.saturating_sub(first.elapsed).as_secs_f64();
            let rate = (last.parts - first.parts) as f64 / seconds.max(1e-6);
            let rest = time.saturating_sub(first.elapsed).as_secs_f64();
            rate * rest
        }
        _ => 0.0,
    };
    let parts = parts.clamp(f64::from(PILOT_PARTS), f64::from(MAX_PARTS)) as u32;
    run(bundle, &with_parts(settings, parts), time, reference)
}

fn run(
    bundle: &SceneBundle,
    settings: &RenderSettings,
    time: Duration,
    reference: Option<&[Rgb]>,
) -> Result<Course, JobError> {
    let job = PreparedJob::prepare(bundle, settings)?;
    let (width, height) = (settings.width as usize, settings.height as usize);
    let (mut points, mut spent, mut begun) = (Vec::new(), Duration::ZERO, Instant::now());
    let done = local::run(&job, |film: &Accumulator| {
        spent += begun.elapsed();
        let real = reference.and_then(|reference| {
            let pixels = film.clone().finish().rgb();
            compare((width, height, &pixels), (width, height, reference)).ok()
        });
        let (noise, bias) = (film.noise().map(|n| n.relative), film.bias().map(|b| b.relative));
        let (relative_mse, error) = (real.as_ref().map(|c| c.relative_mse), real.map(|c| c.relative_error));
        points.push(Point { elapsed: spent, parts: film.samples(), noise, bias, relative_mse, error });
        begun = Instant::now();
        spent < time
    });
    Ok(Course { method: settings.method, points, image: done.film.finish().rgb() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_parts_are_more_of_the_same() {
        let s = RenderSettings { rounds: 10, photons: 1_000, ..RenderSettings::for_method(Method::Progressive) };
        let more = with_parts(&s, 30);
        assert_eq!((more.rounds, more.photons), (30, 3_000));
        let s = RenderSettings { chains: 100, mutations: 10, ..RenderSettings::for_method(Method::Mlt) };
        let more = with_parts(&s, 50);
        assert_eq!((more.chains, more.mutations), (50, 5));
        assert_eq!(with_parts(&RenderSettings::for_method(Method::Path), 7).samples, 7);
    }

    #[test]
    fn a_slope_needs_three_points() {
        let point = |t: u64| Point {
            elapsed: Duration::from_secs(t),
            parts: t,
            noise: None,
            bias: None,
            relative_mse: Some(2.0 / t as f64),
            error: None,
        };
        let mut course = Course { method: Method::Path, points: [1, 4, 9].map(point).to_vec(), image: Vec::new() };
        assert!(course.slope().is_some_and(|s| (s + 1.0).abs() < 1e-12));
        course.points.truncate(2);
        assert_eq!(course.slope(), None);
    }
}

//! The image has the same bits for any number of workers and threads, any order of tasks, and whoever is lost on the
//! way: for every method.

use gatherlight::embedded::{Config, RenderError, render};
use gatherlight::types::{JobResult, Limit, Limits};
use gatherlight_render::import::SceneBundle;
use gatherlight_render::job::{Phase, PreparedJob};
use gatherlight_render::settings::{Layer, Merge, Method, RenderSettings, Setting};
use gatherlight_tests::cluster::small_leases;
use gatherlight_tests::{film_sha256, scene, single};
use gatherlight_worker::Faults;
use std::sync::LazyLock;
use std::time::Duration;

static RING: LazyLock<SceneBundle> = LazyLock::new(|| scene("caustic-ring.glb"));

/// One method as it is tested.
struct Case {
    settings: RenderSettings,
    phases: Vec<Phase>,
    /// What one process computes, straight through the phases.
    reference: String,
}

impl Case {
    fn new(settings: RenderSettings) -> Self {
        let job = PreparedJob::prepare(&RING, &settings).unwrap_or_else(|e| panic!("{e}"));
        let film = single::render(&job);
        assert!(film.pixels.iter().any(|&v| v > 0.0), "{}: the image is black", settings.method.name());
        Case { phases: job.phases(), reference: film_sha256(&film), settings }
    }
    fn name(&self) -> String {
        let how = if self.settings.adaptive { "adaptive" } else { self.settings.merge.name() };
        format!("{} {how}", self.settings.method.name())
    }
    fn render(&self, workers: usize, threads: usize, change: impl FnOnce(&mut Config)) -> JobResult {
        let mut config = Config { workers, threads, policy: small_leases(), ..Config::default() };
        change(&mut config);
        render(&RING, &self.settings, &config, |_| {}).unwrap_or_else(|e| panic!("{}: {e}", self.name()))
    }
    fn assert_same_bits(&self, result: &JobResult) {
        assert_eq!(film_sha256(&result.film), self.reference, "{}", self.name());
    }
    fn has(&self, kind: impl Fn(&Phase) -> bool) -> bool {
        self.phases.iter().any(kind)
    }
    /// Workers that die at some task of each phase there is.
    fn deaths(&self) -> Vec<Faults> {
        let none = Faults::default;
        let mut deaths = Vec::new();
        if self.has(|p| matches!(p, Phase::Emission { .. })) {
            deaths.extend([0, 3].map(|n| Faults { die_at_emission: Some(n), ..none() }));
        }
        if self.has(|p| matches!(p, Phase::Bootstrap { .. })) {
            deaths.push(Faults { die_at_bootstrap: Some(0), ..none() });
        }
        if self.has(|p| matches!(p, Phase::Splat { .. })) {
            deaths.push(Faults { die_at_splat: Some(0), ..none() });
        }
        if self.has(|p| matches!(p, Phase::Gather { .. })) {
            deaths.extend([0, 2].map(|n| Faults { die_at_gather: Some(n), ..none() }));
        }
        deaths
    }
}

/// A job of one round cannot end early, and says so.
#[test]
fn limits_of_a_job_of_one_round_are_refused() {
    let settings = RenderSettings { method: Method::Path, samples: 1, ..CASES[0].settings.clone() };
    let (time, error) = (Some(Duration::from_millis(1)), Some(0.1));
    for limits in [Limits { time, error: None }, Limits { time: None, error }] {
        let refused = render(&RING, &settings, &Config { limits, ..Config::default() }, |_| {});
        let Err(RenderError::Refused(text)) = refused else { panic!("{limits:?} was not refused") };
        assert!(text.contains("path"), "{text}");
    }
}

/// Every method, small, and where it has rounds with both ways to merge them, and where it can with samples that go where the error is.
static CASES: LazyLock<Vec<Case>> = LazyLock::new(|| {
    let settings = |method| RenderSettings {
        method,
        width: 72,
        height: 56,
        samples: 5,
        photons: 20_000,
        caustic_photons: 30_000,
        k: 20,
        rounds: 7,
        chains: 24,
        mutations: 2,
        bootstrap: 4_000,
        layers: if method == Method::Photon { vec![Layer::Direct, Layer::Caustic, Layer::Variance] } else { vec![] },
        ..RenderSettings::default()
    };
    let merges = |method: Method| if method.has_rounds() { &Merge::ALL[..] } else { &Merge::ALL[..1] };
    let all = Method::ALL.iter().flat_map(|&m| merges(m).iter().map(move |&merge| (m, merge)));
    let all = all.map(|(method, merge)| RenderSettings { merge, ..settings(method) });
    let adaptive = Setting::Adaptive.methods().map(|method| RenderSettings {
        adaptive: true,
        samples: 16,
        final_gather: 1,
        layers: vec![Layer::Variance, Layer::Samples, Layer::StandardError],
        ..settings(method)
    });
    all.chain(adaptive).map(Case::new).collect()
});

#[test]
fn workers_and_threads_do_not_matter() {
    for case in &*CASES {
        for (workers, threads) in [(1, 1), (1, 2), (2, 1), (2, 2), (7, 1)] {
            let result = case.render(workers, threads, |_| {});
            case.assert_same_bits(&result);
            assert_eq!(result.stats.retried_leases, 0, "{}: {workers} workers", case.name());
        }
    }
}

/// Leases as large as they come, and rounds after the first sized by what was measured.
#[test]
fn the_size_of_leases_does_not_matter() {
    for case in &*CASES {
        case.assert_same_bits(&case.render(2, 1, |c| c.policy = Config::default().policy));
    }
}

#[test]
fn the_order_of_tasks_does_not_matter() {
    for case in &*CASES {
        for seed in 0..3 {
            case.assert_same_bits(&case.render(2, 1, |c| c.policy.shuffle = Some(seed)));
        }
    }
}

#[test]
fn a_worker_lost_in_each_phase_does_not_matter() {
    let (mut struck, mut all) = (0, 0);
    for case in &*CASES {
        for fault in case.deaths() {
            // The others are held back a little, so that the one that dies gets its turn.
            let slow = Faults { delay: Duration::from_millis(2), ..Faults::default() };
            let result = case.render(3, 1, |c| c.faults = vec![fault.clone(), slow.clone(), slow]);
            case.assert_same_bits(&result);
            // Of a few independent rounds the others may have taken all before it had joined.
            let had_work = result.stats.workers == 3;
            assert!(result.stats.retried_leases > 0 || !had_work, "{}: {fault:?} did not strike", case.name());
            (struck, all) = (struck + u32::from(result.stats.retried_leases > 0), all + 1);
        }
    }
    assert!(2 * struck > all, "only {struck} of {all} struck");
}

#[test]
fn results_delivered_twice_or_damaged_do_not_matter() {
    for case in &*CASES {
        let twice = Faults { deliver_twice: true, ..Faults::default() };
        case.assert_same_bits(&case.render(2, 1, |c| c.faults = vec![twice.clone(), twice]));
        let corrupt = Faults { corrupt: true, ..Faults::default() };
        let slow = Faults { delay: Duration::from_millis(2), ..Faults::default() };
        let result = case.render(2, 1, |c| c.faults = vec![corrupt, slow]);
        case.assert_same_bits(&result);
        assert!(result.stats.retried_leases > 0, "{}", case.name());
    }
}

#[test]
fn all_rounds_and_units_are_counted() {
    for case in &*CASES {
        let result = case.render(2, 1, |_| {});
        let count = |kind: &dyn Fn(&Phase) -> u64| case.phases.iter().map(kind).sum::<u64>();
        let images = count(&|p| u64::from(p.makes_image()));
        let units = count(&|p| if matches!(p, Phase::Splat { .. }) { p.units() } else { 0 });
        let paths = count(&|p| if matches!(p, Phase::Emission { .. }) { p.units() } else { 0 });
        let stats = &result.stats;
        assert_eq!((u64::from(stats.rounds_done), stats.units_done, stats.ended_by), (images, units, None));
        assert_eq!(stats.maps.iter().map(|m| m.emitted_count).sum::<u64>(), paths, "{}", case.name());
        assert_eq!(stats.maps.iter().map(|m| m.emitted_total).sum::<u64>(), paths, "{}", case.name());
        assert_eq!(result.metadata.units, (units > 0).then_some(units), "{}", case.name());
        assert!(stats.rays > 0, "{}", case.name());
    }
}

/// The least error that is met after some rounds ends the job there, whoever computes it; the image is the mean of these
/// rounds and says so.
#[test]
fn an_error_limit_ends_a_job_after_the_same_round_everywhere() {
    for case in &*CASES {
        let limited = |error| Limits { time: None, error: Some(error) };
        let whole = case.render(1, 1, |_| {});
        let noise = whole.stats.noise.expect("rounds to compare");
        assert!(noise.relative > 0.0 && whole.metadata.noise == Some(noise), "{}: {noise:?}", case.name());
        let ended = [(1, 2), (3, 1)].map(|(w, t)| case.render(w, t, |c| c.limits = limited(1e6)));
        for result in &ended {
            // The least number that an error is trusted after; of chains, that with a mutation for each pixel, and where there is blur,
            // that with four blocks.
            let method = case.settings.method;
            let rounds = if method == Method::Mlt || method.has_rounds() { 6 } else { 4 };
            assert_eq!(
                (result.stats.rounds_done, result.stats.ended_by),
                (rounds, Some(Limit::Error)),
                "{}",
                case.name()
            );
            assert!(result.stats.noise.is_some_and(|n| n.relative <= 1e6));
        }
        assert_eq!(film_sha256(&ended[0].film), film_sha256(&ended[1].film), "{}", case.name());
        let unreachable = case.render(2, 1, |c| c.limits = limited(1e-6));
        assert_eq!(unreachable.stats.ended_by, None);
        case.assert_same_bits(&unreachable);
    }
}

/// While a job runs, its error is not told after every round; in the end it is that of all of them.
#[test]
fn the_error_that_is_stated_is_that_of_the_whole_image() {
    let base =
        RenderSettings { method: Method::Progressive, rounds: 37, width: 24, height: 24, ..RenderSettings::default() };
    let settings = RenderSettings { photons: 37_000, caustic_photons: 37_000, ..base };
    let case = Case::new(settings.clone());
    let job = PreparedJob::prepare(&RING, &settings).unwrap_or_else(|e| panic!("{e}"));
    let film = single::accumulate(&job);
    let result = case.render(1, 1, |_| {});
    assert!(film.noise().is_some() && film.bias().is_some());
    assert_eq!((result.stats.noise, result.stats.bias), (film.noise(), film.bias()));
    assert_eq!((result.metadata.noise, result.metadata.bias), (film.noise(), film.bias()));
}

#[test]
fn a_time_limit_gives_the_mean_of_the_rounds_that_are_done() {
    for case in &*CASES {
        let limits = Limits { time: Some(Duration::from_millis(1)), error: None };
        let has_splat = case.has(|p| matches!(p, Phase::Splat { .. }));
        let cut_off = case.render(1, 1, |c| c.limits = limits);
        let stats = &cut_off.stats;
        assert_eq!(stats.ended_by, Some(Limit::Time), "{}", case.name());
        // Of the colour: the standard error of a single round is infinite.
        let mean = |r: &JobResult| r.film.rgb().iter().map(|p| f64::from(p.max_component())).sum::<f64>();
        // The first round of several, whoever computes it; nothing of the second is counted.
        let metadata = &cut_off.metadata;
        let said = match (has_splat, case.settings.method.has_rounds()) {
            (true, _) => metadata.units.map(|u| u as u32),
            (false, true) => metadata.rounds,
            (false, false) => metadata.samples,
        };
        assert_eq!((stats.rounds_done, said), (1, Some(1)), "{}", case.name());
        let first = case.phases.iter().filter(|p| matches!(p, Phase::Emission { .. }) && p.round() == 0);
        let emitted: u64 = cut_off.metadata.maps.iter().map(|m| m.emitted_count).sum();
        assert_eq!(emitted, first.map(Phase::units).sum::<u64>(), "{}", case.name());
        let again = case.render(3, 1, |c| c.limits = limits);
        assert_eq!(film_sha256(&cut_off.film), film_sha256(&again.film), "{}", case.name());
        // Five times darker if it were divided by all rounds.
        let whole = mean(&case.render(1, 2, |_| {}));
        assert!((mean(&cut_off) / whole - 1.0).abs() < 0.5, "{}: {} of {whole}", case.name(), mean(&cut_off));
    }
}

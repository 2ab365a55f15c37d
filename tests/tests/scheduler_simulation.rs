//! The scheduler under a virtual cluster and clock: workers of different speed that crash, come back, stall, fail, and a
//! network that loses, delays, repeats and reorders. Every job ends, and every index counts exactly once.
//!
//! One run is one seed. To replay seed 1234: `SIMULATION_SEED=1234 cargo test --test scheduler_simulation -- --nocapture`.

use gatherlight_tests::simulation::{Conditions, Report, simulate};

/// Runs of each kind of weather.
const SEEDS: u64 = 300;

fn seeds() -> std::ops::Range<u64> {
    match std::env::var("SIMULATION_SEED").ok().and_then(|s| s.parse().ok()) {
        Some(seed) => seed..seed + 1,
        None => 0..SEEDS,
    }
}

fn all(conditions: impl Fn(u64) -> Conditions) -> Vec<Report> {
    seeds().map(|seed| simulate(seed, &conditions(seed))).collect()
}

#[test]
fn in_fair_weather_nothing_is_done_twice() {
    for report in all(|seed| Conditions { workers: 1 + seed as usize % 40, ..Conditions::fair() }) {
        assert_eq!((report.retried, report.discarded), (0, 0), "seed {}", report.seed);
    }
}

#[test]
fn under_loss_delay_duplication_and_reordering_every_index_counts_once() {
    let reports = all(|seed| Conditions { workers: 2 + seed as usize % 20, ..Conditions::stormy() });
    // The weather has to have been bad: else this shows nothing.
    if reports.len() > 1 {
        assert!(reports.iter().map(|r| r.crashes).sum::<u64>() > SEEDS);
        assert!(reports.iter().map(|r| r.discarded).sum::<u64>() > SEEDS);
        assert!(reports.iter().map(|r| r.retried).sum::<u64>() > SEEDS);
    }
}

/// 1 to 1,000 workers, evenly in the logarithm.
fn crowd(seed: u64) -> usize {
    1_000_f64.powf((seed * 7_919 % 1_000) as f64 / 999.0).round() as usize
}

#[test]
fn from_one_to_a_thousand_workers_every_index_counts_once_in_any_weather() {
    let reports = all(|seed| {
        let workers = crowd(seed);
        // Some leases for each, and not many more.
        let (paths, tiles) = (100_000 + 20_000 * workers as u64, 50 + 4 * workers as u32);
        Conditions { workers, paths, tiles, jobs: 1 + seed as usize % 2, ..Conditions::stormy() }
    });
    if reports.len() > 1 {
        for decade in [1..10, 10..100, 100..1_001] {
            let of: Vec<&Report> = reports.iter().filter(|r| decade.contains(&crowd(r.seed))).collect();
            let mean = |f: &dyn Fn(&Report) -> f64| of.iter().map(|r| f(r)).sum::<f64>() / of.len() as f64;
            println!(
                "{decade:?} workers, {} runs: idle {:.2}, results {:.1} MB, maps {:.1} MB, {:.1} leases again, {:.1} discarded",
                of.len(),
                mean(&|r| r.idle_fraction),
                mean(&|r| r.result_bytes as f64 * 1e-6),
                mean(&|r| r.broadcast_bytes as f64 * 1e-6),
                mean(&|r| r.retried as f64),
                mean(&|r| r.discarded as f64)
            );
            assert!(of.len() > 50 && of.iter().all(|r| r.result_bytes > 0));
        }
        assert!(reports.iter().map(|r| r.crashes).sum::<u64>() > SEEDS);
    }
}

#[test]
fn workers_that_fail_everything_are_set_aside_and_the_others_finish() {
    all(|seed| Conditions { workers: 6, broken_workers: 1 + seed as usize % 2, ..Conditions::fair() });
}

#[test]
fn with_only_broken_workers_every_job_fails_with_a_reason() {
    for seed in seeds() {
        let conditions = Conditions { workers: 4, broken_workers: 4, may_fail: true, ..Conditions::fair() };
        let report = simulate(seed, &conditions);
        assert_eq!(report.failed, report.jobs, "seed {seed}");
    }
}

#[test]
fn a_thousand_workers_keep_busy() {
    let conditions = Conditions { workers: 1_000, paths: 1_000_000_000, tiles: 130_000, jobs: 1, ..Conditions::fair() };
    let report = simulate(1, &conditions);
    assert_eq!(report.retried, 0);
    // Half a minute of work, of which 7 % is idle: speeds differ by a factor of 16, workers join over two seconds, and each
    // of the three phases ends with shrinking leases and a build.
    assert!(report.idle_fraction < 0.2, "idle {:.3}, {:?}", report.idle_fraction, report);
}

/// Short rounds, so that there are many in little virtual time.
fn in_rounds(weather: Conditions) -> Conditions {
    Conditions { rounds: 24, paths: 60_000, tiles: 24, jobs: 3, ..weather }
}

#[test]
fn rounds_chains_and_their_bootstraps_count_every_index_once_in_any_weather() {
    let mut reports = all(|seed| Conditions { workers: 1 + seed as usize % 40, ..in_rounds(Conditions::fair()) });
    assert!(reports.iter().all(|r| (r.retried, r.discarded) == (0, 0)), "{reports:?}");
    reports.extend(all(|seed| Conditions { workers: 2 + seed as usize % 20, ..in_rounds(Conditions::stormy()) }));
    // Two rounds of two maps and their tiles.
    assert!(reports.iter().all(|r| r.widest_window <= 6 && r.cut_off == 0), "{reports:?}");
    if reports.len() > 2 {
        assert!(reports.iter().map(|r| r.rounds).sum::<u64>() > 10 * SEEDS);
        assert!(reports.iter().map(|r| r.retried).sum::<u64>() > SEEDS);
    }
}

#[test]
fn a_time_limit_ends_jobs_with_whole_rounds_and_units_in_any_weather() {
    let reports = all(|seed| Conditions {
        workers: 2 + seed as usize % 5,
        time_limit: Some(1_000_000 + seed * 100_000),
        ..in_rounds(Conditions::stormy())
    });
    if reports.len() > 1 {
        let (jobs, cut_off) = (reports.iter().map(|r| r.jobs).sum::<usize>(), reports.iter().map(|r| r.cut_off).sum());
        assert!((jobs / 10..jobs).contains(&cut_off), "{cut_off} of {jobs} jobs were ended by their limit");
    }
}

#[test]
fn images_that_are_good_enough_end_their_jobs_with_whole_rounds_in_any_weather() {
    let reports = all(|seed| Conditions {
        workers: 2 + seed as usize % 5,
        good_after: Some(1 + seed as u32 % 9),
        ..in_rounds(Conditions::stormy())
    });
    if reports.len() > 1 {
        let (jobs, cut_off) = (reports.iter().map(|r| r.jobs).sum::<usize>(), reports.iter().map(|r| r.cut_off).sum());
        assert!((jobs / 10..jobs).contains(&cut_off), "{cut_off} of {jobs} jobs were ended by their error");
    }
}

#[test]
fn a_thousand_workers_keep_busy_over_rounds() {
    let conditions =
        Conditions { workers: 1_000, paths: 100_000_000, tiles: 30_000, rounds: 12, jobs: 1, ..Conditions::fair() };
    // Seeds of jobs with several rounds of both maps.
    let mut reports = (0..).map(|seed| simulate(seed, &conditions));
    let report = reports.find(|r| r.rounds >= 8 && r.widest_window > 4).unwrap_or_default();
    assert_eq!(report.retried, 0);
    assert!(report.idle_fraction < 0.25, "idle {:.3}, {report:?}", report.idle_fraction);
}

/// An 8K image in passes that all read the same maps: at most two passes are under way, and closing one hides behind the next.
#[test]
fn a_thousand_workers_keep_busy_over_passes() {
    let conditions =
        Conditions { workers: 1_000, paths: 100_000_000, tiles: 130_000, rounds: 12, jobs: 1, ..Conditions::fair() };
    let mut reports = (0..).map(|seed| simulate(seed, &conditions));
    let report = reports.find(|r| r.rounds >= 8 && r.widest_window == 4).unwrap_or_default();
    assert_eq!(report.retried, 0);
    assert!(report.idle_fraction < 0.25, "idle {:.3}, {report:?}", report.idle_fraction);
}

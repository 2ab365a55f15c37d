//! How large leases are, and when to give up.

use core::time::Duration;
use gatherlight_render::job::Phase;

/// The scheduler's constants. They change how long a job takes, never its image.
#[derive(Clone, Debug, PartialEq)]
pub struct Policy {
    /// Computing time a lease should take: long against the cost of handing it out, short against the loss of it.
    pub target_lease: Duration,
    /// Leases a worker holds at once, so that it computes one while another travels.
    pub leases_per_worker: usize,
    /// Photon paths of the first lease to a worker whose rate is unknown.
    pub probe_paths: u64,
    /// Fewest photon paths of a lease.
    pub min_paths: u64,
    /// Most photon paths of a lease.
    pub max_paths: u64,
    /// Most tiles of a lease.
    pub max_tiles: u64,
    /// Stored photons a lease should give at most, by what the job's leases gave so far: each takes some 90 bytes on its way
    /// into the merge, here and at the worker together.
    pub max_lease_photons: u64,
    /// Silence after which a worker is taken for dead: several heartbeats.
    pub dead_after: Duration,
    /// Silence after which nobody is made to wait for what a worker passes on.
    pub quiet_after: Duration,
    /// Shortest time a lease is given; doubled with every attempt.
    pub min_deadline: Duration,
    /// The same for units of a splat phase while the worker's rate is unknown: one may be a whole round.
    pub min_splat_deadline: Duration,
    /// Slowest broadcast a worker is given time for, bytes per second.
    pub least_bandwidth: f64,
    /// A lease's time as a multiple of what it should take.
    pub deadline_factor: f64,
    /// Failures of one task, on different workers where there are others, after which its job fails.
    pub max_failures: usize,
    /// Losses of one task (worker dead or too late) after which its job fails: it may be what kills them.
    pub max_losses: u32,
    /// Tasks of one job a worker may fail before it gets no more of that job.
    pub set_aside_after: usize,
    /// Time that other workers get to turn up, before a task goes back to a worker that failed it, and before a job fails
    /// because every worker that is there was set aside.
    pub patience: Duration,
    /// Age at which a lease is worth repeating on a worker that has nothing else to do.
    pub twin_after: Duration,
    /// For tests: hand out indices in an order drawn from this seed.
    pub shuffle: Option<u64>,
}

impl Default for Policy {
    fn default() -> Self {
        Policy {
            target_lease: Duration::from_secs(1),
            leases_per_worker: 2,
            probe_paths: 8_192,
            min_paths: 1_024,
            max_paths: 1 << 22,
            max_tiles: 1_024,
            max_lease_photons: 1 << 19,
            dead_after: Duration::from_secs(10),
            quiet_after: Duration::from_millis(2_500),
            min_deadline: Duration::from_secs(120),
            min_splat_deadline: Duration::from_secs(1_800),
            least_bandwidth: 4e6,
            deadline_factor: 20.0,
            max_failures: 3,
            max_losses: 10,
            set_aside_after: 3,
            patience: Duration::from_secs(10),
            twin_after: Duration::from_secs(2),
            shuffle: None,
        }
    }
}

/// What is known when a lease is cut.
#[derive(Clone, Copy, Debug)]
pub struct Situation {
    /// Threads of the worker.
    pub threads: u32,
    /// Units per second it does of this phase, where known.
    pub rate: Option<f64>,
    /// Its share of the speed of all workers that could take part, in (0, 1].
    pub share: f64,
    /// Units of the phase not handed out yet.
    pub remaining: u64,
    /// Stored photons per unit so far; 0 while unknown.
    pub stored_per_unit: f64,
}

impl Policy {
    /// Number of units of the next lease, ≥ 1: about [`Policy::target_lease`] of work, and near the end of a phase half
    /// of the worker's share of what is left, so that all end together. A worker that has no others to wait for gets the rest.
    pub fn lease_units(&self, phase: Phase, s: Situation) -> u64 {
        let (probe, min, max) = match phase {
            Phase::Emission { .. } => (self.probe_paths, self.min_paths, self.max_paths),
            Phase::Bootstrap { .. } | Phase::SampleMap { .. } => (self.probe_paths, self.min_paths, self.max_paths),
            // A tile or a unit of a splat phase runs on one thread: fewer than threads leave some idle.
            Phase::Gather { .. } | Phase::Splat { .. } => (u64::from(s.threads), 1, self.max_tiles),
        };
        let wanted = s.rate.map_or(probe, |r| (r * self.target_lease.as_secs_f64()) as u64);
        // 1 for a worker alone, 2 from two equal ones on.
        let parts = 1.0 + (2.0 * (1.0 - s.share)).min(1.0);
        let tail = (s.remaining as f64 * s.share / parts).ceil() as u64;
        let photons = match s.stored_per_unit {
            x if x > 0.0 => (self.max_lease_photons as f64 / x) as u64,
            _ => max,
        };
        let units = wanted.clamp(min, max.max(min)).min(tail.max(min)).min(photons.max(1));
        // No crumbs: a rest smaller than the smallest lease goes along.
        if s.remaining.saturating_sub(units) < min { s.remaining.max(1) } else { units }
    }
    /// Time given to a lease of `units` of `phase` on its `attempt`-th attempt.
    pub fn lease_time(&self, phase: Phase, units: u64, rate: Option<f64>, attempt: u32) -> Duration {
        let expected = rate.filter(|&r| r > 0.0).map_or(0.0, |r| units as f64 / r * self.deadline_factor);
        let min = match (phase, rate) {
            (Phase::Splat { .. }, None) => self.min_splat_deadline.max(self.min_deadline),
            _ => self.min_deadline,
        };
        let base = expected.clamp(min.as_secs_f64(), min.as_secs_f64() * 64.0);
        Duration::from_secs_f64(base * f64::from(1u32 << attempt.saturating_sub(1).min(6)))
    }
    /// Time for `bytes` that a worker reads to reach it: on its first lease that reads them it waits for them.
    pub fn broadcast_time(&self, bytes: u64) -> Duration {
        Duration::from_secs_f64(bytes as f64 / self.least_bandwidth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gatherlight_render::photon::MapKind;

    const EMISSION: Phase = Phase::Emission { round: 0, map: MapKind::Global, paths: 1 << 30 };
    const GATHER: Phase = Phase::Gather { round: 0, tiles: 1 << 20 };

    fn situation() -> Situation {
        Situation { threads: 4, rate: None, share: 0.5, remaining: 1 << 20, stored_per_unit: 0.0 }
    }

    #[test]
    fn a_new_worker_is_probed_with_little_work() {
        let p = Policy::default();
        assert_eq!(p.lease_units(EMISSION, situation()), p.probe_paths);
        assert_eq!(p.lease_units(GATHER, situation()), 4);
    }

    #[test]
    fn a_lease_is_about_a_second_of_work_within_bounds() {
        let p = Policy::default();
        let with = |rate| p.lease_units(EMISSION, Situation { rate: Some(rate), remaining: 1 << 40, ..situation() });
        assert_eq!(with(200_000.0), 200_000);
        assert_eq!(with(0.001), p.min_paths);
        assert_eq!(with(1e18), p.max_paths);
    }

    #[test]
    fn leases_shrink_towards_the_end_and_leave_no_crumbs() {
        let p = Policy::default();
        let with = |remaining| p.lease_units(GATHER, Situation { rate: Some(100.0), remaining, ..situation() });
        assert_eq!(with(400), 100);
        assert_eq!(with(100), 25);
        assert_eq!(with(2), 1);
        assert_eq!(with(1), 1);
        let paths = p.lease_units(EMISSION, Situation { remaining: p.min_paths + 5, ..situation() });
        assert_eq!(paths, p.min_paths + 5);
    }

    #[test]
    fn a_worker_alone_gets_a_phase_whole() {
        let p = Policy::default();
        let s = Situation { rate: Some(1e6), remaining: 64, ..situation() };
        assert_eq!(p.lease_units(GATHER, Situation { share: 1.0, ..s }), 64);
        assert_eq!(p.lease_units(EMISSION, Situation { share: 1.0, remaining: 24_576, ..s }), 24_576);
        // Of many workers, none takes what would keep the others busy.
        assert_eq!(p.lease_units(GATHER, Situation { share: 0.5, ..s }), 16);
        assert_eq!(p.lease_units(GATHER, Situation { share: 0.75, ..s }), 32);
    }

    #[test]
    fn a_lease_gives_no_more_photons_than_one_result_should_have() {
        let p = Policy::default();
        let s = Situation { rate: Some(1e9), remaining: 1 << 40, stored_per_unit: 1e4, ..situation() };
        assert_eq!(p.lease_units(EMISSION, s), p.max_lease_photons / 10_000);
    }

    #[test]
    fn deadlines_grow_with_attempts() {
        let p = Policy::default();
        assert_eq!(p.broadcast_time(4_000_000_000), Duration::from_secs(1_000));
        assert_eq!(p.lease_time(GATHER, 10, None, 1), p.min_deadline);
        assert_eq!(p.lease_time(GATHER, 10, None, 3), p.min_deadline * 4);
        assert_eq!(p.lease_time(GATHER, 100, Some(10.0), 1), Duration::from_secs(200));
    }

    #[test]
    fn units_of_a_splat_phase_are_heavy_and_bootstrap_paths_light() {
        let p = Policy::default();
        let splat = Phase::Splat { round: 0, units: 1 << 20 };
        assert_eq!(p.lease_units(splat, situation()), 4);
        assert_eq!(p.lease_units(splat, Situation { rate: Some(0.01), ..situation() }), 1);
        assert_eq!(p.lease_units(Phase::Bootstrap { paths: 1 << 20 }, situation()), p.probe_paths);
        // A unit may take long, so nobody is given up before its first one is done; then its rate is known.
        assert_eq!(p.lease_time(splat, 4, None, 1), p.min_splat_deadline);
        assert_eq!(p.lease_time(splat, 4, Some(1.0), 1), p.min_deadline);
    }
}

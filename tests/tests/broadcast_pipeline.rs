//! The plan of the broadcast under a virtual network: how near to the bound it comes, and what a loss costs.

use gatherlight_tests::pipeline::{Death, Link, bound, broadcast, estimate};

const GIGABIT: Link = Link { bytes_per_second: 125e6, latency: 200e-6 };
/// Photons of a map of 190 MB, and one of 2 GB.
const SIZES: [u64; 2] = [190 << 20, 2 << 30];
const WORKERS: [usize; 8] = [1, 2, 8, 16, 64, 256, 512, 1_000];

#[test]
fn up_to_a_thousand_workers_have_a_map_within_a_quarter_of_the_bound() {
    for mbit in [100.0, 1_000.0, 10_000.0] {
        let link = Link { bytes_per_second: mbit * 125e3, ..GIGABIT };
        for (workers, bytes) in WORKERS.iter().flat_map(|&w| SIZES.map(|b| (w, b))) {
            if workers > 64 && bytes > SIZES[0] {
                // Nearer to the bound, and long to simulate.
                continue;
            }
            let outcome = broadcast(workers, bytes, link, &[], 3.0);
            let ratio = outcome.seconds / bound(workers, bytes, link);
            println!("{workers} workers, {} MiB, {mbit} Mbit/s: {ratio:.3} of the bound", bytes >> 20);
            let estimated = estimate(workers, bytes, link) / outcome.seconds;
            assert!((0.95..1.1).contains(&estimated), "{workers} workers, {bytes} bytes, {mbit} Mbit/s: {estimated}");
            assert!((1.0..1.25).contains(&ratio), "{workers} workers, {bytes} bytes, {mbit} Mbit/s: {ratio}");
        }
    }
}

#[test]
fn the_coordinator_sends_one_copy_and_no_worker_sends_more() {
    for workers in WORKERS {
        let outcome = broadcast(workers, SIZES[0], GIGABIT, &[], 3.0);
        assert_eq!(outcome.coordinator_bytes, SIZES[0] as f64, "{workers} workers");
        assert!(outcome.most_bytes <= SIZES[0] as f64 * 1.01, "{workers} workers: {outcome:?}");
    }
}

#[test]
fn whoever_dies_is_routed_around_at_the_cost_of_its_silence() {
    let (bytes, silence) = (SIZES[0], 3.0);
    for workers in [2, 8, 64, 1_000] {
        let whole = bound(workers, bytes, GIGABIT);
        for place in [0, 1, workers / 2, workers - 1] {
            let death = Death { place, at: whole * 0.4 };
            let outcome = broadcast(workers, bytes, GIGABIT, &[death], silence);
            // What was missed is caught up with two streams more on one link.
            assert!(outcome.seconds <= silence + 2.5 * whole, "{workers} workers without {place}: {outcome:?}");
            assert!(outcome.coordinator_bytes <= 2.5 * bytes as f64, "{workers} workers without {place}: {outcome:?}");
        }
    }
}

#[test]
fn many_losses_leave_nobody_without() {
    for workers in [3, 8, 65, 1_000] {
        // Every third, one after the other.
        let deaths: Vec<Death> =
            (0..workers).step_by(3).map(|place| Death { place, at: 0.1 + 1e-3 * place as f64 }).collect();
        let outcome = broadcast(workers, SIZES[0], GIGABIT, &deaths, 0.5);
        let copies = outcome.coordinator_bytes / SIZES[0] as f64;
        println!("{workers} workers, a third lost: {:.2} s, {copies:.2} copies", outcome.seconds);
        assert!(copies < 6.0, "{workers} workers: {outcome:?}");
    }
}

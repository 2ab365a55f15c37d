//! Jobs of many rounds, of bootstrap and splat phases, and with limits.

use super::*;
use gatherlight_proto::message::BlobRef;
use gatherlight_proto::types::{Limit, Limits};

const BOOTSTRAP: BlobRef = BlobRef { digest: Digest([4; 32]), bytes: 24 };
const LIMIT: Limits = Limits { time: Some(Duration::from_secs(60)), error: None };

fn rounds(count: u32, paths: u64, tiles: u32) -> Vec<Phase> {
    let emission = |round| Phase::Emission { round, map: MapKind::Global, paths };
    (0..count).flat_map(|round| [emission(round), Phase::Gather { round, tiles }]).collect()
}
fn submit(policy: Policy, phases: Vec<Phase>, limits: Limits) -> Bench {
    let mut bench = Bench::new(policy);
    let terms = Box::new(Terms { limits, ..Terms::default() });
    assert_eq!(bench.event(Event::Submitted { job: JOB, phases, terms }), []);
    bench
}
fn map(round: u32) -> MapRef {
    MapRef { digest: Digest([round as u8; 32]), ..GLOBAL }
}
fn give(worker: WorkerId, id: u64, range: EmissionRange, task: Task) -> Command {
    Command::Assign { worker, lease: lease(id, 1, range, task) }
}
fn emission(round: u32) -> Task {
    Task::Emission { round, map: MapKind::Global }
}
fn tiles(round: u32) -> Task {
    Task::Gather { round, maps: vec![map(round)], sample_map: None }
}
fn splat(round: u32) -> Task {
    Task::Splat { round, bootstrap: Some(BOOTSTRAP) }
}
/// A round is closed: that it is to be, and that it has been.
fn close(round: u32, tiles: u32) -> Command {
    Command::Build { job: JOB, phase: Phase::Gather { round, tiles } }
}
fn closed(round: u32) -> Event {
    Event::Closed { job: JOB, round, is_good_enough: false }
}
fn retire(round: u32) -> Command {
    Command::Retire { job: JOB, round }
}
fn assemble(rounds: u32, units: u64, ended_by: Option<Limit>) -> Command {
    Command::Assemble { job: JOB, done: Done { rounds, units, ended_by } }
}

#[test]
fn the_photons_of_a_round_are_traced_while_the_tiles_of_the_one_before_are_finished() {
    let mut b = submit(policy(), rounds(3, 10, 2), Limits::default());
    assert_eq!(b.join(A)[1..], [give(A, 1, range(0, 10), emission(0))]);
    // While round 0's map is built, nothing but round 1 can be done; round 2 has to wait.
    assert_eq!(b.join(B)[1..], [give(B, 2, range(0, 10), emission(1))]);
    assert_eq!(b.complete(A, 1), [accept(1), build(0, MapKind::Global, 10)]);
    assert_eq!(b.complete(B, 2), [accept(2), build(1, MapKind::Global, 10)]);
    // Built out of order: tiles still come round by round.
    assert_eq!(b.event(built(1, map(1))), []);
    let both = [give(A, 3, range(0, 1), tiles(0)), give(B, 4, range(1, 2), tiles(0))];
    assert_eq!(b.event(built(0, map(0))), both);
    // Nothing of round 0 is left to hand out, so B goes on with round 1's tiles.
    assert_eq!(b.complete(B, 4), [accept(4), give(B, 5, range(0, 1), tiles(1))]);
    // Round 0 is whole, and closed; round 2 comes into the window when that is done.
    assert_eq!(b.complete(A, 3), [accept(3), close(0, 2), give(A, 6, range(1, 2), tiles(1))]);
    // Round 1 may be whole before round 0 is closed, but is closed after it.
    assert_eq!(b.complete(B, 5), [accept(5)]);
    assert_eq!(b.complete(A, 6), [accept(6)]);
    let next = [retire(0), close(1, 2), give(A, 7, range(0, 10), emission(2))];
    assert_eq!(b.event(closed(0)), next);
    assert_eq!(b.event(closed(0)), []);
    assert_eq!(b.event(closed(1)), [retire(1)]);
    assert_eq!(b.complete(A, 7), [accept(7), build(2, MapKind::Global, 10)]);
    assert_eq!(b.event(built(1, map(1))), []);
    assert_eq!(b.event(built(2, map(2)))[..1], [give(A, 8, range(0, 1), tiles(2))]);
    assert_eq!(b.complete(B, 9), [accept(9)]);
    assert_eq!(b.complete(A, 8), [accept(8), close(2, 2)]);
    assert_eq!(b.event(closed(2)), [assemble(3, 0, None)]);
    assert_eq!(b.event(Event::Assembled { job: JOB }).last(), Some(&finish(Outcome::Done)));
}

#[test]
fn work_of_an_earlier_phase_goes_before_work_of_a_later_one() {
    let mut b = submit(policy(), rounds(2, 10, 2), Limits::default());
    b.join(A);
    b.join(B);
    b.complete(A, 1);
    b.event(built(0, map(0)));
    assert_eq!(b.scheduler.lease(LeaseId(3)).map(|l| l.lease.task.clone()), Some(tiles(0)));
    // A is lost with round 0's tiles: B does them before anything of round 1 that is left.
    b.event(Event::Lost { worker: A });
    assert_eq!(b.complete(B, 2)[..2], [accept(2), build(1, MapKind::Global, 10)]);
    assert_eq!(b.scheduler.lease(LeaseId(4)).map(|l| l.lease.task.clone()), Some(tiles(0)));
}

/// Nine rounds of one tile: A has that of round 0, both maps of rounds 0 and 1 are built, and B goes on with what is open.
fn with_two_maps(limits: Limits) -> Bench {
    let mut b = submit(policy(), rounds(9, 10, 1), limits);
    b.join(A);
    b.join(B);
    b.complete(A, 1);
    b.event(built(0, map(0)));
    b.complete(B, 2);
    b.event(built(1, map(1)));
    b
}

#[test]
fn a_time_limit_ends_a_job_between_two_rounds() {
    let mut b = with_two_maps(LIMIT);
    // Round 0's tile is out; the limit is reached before it comes back.
    b.now = seconds(61);
    b.event(Event::Heard { worker: A });
    assert_eq!(b.event(Event::Heard { worker: B }), []);
    assert_eq!(b.event(Event::Tick), []);
    let total = |b: &Bench| b.scheduler.job(JOB).map(|j| j.total(Kind::Emission(MapKind::Global)).units);
    assert_eq!(total(&b), Some(20));
    assert_eq!(b.complete(A, 3), [accept(3), close(0, 1)]);
    assert_eq!(b.event(closed(0)).last(), Some(&assemble(1, 0, Some(Limit::Time))));
    // What was done of round 1 is no part of the image.
    assert_eq!(total(&b), Some(10));
    assert_eq!(b.event(built(1, map(1))), []);
    assert_eq!(b.event(Event::Assembled { job: JOB }).last(), Some(&finish(Outcome::Done)));
}

#[test]
fn what_is_out_when_a_limit_ends_the_job_is_revoked() {
    let mut b = submit(policy(), rounds(9, 100, 1), LIMIT);
    b.join(A);
    (1..=10).for_each(|id| drop(b.complete(A, id)));
    b.event(built(0, map(0)));
    b.join(B);
    b.complete(A, 11);
    assert_eq!(b.scheduler.lease(LeaseId(12)).map(|l| l.lease.task.clone()), Some(tiles(0)));
    b.now = seconds(60);
    let revoked = Command::Revoke { worker: A, lease: LeaseId(13) };
    assert_eq!(b.scheduler.lease(LeaseId(13)).map(|l| l.lease.task.clone()), Some(emission(1)));
    // B gets nothing of a round that will be cut off.
    assert_eq!(b.complete(B, 12), [accept(12), close(0, 1)]);
    assert_eq!(b.event(closed(0)), [revoked, assemble(1, 0, Some(Limit::Time))]);
    assert_eq!(b.scheduler.leases().count(), 0);
    assert!(b.scheduler.workers()[&A].leases.is_empty());
}

#[test]
fn an_image_that_is_good_enough_ends_its_job_with_the_rounds_that_are_closed() {
    let mut b = with_two_maps(Limits::default());
    // B renders round 1's tile while A's of round 0 comes back and the round is closed.
    assert_eq!(b.scheduler.lease(LeaseId(4)).map(|l| l.lease.task.clone()), Some(tiles(1)));
    assert_eq!(b.complete(A, 3)[..2], [accept(3), close(0, 1)]);
    let good = Event::Closed { job: JOB, round: 0, is_good_enough: true };
    let said = b.event(good.clone());
    assert_eq!(said[..], [Command::Revoke { worker: B, lease: LeaseId(4) }, assemble(1, 0, Some(Limit::Error))]);
    assert_eq!(b.event(good), []);
}

#[test]
fn passes_over_the_pixels_all_read_the_maps_of_the_first_round() {
    let mut phases = rounds(1, 10, 1);
    phases.extend((1..4).map(|round| Phase::Gather { round, tiles: 1 }));
    let mut b = submit(policy(), phases, Limits::default());
    b.join(A);
    b.complete(A, 1);
    let pass = |id, round| give(A, id, range(0, 1), Task::Gather { round, maps: vec![map(0)], sample_map: None });
    assert_eq!(b.event(built(0, map(0))), [pass(2, 0)]);
    for round in 0..3 {
        let id = u64::from(round) + 2;
        // The next pass begins while this round is closed; the map stays.
        assert_eq!(b.complete(A, id), [accept(id), close(round, 1), pass(id + 1, round + 1)]);
        assert_eq!(b.event(closed(round)), []);
    }
    assert_eq!(b.complete(A, 5), [accept(5), close(3, 1)]);
    assert_eq!(b.event(closed(3)), [assemble(4, 0, None)]);
}

#[test]
fn a_sample_map_is_made_of_closed_rounds_and_read_by_all_to_come() {
    let gather = |round| Phase::Gather { round, tiles: 1 };
    let decide = Phase::SampleMap { round: 1 };
    let mut b = submit(policy(), vec![gather(0), decide, gather(1), gather(2)], Limits::default());
    b.join(A);
    b.join(B);
    assert_eq!(b.complete(A, 1), [accept(1), close(0, 1)]);
    // Nothing to do before it is there.
    assert_eq!(b.event(closed(0)), [Command::Build { job: JOB, phase: decide }]);
    let made = Event::Built { job: JOB, round: 1, input: InputRef::SampleMap(BOOTSTRAP) };
    let pass = |round| Task::Gather { round, maps: vec![], sample_map: Some(BOOTSTRAP) };
    let prepare = Command::Prepare { worker: B, job: JOB };
    assert_eq!(b.event(made.clone()), [give(A, 2, range(0, 1), pass(1)), prepare, give(B, 3, range(0, 1), pass(2))]);
    assert_eq!(b.event(made), []);
    assert_eq!(b.complete(A, 2), [accept(2), close(1, 1)]);
    assert_eq!(b.event(closed(1)), []);
    assert_eq!(b.complete(B, 3), [accept(3), close(2, 1)]);
    assert_eq!(b.event(closed(2)), [assemble(3, 0, None)]);
}

#[test]
fn a_job_that_is_done_in_time_is_not_said_to_be_ended_by_its_limit() {
    let mut b = submit(policy(), rounds(1, 0, 1)[1..].to_vec(), LIMIT);
    b.join(A);
    b.now = seconds(100);
    assert_eq!(b.complete(A, 1), [accept(1), assemble(1, 0, None)]);
}

#[test]
fn chains_of_every_round_wait_for_the_bootstrap_and_read_it() {
    let bootstrap = Phase::Bootstrap { paths: 10 };
    let chains = |round| Phase::Splat { round, units: 2 };
    let mut b = submit(policy(), vec![bootstrap, chains(0), chains(1)], Limits::default());
    b.join(A);
    b.join(B);
    let open: Vec<Task> = b.scheduler.leases().map(|l| l.lease.task.clone()).collect();
    assert_eq!(open, [Task::Bootstrap]);
    assert_eq!(b.complete(A, 1), [accept(1), Command::Build { job: JOB, phase: bootstrap }]);
    let made = Event::Built { job: JOB, round: 0, input: InputRef::Bootstrap(BOOTSTRAP) };
    let prepare = Command::Prepare { worker: B, job: JOB };
    assert_eq!(b.event(made.clone()), [give(A, 2, range(0, 1), splat(0)), prepare, give(B, 3, range(1, 2), splat(0))]);
    assert_eq!(b.event(made), []);
    // Nothing of the first round is left to hand out.
    assert_eq!(b.complete(A, 2), [accept(2), give(A, 4, range(0, 1), splat(1))]);
    let close = |round| Command::Build { job: JOB, phase: chains(round) };
    assert_eq!(b.complete(B, 3), [accept(3), close(0), give(B, 5, range(1, 2), splat(1))]);
    assert_eq!(b.complete(A, 4), [accept(4)]);
    assert_eq!(b.event(closed(0)), []);
    assert_eq!(b.complete(B, 5), [accept(5), close(1)]);
    assert_eq!(b.event(closed(1)), [assemble(2, 4, None)]);
}

#[test]
fn at_a_time_limit_the_chains_of_whole_rounds_count() {
    let chains = |round| Phase::Splat { round, units: 1 };
    let mut b = submit(policy(), vec![Phase::Bootstrap { paths: 1 }, chains(0), chains(1)], LIMIT);
    b.join(A);
    b.complete(A, 1);
    b.event(Event::Built { job: JOB, round: 0, input: InputRef::Bootstrap(BOOTSTRAP) });
    b.now = seconds(61);
    b.event(Event::Heard { worker: A });
    assert_eq!(b.event(Event::Tick), []);
    assert_eq!(b.complete(A, 2), [accept(2), Command::Build { job: JOB, phase: chains(0) }]);
    assert_eq!(b.event(closed(0)), [assemble(1, 1, Some(Limit::Time))]);
}

#[test]
fn a_round_begins_with_the_rates_and_the_photons_per_path_of_the_one_before() {
    let policy = Policy { leases_per_worker: 1, max_lease_photons: 1 << 40, ..Policy::default() };
    let mut b = submit(policy.clone(), rounds(3, 1 << 40, 1 << 20), Limits::default());
    b.join(A);
    let mut units = Vec::new();
    for _ in 0..4_000_000 {
        let Some(open) = b.scheduler.leases().next().map(|l| l.lease.clone()) else { break };
        units.push((open.task.clone(), open.range.len()));
        if matches!(open.task, Task::Emission { round: 1, .. }) {
            break;
        }
        // A million paths or ten tiles a second.
        let rate = if matches!(open.task, Task::Gather { .. }) { 10.0 } else { 1e6 };
        let busy = Duration::from_secs_f64(open.range.len() as f64 / rate);
        let (lease, attempt, range) = (open.id, open.attempt, open.range);
        b.event(Event::Completed {
            worker: A,
            lease,
            attempt,
            range,
            busy,
            stored: range.len(),
            digest: Digest([9; 32]),
        });
        b.event(built(0, map(0)));
        b.event(closed(0));
    }
    assert_eq!(units.first(), Some(&(emission(0), policy.probe_paths)));
    assert_eq!(units.last(), Some(&(emission(1), 1_000_000)));
}

#[test]
fn what_a_round_costs_does_not_depend_on_how_many_there_are() {
    let count = 65_536;
    let both = |round| MapKind::ALL.map(|map| Phase::Emission { round, map, paths: 10 });
    let all = |round| both(round).into_iter().chain([Phase::Gather { round, tiles: 2 }]);
    let mut b = submit(policy(), (0..count).flat_map(all).collect(), Limits::default());
    b.join(A);
    let mut widest = 0;
    let mut waiting: Vec<Command> = vec![];
    loop {
        let next = b.scheduler.leases().next().map(|l| l.lease.id.0);
        let said = match (next, waiting.pop()) {
            (_, Some(Command::Build { phase: Phase::Emission { round, map: kind, .. }, .. })) => {
                b.event(built(round, MapRef { kind, ..map(round) }))
            }
            (_, Some(Command::Build { phase: Phase::Gather { round, .. }, .. })) => b.event(closed(round)),
            (Some(id), _) => b.complete(A, id),
            (None, _) => break,
        };
        widest = widest.max(b.scheduler.job(JOB).map_or(0, |j| j.steps().count()));
        waiting.extend(said.iter().filter(|c| matches!(c, Command::Build { .. })).cloned());
        if let Some(done) = said.iter().find(|c| matches!(c, Command::Assemble { .. })) {
            assert_eq!(*done, assemble(count, 0, None));
            assert_eq!(widest, 6);
            return;
        }
    }
    panic!("the job stands still in round {:?}", b.scheduler.job(JOB).map(|j| j.round()));
}

#[test]
fn rounds_out_of_order_or_without_an_end_make_no_job() {
    let gather = |round| Phase::Gather { round, tiles: 1 };
    let emit = |round| Phase::Emission { round, map: MapKind::Global, paths: 1 };
    let splat = |round| Phase::Splat { round, units: 1 };
    let bootstrap = Phase::Bootstrap { paths: 1 };
    let good = [
        vec![splat(0)],
        vec![splat(0), splat(1)],
        vec![bootstrap, splat(0), splat(1), splat(2)],
        vec![gather(0), gather(1), emit(2), gather(2)],
    ];
    for phases in good {
        assert!(
            Job::new(JOB, phases.clone(), Terms { limits: LIMIT, ..Terms::default() }, seconds(0)).is_some(),
            "{phases:?}"
        );
    }
    let bad = [
        vec![gather(1)],
        vec![gather(0), gather(2)],
        vec![gather(1), gather(0)],
        vec![gather(0), emit(1)],
        vec![gather(0), emit(0)],
        vec![emit(0), splat(0)],
        vec![bootstrap, gather(0)],
        vec![splat(0), bootstrap],
        vec![splat(0), splat(0)],
        vec![splat(0), gather(0)],
        vec![bootstrap, emit(0), splat(0)],
        vec![gather(0), emit(1), gather(1), splat(1)],
    ];
    for phases in bad {
        assert!(
            Job::new(JOB, phases.clone(), Terms { limits: LIMIT, ..Terms::default() }, seconds(0)).is_none(),
            "{phases:?}"
        );
    }
    assert!(job::closes_rounds(&rounds(2, 1, 1)) && job::closes_rounds(&[bootstrap, splat(0), splat(1)]));
    assert!(!job::closes_rounds(&rounds(1, 1, 1)) && !job::closes_rounds(&[bootstrap, splat(0)]));
}

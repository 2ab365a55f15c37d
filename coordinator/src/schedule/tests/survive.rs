//! Leases run twice, jobs that go on after a restart, priorities, and workers too small for a job.

use super::*;

fn twins() -> Policy {
    Policy { twin_after: seconds(2), ..policy() }
}

/// A bench with one lease of a tile out at A for `age`, and B idle.
fn slow_tail(age: Duration) -> (Bench, Vec<Command>) {
    let mut b = Bench::with_job(twins(), 0, 1);
    b.join(A);
    b.now = age;
    let said = b.join(B);
    (b, said)
}
fn completed(b: &mut Bench, worker: WorkerId, lease: u64, attempt: u32, digest: u8) -> Vec<Command> {
    let (lease, range, busy) = (LeaseId(lease), range(0, 1), seconds(1));
    let digest = Digest([digest; 32]);
    b.event(Event::Completed { worker, lease, attempt, range, busy, stored: 0, digest })
}
fn gather() -> Task {
    Task::Gather { round: 0, maps: Vec::new(), sample_map: None }
}

#[test]
fn an_idle_worker_repeats_an_old_lease_and_the_first_result_counts() {
    let (_, said) = slow_tail(seconds(1));
    assert_eq!(said, [], "the lease is young");
    let (mut b, said) = slow_tail(seconds(2));
    let twin = Command::Assign { worker: B, lease: lease(2, 2, range(0, 1), gather()) };
    assert_eq!(said, [Command::Prepare { worker: B, job: JOB }, twin]);
    assert_eq!(b.join(C), [], "no third one");
    let said = completed(&mut b, B, 2, 2, 9);
    assert_eq!(said[0], Command::Revoke { worker: A, lease: LeaseId(1) });
    assert_eq!(said[1], Command::Accept { job: JOB, lease: LeaseId(2) });
    // The same result a second time is discarded without a word more.
    assert!(b.scheduler.settled(A, LeaseId(1), 1).is_some());
    let said = [9, 8].map(|digest| completed(&mut b, A, 1, 1, digest));
    assert!(
        said.iter().all(|s| *s == [Command::Discard { lease: LeaseId(1), reason: Discarded::Stale }]),
        "it was compared once"
    );
}

#[test]
fn a_lease_counts_as_handed_out_again_once_nobody_has_it_and_as_repeated_while_somebody_has() {
    let (mut b, _) = slow_tail(seconds(2));
    let counts = |b: &Bench| b.scheduler.job(JOB).map(|j| (j.retried, j.repeated));
    assert_eq!(counts(&b), Some((0, 1)));
    b.event(Event::Lost { worker: B });
    assert_eq!(counts(&b), Some((0, 1)), "A has it still");
    b.event(Event::Lost { worker: A });
    assert_eq!(counts(&b), Some((0, 1)), "nobody has it yet");
    b.join(C);
    assert_eq!(counts(&b), Some((1, 1)));
    assert_eq!(b.scheduler.leases().map(|l| l.reason).collect::<Vec<_>>(), [Reason::Retry]);
}

#[test]
fn a_worker_that_was_outrun_gets_nothing_before_it_is_heard_of_its_lease() {
    let answers: [fn(&mut Bench) -> Vec<Command>; 3] = [
        |b| completed(b, A, 1, 1, 9),
        |b| b.event(Event::Returned { worker: A, lease: LeaseId(1), attempt: 1 }),
        |b| b.event(Event::TaskFailed { worker: A, lease: LeaseId(1), attempt: 1, error: String::new() }),
    ];
    for answer in answers {
        let (mut b, _) = slow_tail(seconds(2));
        completed(&mut b, B, 2, 2, 9);
        b.event(submitted(JobId(8), vec![Phase::Gather { round: 0, tiles: 2 }]));
        let busy = b.scheduler.leases().map(|l| l.worker).collect::<Vec<_>>();
        assert_eq!(busy, [B], "the other tile waits for somebody else");
        let given: Vec<JobId> = answer(&mut b).into_iter().filter_map(assigned).collect();
        assert_eq!(given, [JobId(8)]);
    }
}

#[test]
fn a_second_result_that_differs_is_reported() {
    for whole in [true, false] {
        let (mut b, _) = slow_tail(seconds(5));
        completed(&mut b, A, 1, 1, 9);
        let said = match whole {
            true => completed(&mut b, B, 2, 2, 8),
            false => b.event(Event::Repeated { worker: B, lease: LeaseId(2), attempt: 2, digest: Digest([8; 32]) }),
        };
        assert_eq!(said[0], Command::Dispute { job: JOB, phase: 0, range: range(0, 1), workers: [A, B] });
    }
}

#[test]
fn one_of_two_twins_may_fail_or_die() {
    let (mut b, _) = slow_tail(seconds(5));
    assert_eq!(b.event(Event::Lost { worker: A }), [], "B has it");
    assert_eq!(b.fail(B, 2, "no"), []);
    // Both are gone: a third worker gets the indices, and what happened to them is remembered.
    let said = b.join(C);
    assert_eq!(said[1], Command::Assign { worker: C, lease: lease(3, 3, range(0, 1), gather()) });
    let history = &b.scheduler.lease(LeaseId(3)).unwrap().history;
    assert_eq!((history.losses, history.failures.len()), (1, 1));
}

#[test]
fn a_worker_that_would_not_be_done_sooner_repeats_nothing() {
    let mut b = Bench::new(twins());
    b.join(A);
    b.join(B);
    b.event(submitted(JOB, vec![Phase::Gather { round: 0, tiles: 2 }]));
    // B takes 10 s a tile.
    let (busy, digest) = (seconds(10), Digest([9; 32]));
    b.event(Event::Completed { worker: B, lease: LeaseId(2), attempt: 1, range: range(1, 2), busy, stored: 0, digest });
    b.now = seconds(9);
    assert_eq!(b.event(Event::Heard { worker: B }), []);
    b.now = seconds(10);
    assert!(matches!(b.event(Event::Heard { worker: B })[..], [Command::Assign { worker: B, .. }]));
}

#[test]
fn a_job_goes_on_where_an_earlier_coordinator_stopped() {
    let emission = |round| Phase::Emission { round, map: MapKind::Global, paths: 20 };
    let phases: Vec<Phase> = (0..3).flat_map(|round| [emission(round), Phase::Gather { round, tiles: 4 }]).collect();
    let map = |round: u8| InputRef::Map(MapRef { digest: Digest([round; 32]), ..GLOBAL });
    // Round 0 is closed; the map of round 1 is built and one tile of four is there; round 2 has half of its photons.
    let mut saved = Saved::after(1);
    saved.totals.insert(Kind::Gather, work::Total { units: 4, stored: 0 });
    saved.totals.insert(Kind::Emission(MapKind::Global), work::Total { units: 20, stored: 5 });
    saved.inputs.insert(2, (map(1), 7));
    assert!(saved.add_result(&phases, 3, range(1, 2), 0));
    assert!(saved.add_result(&phases, 4, range(0, 10), 3));
    let mut b = Bench::new(policy());
    let terms = Box::new(Terms { saved, ..Terms::default() });
    assert_eq!(b.event(Event::Submitted { job: JOB, phases, terms }), []);
    let total = |b: &Bench, kind| b.scheduler.job(JOB).unwrap().total(kind);
    assert_eq!(total(&b, Kind::Gather), work::Total { units: 5, stored: 0 });
    assert_eq!(total(&b, Kind::Emission(MapKind::Global)), work::Total { units: 50, stored: 15 });
    let maps = vec![MapRef { digest: Digest([1; 32]), ..GLOBAL }];
    let task = Task::Gather { round: 1, maps, sample_map: None };
    let given = b.join(A);
    assert_eq!(given[1], Command::Assign { worker: A, lease: lease(1, 1, range(0, 1), task.clone()) });
    let said = b.complete(A, 1);
    assert_eq!(said[1], Command::Assign { worker: A, lease: lease(2, 1, range(2, 4), task) });
    let said = b.complete(A, 2);
    assert_eq!(said[1], Command::Build { job: JOB, phase: Phase::Gather { round: 1, tiles: 4 } });
    let rest = Task::Emission { round: 2, map: MapKind::Global };
    assert_eq!(said[2], Command::Assign { worker: A, lease: lease(3, 1, range(10, 20), rest) });
    b.event(Event::Closed { job: JOB, round: 1, is_good_enough: false });
    assert_eq!(b.scheduler.job(JOB).unwrap().closed_totals()[&Kind::Gather].units, 8);
}

#[test]
fn maps_that_later_rounds_read_are_there_after_a_restart() {
    let mut phases = vec![Phase::Emission { round: 0, map: MapKind::Global, paths: 20 }];
    phases.extend((0..3).map(|round| Phase::Gather { round, tiles: 1 }));
    let mut saved = Saved::after(2);
    saved.inputs.insert(0, (InputRef::Map(GLOBAL), 7));
    let mut b = Bench::new(policy());
    let terms = Box::new(Terms { saved, ..Terms::default() });
    b.event(Event::Submitted { job: JOB, phases, terms });
    let task = Task::Gather { round: 2, maps: vec![GLOBAL], sample_map: None };
    assert_eq!(b.join(A)[1], Command::Assign { worker: A, lease: lease(1, 1, range(0, 1), task) });
    let said = b.complete(A, 1);
    assert_eq!(said[1], Command::Build { job: JOB, phase: Phase::Gather { round: 2, tiles: 1 } });
    let said = b.event(Event::Closed { job: JOB, round: 2, is_good_enough: false });
    let done = Done { rounds: 3, units: 0, ended_by: None };
    assert_eq!(said, [Command::Assemble { job: JOB, done }]);
}

#[test]
fn time_before_the_restart_counts_towards_the_limit() {
    let phases = (0..3).map(|round| Phase::Gather { round, tiles: 1 }).collect();
    let limits = gatherlight_proto::types::Limits { time: Some(seconds(60)), error: None };
    let mut b = Bench { now: seconds(50), ..Bench::new(policy()) };
    let terms = Box::new(Terms { limits, age: seconds(50), ..Terms::default() });
    b.event(Event::Submitted { job: JOB, phases, terms });
    b.join(A);
    b.now = seconds(61);
    b.complete(A, 1);
    let said = b.event(Event::Closed { job: JOB, round: 0, is_good_enough: false });
    let done = Done { rounds: 1, units: 0, ended_by: Some(gatherlight_proto::types::Limit::Time) };
    assert_eq!(said, [Command::Assemble { job: JOB, done }]);
}

#[test]
fn the_job_of_higher_priority_comes_first() {
    let mut b = Bench::with_job(policy(), 0, 4);
    let urgent = JobId(8);
    let terms = Box::new(Terms { priority: 1, ..Terms::default() });
    b.event(Event::Submitted { job: urgent, phases: vec![Phase::Gather { round: 0, tiles: 3 }], terms });
    let given: Vec<JobId> = [A, B, C].iter().flat_map(|&w| b.join(w)).filter_map(assigned).collect();
    assert_eq!(given, [urgent, urgent, JOB]);
}

#[test]
fn a_worker_without_the_memory_gets_nothing_of_a_job() {
    let mut b = Bench::new(policy());
    let terms = Box::new(Terms { worker_bytes: 2 << 30, ..Terms::default() });
    b.event(Event::Submitted { job: JOB, phases: vec![Phase::Gather { round: 0, tiles: 4 }], terms });
    assert_eq!(b.join(A), []);
    let large = Event::Joined { worker: B, threads: 1, memory_bytes: 2 << 30 };
    assert_eq!(b.event(large).into_iter().filter_map(assigned).collect::<Vec<_>>(), [JOB]);
}

fn assigned(command: Command) -> Option<JobId> {
    match command {
        Command::Assign { lease, .. } => Some(lease.job),
        _ => None,
    }
}

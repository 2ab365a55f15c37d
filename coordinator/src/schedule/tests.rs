//! Event lists in, command lists out.

use super::job::Done;
use super::*;
use gatherlight_proto::Digest;
use gatherlight_proto::message::{InputRef, MapRef, Task};
use gatherlight_render::photon::MapKind;

mod rounds;
mod survive;

const JOB: JobId = JobId(7);
const A: WorkerId = WorkerId(1);
const B: WorkerId = WorkerId(2);
const C: WorkerId = WorkerId(3);
const GLOBAL: MapRef = MapRef { kind: MapKind::Global, digest: Digest([3; 32]), bytes: 99 };

fn seconds(s: u64) -> Duration {
    Duration::from_secs(s)
}
fn range(first: u64, end: u64) -> EmissionRange {
    EmissionRange { first, end }
}

/// A result with one photon that took no time.
fn result(worker: WorkerId, lease: u64, attempt: u32, range: EmissionRange) -> Event {
    let (lease, busy, digest) = (LeaseId(lease), Duration::ZERO, Digest([9; 32]));
    Event::Completed { worker, lease, attempt, range, busy, stored: 1, digest }
}
fn submitted(job: JobId, phases: Vec<Phase>) -> Event {
    Event::Submitted { job, phases, terms: Box::default() }
}

/// One lease at a time of 10 paths or 2 tiles, and none twice, so that tests can count.
fn policy() -> Policy {
    let (probe_paths, min_paths, max_paths, max_tiles) = (10, 10, 10, 2);
    let twin_after = Duration::MAX;
    Policy { leases_per_worker: 1, probe_paths, min_paths, max_paths, max_tiles, twin_after, ..Policy::default() }
}

/// A scheduler, its clock, and what it said last.
struct Bench {
    scheduler: Scheduler,
    now: Duration,
}

impl Bench {
    fn new(policy: Policy) -> Self {
        Bench { scheduler: Scheduler::new(policy), now: Duration::ZERO }
    }
    /// A job of `paths` photons of one map and `tiles` tiles, or tiles only.
    fn with_job(policy: Policy, paths: u64, tiles: u32) -> Self {
        let mut bench = Bench::new(policy);
        let emission = (paths > 0).then_some(Phase::Emission { round: 0, map: MapKind::Global, paths });
        let phases = emission.into_iter().chain([Phase::Gather { round: 0, tiles }]).collect();
        assert_eq!(bench.event(submitted(JOB, phases)), []);
        bench
    }
    fn event(&mut self, event: Event) -> Vec<Command> {
        self.scheduler.handle(self.now, event)
    }
    fn join(&mut self, worker: WorkerId) -> Vec<Command> {
        self.event(Event::Joined { worker, threads: 2, memory_bytes: 1 << 30 })
    }
    /// The worker returns what its lease asked for.
    fn complete(&mut self, worker: WorkerId, lease: u64) -> Vec<Command> {
        let open = self.scheduler.lease(LeaseId(lease)).expect("is open").lease.clone();
        let (attempt, range) = (open.attempt, open.range);
        let busy = Duration::from_millis(10);
        let digest = Digest([9; 32]);
        self.event(Event::Completed { worker, lease: open.id, attempt, range, busy, stored: 1, digest })
    }
    fn fail(&mut self, worker: WorkerId, lease: u64, error: &str) -> Vec<Command> {
        let attempt = self.scheduler.lease(LeaseId(lease)).map_or(1, |l| l.lease.attempt);
        self.event(Event::TaskFailed { worker, lease: LeaseId(lease), attempt, error: error.into() })
    }
    /// Everything of both phases, by worker A.
    fn run_to_end(&mut self) -> Vec<Command> {
        let mut all = Vec::new();
        for _ in 0..300 {
            let open: Vec<_> = self.scheduler.leases().map(|l| (l.worker, l.lease.id.0)).collect();
            let said: Vec<_> = open.iter().flat_map(|&(w, l)| self.complete(w, l)).collect();
            if said.iter().any(|c| matches!(c, Command::Build { .. })) {
                all.extend(self.event(built(0, GLOBAL)));
            }
            if said.iter().any(|c| matches!(c, Command::Assemble { .. })) {
                all.extend(self.event(Event::Assembled { job: JOB }));
            }
            all.extend(said);
        }
        all
    }
}

fn lease(id: u64, attempt: u32, range: EmissionRange, task: Task) -> Lease {
    Lease { id: LeaseId(id), attempt, job: JOB, range, task }
}
fn emit(worker: WorkerId, id: u64, attempt: u32, range: EmissionRange) -> Command {
    Command::Assign { worker, lease: lease(id, attempt, range, Task::Emission { round: 0, map: MapKind::Global }) }
}
fn gather(worker: WorkerId, id: u64, range: EmissionRange, maps: Vec<MapRef>) -> Command {
    Command::Assign { worker, lease: lease(id, 1, range, Task::Gather { round: 0, maps, sample_map: None }) }
}
fn prepare(worker: WorkerId) -> Command {
    Command::Prepare { worker, job: JOB }
}
fn accept(id: u64) -> Command {
    Command::Accept { job: JOB, lease: LeaseId(id) }
}
fn stale(id: u64) -> Command {
    Command::Discard { lease: LeaseId(id), reason: Discarded::Stale }
}
fn built(round: u32, map: MapRef) -> Event {
    Event::Built { job: JOB, round, input: InputRef::Map(map) }
}
fn build(round: u32, map: MapKind, paths: u64) -> Command {
    Command::Build { job: JOB, phase: Phase::Emission { round, map, paths } }
}
fn finish(outcome: Outcome) -> Command {
    Command::Finish { job: JOB, outcome }
}

#[test]
fn a_job_goes_through_its_phases() {
    let mut b = Bench::with_job(policy(), 20, 3);
    assert_eq!(b.join(A), [prepare(A), emit(A, 1, 1, range(0, 10))]);
    assert_eq!(b.complete(A, 1), [accept(1), emit(A, 2, 1, range(10, 20))]);
    assert_eq!(b.complete(A, 2), [accept(2), build(0, MapKind::Global, 20)]);
    assert_eq!(b.event(built(0, GLOBAL)), [gather(A, 3, range(0, 2), vec![GLOBAL])]);
    assert_eq!(b.complete(A, 3), [accept(3), gather(A, 4, range(2, 3), vec![GLOBAL])]);
    assert_eq!(
        b.complete(A, 4),
        [accept(4), Command::Assemble { job: JOB, done: Done { rounds: 1, ..Done::default() } }]
    );
    let end = [Command::Forget { worker: A, job: JOB }, finish(Outcome::Done)];
    assert_eq!(b.event(Event::Assembled { job: JOB }), end);
    assert!(b.scheduler.job(JOB).is_none());
}

#[test]
fn a_job_without_photons_begins_with_tiles() {
    let mut b = Bench::with_job(policy(), 0, 1);
    assert_eq!(b.join(A), [prepare(A), gather(A, 1, range(0, 1), vec![])]);
}

#[test]
fn a_map_without_paths_is_built_at_once() {
    let mut b = Bench::new(policy());
    let phases =
        vec![Phase::Emission { round: 0, map: MapKind::Global, paths: 0 }, Phase::Gather { round: 0, tiles: 1 }];
    let build = build(0, MapKind::Global, 0);
    assert_eq!(b.event(submitted(JOB, phases)), [build]);
}

#[test]
fn the_next_map_is_traced_while_one_is_merged_and_tiles_wait_for_both() {
    let mut b = Bench::new(policy());
    let phase = |map| Phase::Emission { round: 0, map, paths: 10 };
    let phases = vec![phase(MapKind::Global), phase(MapKind::Caustic), Phase::Gather { round: 0, tiles: 1 }];
    b.event(submitted(JOB, phases));
    b.join(A);
    let caustic = Command::Assign {
        worker: A,
        lease: lease(2, 1, range(0, 10), Task::Emission { round: 0, map: MapKind::Caustic }),
    };
    let build = |kind| build(0, kind, 10);
    assert_eq!(b.complete(A, 1), [accept(1), build(MapKind::Global), caustic]);
    assert_eq!(b.complete(A, 2), [accept(2), build(MapKind::Caustic)]);
    let caustic = MapRef { kind: MapKind::Caustic, ..GLOBAL };
    assert_eq!(b.event(built(0, caustic)), []);
    let tiles = gather(A, 3, range(0, 1), vec![GLOBAL, caustic]);
    assert_eq!(b.event(built(0, GLOBAL)), [tiles]);
}

#[test]
fn phases_that_make_no_job_fail_it() {
    let gather = Phase::Gather { round: 0, tiles: 1 };
    let emission = Phase::Emission { round: 0, map: MapKind::Global, paths: 1 };
    for phases in [vec![], vec![emission], vec![gather, gather], vec![emission, emission, gather]] {
        let said = Bench::new(policy()).event(submitted(JOB, phases));
        assert!(matches!(said[..], [Command::Finish { outcome: Outcome::Failed(_), .. }]), "{said:?}");
    }
}

#[test]
fn a_lost_workers_lease_goes_to_another_as_it_was() {
    let mut b = Bench::with_job(policy(), 100, 1);
    b.join(A);
    b.join(B);
    assert_eq!(b.event(Event::Lost { worker: A }), []);
    assert_eq!(b.complete(B, 2), [accept(2), emit(B, 3, 2, range(0, 10))]);
    assert_eq!(b.scheduler.job(JOB).map(|j| j.retried), Some(1));
}

#[test]
fn a_worker_that_joins_late_is_used_at_once() {
    let mut b = Bench::with_job(policy(), 100, 1);
    b.join(A);
    assert_eq!(b.join(B), [prepare(B), emit(B, 2, 1, range(10, 20))]);
}

#[test]
fn a_silent_worker_is_dead_and_what_it_says_later_is_stale() {
    let mut b = Bench::with_job(policy(), 100, 1);
    b.join(A);
    b.now = seconds(10);
    assert_eq!(b.event(Event::Tick), []);
    b.now = seconds(11);
    let reason = "no heartbeat for 10 s".to_owned();
    assert_eq!(b.event(Event::Tick), [Command::Dismiss { worker: A, reason }]);
    assert_eq!(b.join(B), [prepare(B), emit(B, 2, 2, range(0, 10))]);
    assert_eq!(b.event(result(A, 1, 1, range(0, 10))), [stale(1)]);
}

#[test]
fn heartbeats_keep_a_busy_worker_alive() {
    let mut b = Bench::with_job(policy(), 100, 1);
    b.join(A);
    for s in 1..60 {
        b.now = seconds(s);
        b.event(Event::Heard { worker: A });
        assert_eq!(b.event(Event::Tick), []);
    }
}

#[test]
fn a_lease_past_its_deadline_is_revoked_and_given_to_another() {
    let mut b = Bench::with_job(policy(), 10, 1);
    b.join(A);
    b.now = policy().min_deadline + seconds(1);
    b.event(Event::Heard { worker: A });
    b.join(B);
    let revoke = Command::Revoke { worker: A, lease: LeaseId(1) };
    let again = emit(A, 2, 2, range(0, 10));
    assert_eq!(b.event(Event::Tick), [revoke, again]);
    // Twice the time, the second time.
    b.now += policy().min_deadline + seconds(2);
    b.event(Event::Heard { worker: A });
    b.event(Event::Heard { worker: B });
    assert_eq!(b.event(Event::Tick), []);
}

#[test]
fn a_result_counts_once() {
    let mut b = Bench::with_job(policy(), 100, 1);
    b.join(A);
    b.complete(A, 1);
    assert_eq!(b.event(result(A, 1, 1, range(0, 10))), [stale(1)]);
    assert_eq!(b.scheduler.job(JOB).map(|j| j.total(Kind::Emission(MapKind::Global)).units), Some(10));
}

#[test]
fn results_of_others_leases_attempts_and_ranges_do_not_count() {
    let mut b = Bench::with_job(policy(), 100, 1);
    b.join(A);
    b.join(B);
    assert_eq!(b.event(result(B, 1, 1, range(0, 10))), [stale(1)]);
    assert_eq!(b.event(result(A, 1, 2, range(0, 10))), [stale(1)]);
    assert_eq!(b.event(result(A, 99, 1, range(0, 10))), [stale(99)]);
    let wrong = b.event(result(A, 1, 1, range(0, 9)));
    assert_eq!(wrong[0], Command::Discard { lease: LeaseId(1), reason: Discarded::WrongRange });
    // It counts as A's failure: A gets other indices, B the failed ones.
    assert_eq!(wrong[1..], [emit(A, 3, 1, range(20, 30))]);
    assert_eq!(b.complete(B, 2), [accept(2), emit(B, 4, 2, range(0, 10))]);
}

#[test]
fn a_task_that_fails_on_three_workers_fails_the_job_with_their_errors() {
    let mut b = Bench::with_job(policy(), 10, 1);
    assert_eq!(b.join(A)[1..], [emit(A, 1, 1, range(0, 10))]);
    b.join(B);
    b.join(C);
    assert_eq!(b.fail(A, 1, "no memory"), [prepare(B), emit(B, 2, 2, range(0, 10))]);
    assert_eq!(b.fail(B, 2, "no texture"), [prepare(C), emit(C, 3, 3, range(0, 10))]);
    let said = b.fail(C, 3, "no luck");
    let Some(Command::Finish { outcome: Outcome::Failed(text), .. }) = said.last() else { panic!("{said:?}") };
    for part in ["[0, 10)", "worker 1: no memory", "worker 2: no texture", "worker 3: no luck"] {
        assert!(text.contains(part), "{text}");
    }
}

#[test]
fn a_lone_worker_may_try_again_after_a_while_until_the_third_failure() {
    let mut b = Bench::with_job(policy(), 10, 1);
    b.join(A);
    let later = |b: &mut Bench, s| {
        b.now = seconds(s);
        b.event(Event::Heard { worker: A })
    };
    assert_eq!(b.fail(A, 1, "x"), []);
    // Others get some time to turn up.
    assert_eq!(later(&mut b, 9), []);
    assert_eq!(later(&mut b, 10), [emit(A, 2, 2, range(0, 10))]);
    assert_eq!(b.fail(A, 2, "x"), []);
    assert_eq!(later(&mut b, 20), [emit(A, 3, 3, range(0, 10))]);
    assert!(matches!(b.fail(A, 3, "x").last(), Some(Command::Finish { outcome: Outcome::Failed(_), .. })));
}

#[test]
fn a_worker_that_fails_three_tasks_is_set_aside() {
    let mut b = Bench::with_job(policy(), 1_000, 1);
    b.join(A);
    b.join(B);
    assert_eq!(b.fail(A, 1, "x"), [emit(A, 3, 1, range(20, 30))]);
    assert_eq!(b.fail(A, 3, "x"), [emit(A, 4, 1, range(30, 40))]);
    assert_eq!(b.fail(A, 4, "x"), []);
    assert!(b.scheduler.workers()[&A].is_set_aside(JOB, 3));
    // B does all of it.
    assert!(b.run_to_end().contains(&finish(Outcome::Done)));
}

#[test]
fn when_every_worker_is_set_aside_the_job_fails() {
    let mut b = Bench::with_job(Policy { max_failures: 9, ..policy() }, 1_000, 1);
    b.join(A);
    b.join(B);
    let mut last = Vec::new();
    for _ in 0..6 {
        let open: Vec<_> = b.scheduler.leases().map(|l| (l.worker, l.lease.id.0)).collect();
        open.iter().for_each(|&(w, l)| last.extend(b.fail(w, l, "bad disk")));
    }
    assert!([A, B].iter().all(|w| b.scheduler.workers()[w].is_set_aside(JOB, 3)));
    for s in 0..=10 {
        b.now = seconds(s);
        for worker in [A, B] {
            b.event(Event::Heard { worker });
        }
        assert!(!last.iter().any(|c| matches!(c, Command::Finish { .. })), "after {s} s");
        last.extend(b.event(Event::Tick));
    }
    let ended = last.iter().find_map(|c| match c {
        Command::Finish { outcome: Outcome::Failed(text), .. } => Some(text.clone()),
        _ => None,
    });
    assert!(ended.as_ref().is_some_and(|t| t.contains("every worker") && t.contains("bad disk")), "{ended:?}");
}

#[test]
fn a_task_that_takes_its_workers_with_it_fails_the_job() {
    let mut b = Bench::with_job(policy(), 10, 1);
    let mut last = Vec::new();
    for n in 0..policy().max_losses {
        let worker = WorkerId(100 + u64::from(n));
        b.join(worker);
        last = b.event(Event::Lost { worker });
    }
    assert!(matches!(last.last(), Some(Command::Finish { outcome: Outcome::Failed(_), .. })), "{last:?}");
}

#[test]
fn a_draining_worker_gets_nothing_more_and_its_returned_leases_go_on() {
    let mut b = Bench::with_job(Policy { leases_per_worker: 2, ..policy() }, 100, 1);
    b.join(A);
    assert_eq!(b.event(Event::Draining { worker: A }), []);
    assert_eq!(b.event(Event::Returned { worker: A, lease: LeaseId(2), attempt: 1 }), []);
    assert_eq!(b.complete(A, 1), [accept(1)]);
    assert_eq!(b.join(B)[..2], [prepare(B), emit(B, 3, 2, range(10, 20))]);
}

#[test]
fn cancelling_revokes_forgets_and_ends() {
    let mut b = Bench::with_job(policy(), 100, 1);
    b.join(A);
    let end = [
        Command::Revoke { worker: A, lease: LeaseId(1) },
        Command::Forget { worker: A, job: JOB },
        finish(Outcome::Cancelled),
    ];
    assert_eq!(b.event(Event::Cancelled { job: JOB }), end);
    assert_eq!(b.event(Event::Cancelled { job: JOB }), []);
    assert_eq!(b.event(result(A, 1, 1, range(0, 10))), [stale(1)]);
    assert_eq!(b.event(built(0, GLOBAL)), []);
}

#[test]
fn a_failed_step_of_the_coordinator_fails_the_job() {
    let mut b = Bench::with_job(policy(), 10, 1);
    b.join(A);
    b.complete(A, 1);
    let said = b.event(Event::StepFailed { job: JOB, error: "disk full".into() });
    assert_eq!(said.last(), Some(&finish(Outcome::Failed("disk full".into()))));
}

#[test]
fn several_jobs_take_turns() {
    let mut b = Bench::new(policy());
    let jobs = [JobId(1), JobId(2)];
    for job in jobs {
        let phases = vec![Phase::Gather { round: 0, tiles: 100 }];
        b.event(submitted(job, phases));
    }
    b.join(A);
    let mut got = Vec::new();
    for id in 1..=6 {
        got.push(b.scheduler.lease(LeaseId(id)).expect("is open").lease.job);
        b.complete(A, id);
    }
    assert_eq!(got, [jobs, jobs, jobs].concat());
}

#[test]
fn every_worker_gets_one_lease_before_any_gets_two() {
    let mut b = Bench::new(Policy { leases_per_worker: 2, ..policy() });
    b.join(A);
    b.join(B);
    let phases = vec![Phase::Gather { round: 0, tiles: 8 }];
    let said = b.event(submitted(JOB, phases));
    let order: Vec<_> =
        said.iter().filter_map(|c| if let Command::Assign { worker, .. } = c { Some(*worker) } else { None }).collect();
    assert_eq!(order, [A, B, A, B]);
}

#[test]
fn a_faster_worker_gets_larger_leases() {
    let mut b = Bench::with_job(Policy { leases_per_worker: 1, ..Policy::default() }, 1 << 30, 1);
    b.join(A);
    b.join(B);
    let done = |worker, lease, range, ms| {
        let busy = Duration::from_millis(ms);
        Event::Completed { worker, lease: LeaseId(lease), attempt: 1, range, busy, stored: 0, digest: Digest([9; 32]) }
    };
    let p = Policy::default().probe_paths;
    b.event(done(A, 1, range(0, p), 10));
    b.event(done(B, 2, range(p, 2 * p), 100));
    let size = |id| b.scheduler.lease(LeaseId(id)).map(|l| l.lease.range.len());
    assert_eq!((size(3), size(4)), (Some(p * 100), Some(p * 10)));
}

//! One job's work: what is handed out, what is done, what comes next.
//!
//! A job is its list of phases, cut into rounds. Phases are begun in order, and those of one round and the next are in
//! progress at once: the window.
//!
//! ```text
//!                          all indices done        input made, or round closed
//!  emission, bootstrap:  Working ───► Building ───► Complete
//!  sample map:           Working ───► Building ───► Complete      as soon as the round before is closed
//!  image of a round:     Working ───► Building ───► Complete
//!  image of only one:    Working ─────────────────► Complete
//!
//!                     all of round r complete:              after the last round,
//!                     its maps are retired                  or when a limit is reached
//!  the job:   round 0 ───► … ───► round r ───► round r + 1 ───► … ───► Assembling ───► Done
//!                └───────────────────┴─────────────┴───────────────────────┴─────────► Failed | Cancelled
//! ```
//! - The image of a round is made by a gather or a splat. An emission or bootstrap is open as soon as it is in the window; a gather
//!   or splat once all maps of its round and the bootstrap are built and nothing of the one before it is left to hand out.
//! - A gather reads the latest maps: those of its own round, or of the last round before it that had any.
//! - A sample map is made of the rounds that are closed; the gathers from its round on wait for it, and read it.
//! - Rounds are closed in order. What is computed of a round before the one before it is closed waits for that.
//! - Open phases are handed out in order: the next one gives work only where nothing of those before is left. So one map
//!   is merged while the next is traced, and the photons of a round are traced while the tiles of the one before are
//!   finished.
//! - Emission is at most one round ahead of the gather. So there are never more than two rounds' photons anywhere, however
//!   many rounds there are.
//! - A limit ends the job between two rounds.

use super::Reason;
use super::saved::Saved;
use super::work::{Kind, Retry, Total, Work};
use core::time::Duration;
use gatherlight_proto::message::{BlobRef, InputRef, MapRef, Task};
use gatherlight_proto::types::{JobId, Limit, Limits};
use gatherlight_render::job::Phase;
use gatherlight_render::photon::{EmissionRange, MapKind};
use std::collections::{BTreeMap, VecDeque};

/// State of a phase in the window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Indices are missing.
    Working,
    /// The coordinator joins the results, or closes the round.
    Building,
    /// All is done; workers may fetch what was made of it.
    Complete(Option<InputRef>),
}

/// A phase in the window.
#[derive(Clone, Debug)]
pub struct Step {
    /// Its indices.
    pub work: Work,
    /// Its state.
    pub stage: Stage,
}

impl Step {
    /// Its round.
    pub fn round(&self) -> u32 {
        self.work.phase.round()
    }
    fn is_complete(&self) -> bool {
        matches!(self.stage, Stage::Complete(_))
    }
}

/// A job that has not ended.
#[derive(Clone, Debug)]
pub struct Job {
    /// Its id.
    pub id: JobId,
    phases: Vec<Phase>,
    window: VecDeque<Step>,
    /// Index of the window's first phase in `phases`.
    first: usize,
    /// All rounds that will be are there: the coordinator puts the image together.
    assembling: bool,
    limits: Limits,
    submitted: Duration,
    totals: BTreeMap<Kind, Total>,
    /// Of them, those of closed rounds.
    closed: BTreeMap<Kind, Total>,
    rounds_done: u32,
    /// What an earlier coordinator did of phases that are not in the window yet.
    saved: Saved,
    /// Maps of rounds that are over, which later rounds read too.
    kept: Vec<MapRef>,
    /// The bootstrap, which all rounds read.
    bootstrap: Option<BlobRef>,
    /// The sample map, which all rounds from its own on read.
    sample_map: Option<BlobRef>,
    /// The image is as good as was asked for.
    is_good_enough: bool,
    /// The time limit is reached.
    is_late: bool,
    ended_by: Option<Limit>,
    /// Whose turn it is: higher ones before lower ones.
    pub priority: i32,
    /// Memory a worker needs for it, bytes.
    pub worker_bytes: u64,
    /// Results that two workers gave and that differ.
    pub disputes: u64,
    /// Leases handed out again so far, after those who had them were lost or late, failed or gave them back.
    pub retried: u64,
    /// Leases given to a second worker so far while the first one had them.
    pub repeated: u64,
    /// Workers that were given work so far.
    pub workers: u32,
    /// Of them, those that were lost before the job ended.
    pub workers_lost: u32,
    /// Since when every worker that is there is set aside.
    pub stuck_since: Option<Duration>,
}

/// What a job brings beside its phases. By default it is new, of no particular priority, and fits any worker.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Terms {
    /// When to end it early.
    pub limits: Limits,
    /// Whose turn it is: higher ones before lower ones.
    pub priority: i32,
    /// Memory a worker needs for it, bytes.
    pub worker_bytes: u64,
    /// Time since its submission.
    pub age: Duration,
    /// What is done of it.
    pub saved: Saved,
}

/// What the image is made of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Done {
    /// Rounds.
    pub rounds: u32,
    /// Units of their splat phases.
    pub units: u64,
    /// The limit that ended it before all rounds and units were done.
    pub ended_by: Option<Limit>,
}

/// What a job wants of the coordinator after a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Nothing new.
    Nothing,
    /// Join the results of this emission or bootstrap phase, make the sample map, or close the round of this gather or splat.
    Build(Phase),
    /// Drop the maps of this round.
    Retire(u32),
    /// Put the image together; leases that are still out are not wanted any more.
    Assemble(Done),
}

/// Whether a job with these phases has several rounds: they are closed one by one, can be compared, and the job can end between them.
pub fn closes_rounds(phases: &[Phase]) -> bool {
    phases.iter().filter(|p| p.makes_image()).nth(1).is_some()
}

/// Whether the phases are rounds 0, 1, …, each of emissions with a gather behind them, or of a splat; with or without a bootstrap
/// in the first.
fn make_sense(phases: &[Phase]) -> bool {
    let mut rounds = 0;
    let ordered = phases.chunk_by(|a, b| a.round() == b.round()).all(|round| {
        let number = rounds;
        rounds += 1;
        round.first().is_some_and(|p| p.round() == number) && is_round(round)
    });
    ordered && rounds > 0
}

fn is_round(round: &[Phase]) -> bool {
    let place = |p: &dyn Fn(&Phase) -> bool| round.iter().position(p);
    let count = |kind: Kind| round.iter().filter(|&&p| Kind::of(p) == kind).count();
    let has_splat = count(Kind::Splat) > 0;
    round.iter().all(|&p| count(Kind::of(p)) == 1)
        && place(&|p| p.makes_image()) == round.len().checked_sub(1)
        && MapKind::ALL.iter().all(|&m| count(Kind::Emission(m)) == 0 || !has_splat)
        && (count(Kind::Bootstrap) == 0 || has_splat)
        && (count(Kind::SampleMap) == 0 || (!has_splat && round.iter().all(|p| p.round() > 0)))
}

impl Job {
    /// `None` when the phases make no job, or what is saved is none of it. Nothing is open before [`Job::advance`].
    pub fn new(id: JobId, phases: Vec<Phase>, terms: Terms, now: Duration) -> Option<Self> {
        let Terms { limits, priority, worker_bytes, age, mut saved } = terms;
        let first = phases.iter().position(|p| p.round() >= saved.rounds)?;
        let mut job = Job {
            id,
            window: VecDeque::new(),
            first,
            assembling: false,
            limits,
            submitted: now.saturating_sub(age),
            totals: saved.totals.clone(),
            closed: std::mem::take(&mut saved.totals),
            rounds_done: saved.rounds,
            kept: Vec::new(),
            bootstrap: None,
            sample_map: None,
            is_good_enough: false,
            is_late: false,
            ended_by: None,
            priority,
            worker_bytes,
            disputes: 0,
            retried: 0,
            repeated: 0,
            workers: 0,
            workers_lost: 0,
            stuck_since: None,
            saved: Saved::default(),
            phases,
        };
        if !make_sense(&job.phases) {
            return None;
        }
        let later = saved.inputs.split_off(&first);
        for (input, _) in std::mem::replace(&mut saved.inputs, later).into_values() {
            match input {
                InputRef::Map(map) => job.kept.push(map),
                InputRef::Bootstrap(blob) => job.bootstrap = Some(blob),
                InputRef::SampleMap(blob) => job.sample_map = Some(blob),
            }
        }
        job.saved = saved;
        Some(job)
    }
    /// The phases in progress, in order.
    pub fn steps(&self) -> impl Iterator<Item = &Step> {
        self.window.iter()
    }
    /// The round that is worked on: the first one that is not complete.
    pub fn round(&self) -> u32 {
        self.window.front().map_or(self.rounds_done, Step::round)
    }
    /// Whether the coordinator puts the image together.
    pub fn is_assembling(&self) -> bool {
        self.assembling
    }
    /// What is done so far.
    pub fn done(&self) -> Done {
        Done { rounds: self.rounds_done, units: self.total(Kind::Splat).units, ended_by: self.ended_by }
    }
    /// Counts over the phases of closed rounds.
    pub fn closed_totals(&self) -> &BTreeMap<Kind, Total> {
        &self.closed
    }
    /// Indices done of all phases of a kind, in all rounds.
    pub fn total(&self, kind: Kind) -> Total {
        self.totals.get(&kind).copied().unwrap_or_default()
    }
    /// Photons stored per path so far, in all rounds.
    pub fn stored_per_unit(&self, kind: Kind) -> f64 {
        let Total { units, stored } = self.total(kind);
        if units == 0 { 0.0 } else { stored as f64 / units as f64 }
    }
    /// The phases with something to hand out, in order, by index.
    pub fn open_phases(&self) -> impl Iterator<Item = usize> + '_ {
        // A round that a limit is about to cut off is not worth beginning.
        let wanted = |round: u32| round == self.round() || !(self.is_late || self.is_good_enough);
        let open =
            move |&i: &usize| self.window[i].work.waiting() > 0 && wanted(self.window[i].round()) && self.is_open(i);
        (0..self.window.len()).filter(open).map(|i| self.first + i)
    }
    /// Whether what step `place` of the window reads is there.
    fn is_open(&self, place: usize) -> bool {
        let mut before = self.window.iter().take(place);
        match self.window[place].work.phase {
            Phase::Emission { .. } | Phase::Bootstrap { .. } | Phase::SampleMap { .. } => true,
            Phase::Gather { round, .. } | Phase::Splat { round, .. } => before.all(|s| match s.work.phase {
                Phase::Emission { round: r, .. } => s.is_complete() || r != round,
                Phase::Bootstrap { .. } | Phase::SampleMap { .. } => s.is_complete(),
                Phase::Gather { .. } | Phase::Splat { .. } => s.work.waiting() == 0,
            }),
        }
    }
    /// Index of a phase in the window.
    pub fn index_of(&self, phase: Phase) -> Option<usize> {
        self.window.iter().position(|s| s.work.phase == phase).map(|i| self.first + i)
    }
    /// Work of phase `index`, while it is in the window.
    pub fn work(&self, index: usize) -> Option<&Work> {
        index.checked_sub(self.first).and_then(|i| self.window.get(i)).map(|s| &s.work)
    }
    /// Work of phase `index`, while it is in the window.
    pub fn work_mut(&mut self, index: usize) -> Option<&mut Work> {
        index.checked_sub(self.first).and_then(|i| self.window.get_mut(i)).map(|s| &mut s.work)
    }
    /// What a worker is told to do with indices of phase `index`.
    pub fn task(&self, index: usize) -> Option<Task> {
        Some(match self.work(index)?.phase {
            Phase::Emission { round, map, .. } => Task::Emission { round, map },
            Phase::Bootstrap { .. } => Task::Bootstrap,
            Phase::Splat { round, .. } => Task::Splat { round, bootstrap: self.bootstrap },
            Phase::Gather { round, .. } => Task::Gather { round, maps: self.maps(round), sample_map: self.sample_map },
            // Nothing for workers to do.
            Phase::SampleMap { .. } => return None,
        })
    }
    /// The maps that a round reads, as far as they are built, in order.
    pub fn maps(&self, round: u32) -> Vec<MapRef> {
        let map = |s: &Step| if let Stage::Complete(Some(InputRef::Map(map))) = s.stage { Some(map) } else { None };
        let built = self.window.iter().filter(|s| s.round() <= round).filter_map(map);
        let latest: BTreeMap<MapKind, MapRef> = self.kept.iter().copied().chain(built).map(|m| (m.kind, m)).collect();
        latest.into_values().collect()
    }
    /// Counts indices of phase `index` as done.
    pub fn completed(&mut self, index: usize, range: EmissionRange, stored: u64) {
        let Some(work) = self.work_mut(index) else { return };
        let new = work.done.insert(range);
        debug_assert!(new, "an open lease never covers what is done");
        work.stored += stored;
        let kind = Kind::of(work.phase);
        let total = self.totals.entry(kind).or_default();
        total.units += range.len();
        total.stored += stored;
    }
    /// Counts a lease that is handed out.
    pub fn handed_out(&mut self, reason: Reason) {
        match reason {
            Reason::Fresh => {}
            Reason::Retry => self.retried += 1,
            Reason::Repeat => self.repeated += 1,
        }
    }
    /// Puts indices of phase `index` up to be leased again.
    pub fn take_back(&mut self, index: usize, retry: Retry) {
        if let Some(work) = self.work_mut(index) {
            work.retries.push(retry);
        }
    }
    /// Takes one step that is due after something was done, or time has passed. To be called until it returns
    /// [`Next::Nothing`].
    pub fn advance(&mut self, now: Duration) -> Next {
        if self.assembling {
            return Next::Nothing;
        }
        self.is_late = self.is_time_over(now);
        self.begin();
        let (first, closes_rounds) = (self.round(), closes_rounds(&self.phases));
        for step in self.window.iter_mut().filter(|s| s.stage == Stage::Working && s.work.is_complete()) {
            match step.work.phase {
                phase @ (Phase::Emission { .. } | Phase::Bootstrap { .. }) => {
                    step.stage = Stage::Building;
                    return Next::Build(phase);
                }
                phase @ (Phase::Gather { .. } | Phase::Splat { .. } | Phase::SampleMap { .. }) if closes_rounds => {
                    if phase.round() == first {
                        step.stage = Stage::Building;
                        return Next::Build(phase);
                    }
                }
                Phase::Splat { .. } | Phase::Gather { .. } | Phase::SampleMap { .. } => {
                    step.stage = Stage::Complete(None)
                }
            }
        }
        self.end_round(now)
    }
    /// Moves the window on to the phases of the present round and the next.
    fn begin(&mut self) {
        let round = self.round();
        while let Some(&phase) = self.phases.get(self.first + self.window.len()) {
            if phase.round() > round + 1 {
                return;
            }
            let (work, input) = self.saved.take(self.first + self.window.len(), phase);
            self.totals.entry(Kind::of(phase)).or_default().add(&work);
            match input {
                Some(InputRef::Bootstrap(blob)) => self.bootstrap = Some(blob),
                Some(InputRef::SampleMap(blob)) => self.sample_map = Some(blob),
                Some(InputRef::Map(_)) | None => {}
            }
            let stage = input.map_or(Stage::Working, |input| Stage::Complete(Some(input)));
            self.window.push_back(Step { work, stage });
        }
    }
    /// Drops the present round from the window, if all of it is complete.
    fn end_round(&mut self, now: Duration) -> Next {
        let round = self.round();
        if self.window.iter().any(|s| s.round() == round && !s.is_complete()) {
            return Next::Nothing;
        }
        let maps = self.maps(round);
        while let Some(step) = self.window.pop_front_if(|s| s.round() == round) {
            self.rounds_done += u32::from(step.work.phase.makes_image());
            self.closed.entry(Kind::of(step.work.phase)).or_default().add(&step.work);
            self.first += 1;
        }
        if self.first < self.phases.len() {
            let limit =
                if self.is_good_enough { Some(Limit::Error) } else { self.is_time_over(now).then_some(Limit::Time) };
            if limit.is_none() {
                let next = self.phases[self.first..].iter().take_while(|p| p.round() == round + 1);
                if next.filter(|p| matches!(p, Phase::Emission { .. })).count() > 0 {
                    self.kept.clear();
                    return Next::Retire(round);
                }
                self.kept = maps;
                return self.advance(now);
            }
            self.ended_by = limit;
            self.drop_window();
        }
        self.assembling = true;
        Next::Assemble(self.done())
    }
    /// Forgets the round that was begun and will not be finished.
    fn drop_window(&mut self) {
        for step in self.window.drain(..) {
            if let Some(total) = self.totals.get_mut(&Kind::of(step.work.phase)) {
                total.units -= step.work.done.units();
                total.stored -= step.work.stored;
            }
        }
    }
    /// Whether the time limit is reached.
    fn is_time_over(&self, now: Duration) -> bool {
        self.limits.time.is_some_and(|limit| now.saturating_sub(self.submitted) >= limit)
    }
    /// Notes that a round is closed, and whether the image is as good as was asked for. Returns whether that was awaited.
    pub fn closed(&mut self, round: u32, is_good_enough: bool) -> bool {
        let is_it = |s: &&mut Step| s.stage == Stage::Building && s.round() == round && s.work.phase.makes_image();
        let Some(step) = self.window.iter_mut().find(is_it) else { return false };
        step.stage = Stage::Complete(None);
        self.is_good_enough = is_good_enough;
        true
    }
    /// Notes that the input made of a phase of `round` is there. Returns whether that was awaited.
    pub fn built(&mut self, round: u32, input: InputRef) -> bool {
        let kind = match input {
            InputRef::Map(map) => Kind::Emission(map.kind),
            InputRef::Bootstrap(_) => Kind::Bootstrap,
            InputRef::SampleMap(_) => Kind::SampleMap,
        };
        let is_it = |s: &&mut Step| s.stage == Stage::Building && s.round() == round && Kind::of(s.work.phase) == kind;
        let Some(step) = self.window.iter_mut().find(is_it) else { return false };
        step.stage = Stage::Complete(Some(input));
        match input {
            InputRef::Bootstrap(blob) => self.bootstrap = Some(blob),
            InputRef::SampleMap(blob) => self.sample_map = Some(blob),
            InputRef::Map(_) => {}
        }
        true
    }
}

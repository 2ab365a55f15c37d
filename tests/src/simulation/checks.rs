//! What must hold whatever happens: every index counts once, rounds are whole, and images are made of what was counted.

use super::{Due, World};
use gatherlight::schedule::{Event, Outcome};
use gatherlight::types::JobId;
use gatherlight_proto::Digest;
use gatherlight_proto::message::{BlobRef, InputRef, LeaseId, MapRef};
use gatherlight_render::job::Phase;
use gatherlight_render::photon::EmissionRange;
use std::collections::BTreeMap;

/// One phase of one job: how often each index was accepted, as disjoint intervals.
#[derive(Default)]
pub(super) struct Counted {
    accepted: BTreeMap<u64, u64>,
}

impl Counted {
    fn add(&mut self, range: EmissionRange, seed: u64) {
        let before = self.accepted.range(..range.end).next_back();
        assert!(before.is_none_or(|(_, &end)| end <= range.first), "seed {seed}: {range:?} counted twice");
        self.accepted.insert(range.first, range.end);
    }
    fn total(&self) -> u64 {
        self.accepted.iter().map(|(first, end)| end - first).sum()
    }
}

impl World<'_> {
    pub(super) fn accept(&mut self, lease: LeaseId, completed: Option<&(LeaseId, JobId, usize, EmissionRange)>) {
        let Some((id, job, phase, range)) = completed else { panic!("seed {}: accepted nothing", self.seed) };
        assert_eq!(*id, lease, "seed {}", self.seed);
        self.counted.entry((*job, *phase)).or_default().add(*range, self.seed);
        let window = self.scheduler.job(*job).map_or(0, |j| j.steps().count());
        self.report.widest_window = self.report.widest_window.max(window);
    }

    pub(super) fn build(&mut self, job: JobId, phase: Phase) {
        let index = self.phases[job.0 as usize].iter().position(|p| *p == phase);
        self.assert_complete(job, index.unwrap_or_else(|| panic!("seed {}: {phase:?} is no phase", self.seed)));
        let digest = Digest([job.0 as u8; 32]);
        let round = phase.round();
        let input = match phase {
            Phase::Emission { map, .. } => Some(InputRef::Map(MapRef { kind: map, digest, bytes: 1 })),
            Phase::Bootstrap { .. } => Some(InputRef::Bootstrap(BlobRef { digest, bytes: 1 })),
            Phase::SampleMap { .. } => Some(InputRef::SampleMap(BlobRef { digest, bytes: 1 })),
            Phase::Gather { .. } | Phase::Splat { .. } => None,
        };
        let number = self.next_entry;
        let event = match input {
            Some(input) => Event::Built { job, round, input },
            None => {
                let closed = self.closed.entry(job).or_default();
                assert_eq!(*closed, round, "seed {}: job {job} closes rounds out of order", self.seed);
                *closed += 1;
                let is_good_enough = self.conditions.good_after.is_some_and(|rounds| *closed >= rounds);
                Event::Closed { job, round, is_good_enough }
            }
        };
        self.to_scheduler.insert(number, event);
        let at = self.now + self.build_time(job, phase) + self.delay();
        self.plan(at, Due::Report(number));
    }

    /// Every index of the phase counted exactly once.
    fn assert_complete(&self, job: JobId, phase: usize) {
        let wanted = self.phases[job.0 as usize][phase].units();
        let counted = self.counted.get(&(job, phase)).map_or(0, Counted::total);
        assert_eq!(counted, wanted, "seed {}: job {job}, phase {phase}", self.seed);
    }

    pub(super) fn assert_round_complete(&self, job: JobId, round: u32) {
        let phases = self.phases[job.0 as usize].iter().enumerate();
        phases.filter(|(_, p)| p.round() == round).for_each(|(i, _)| self.assert_complete(job, i));
    }

    /// The image is made of whole rounds, and of as many units as were counted; of all, unless a limit ended the job.
    fn assert_image(&mut self, job: JobId) {
        let Some(&done) = self.made_of.get(&job) else { panic!("seed {}: job {job} was not put together", self.seed) };
        let images = || self.phases[job.0 as usize].iter().filter(|p| p.makes_image());
        let rounds = images().count() as u32;
        if done.ended_by.is_none() {
            assert_eq!(done.rounds, rounds, "seed {}: job {job}", self.seed);
        }
        if let (Some(most), true) = (self.conditions.good_after, rounds > 1) {
            assert!(done.rounds <= most, "seed {}: job {job} has {} rounds", self.seed, done.rounds);
        }
        assert!(done.rounds <= rounds && done.rounds > 0, "seed {}: job {job}", self.seed);
        let made_of = images().filter(|p| p.round() < done.rounds && matches!(p, Phase::Splat { .. }));
        assert_eq!(done.units, made_of.map(Phase::units).sum::<u64>(), "seed {}: job {job}", self.seed);
        let made_of = self.phases[job.0 as usize].iter().enumerate();
        made_of
            .filter(|(_, p)| p.makes_image() && p.round() < done.rounds)
            .for_each(|(i, _)| self.assert_complete(job, i));
        self.report.cut_off += usize::from(done.ended_by.is_some());
        self.report.rounds += u64::from(done.rounds);
    }

    pub(super) fn ended(&mut self, job: JobId, outcome: &Outcome) {
        assert!(self.open.remove(&job), "seed {}: job {job} ended twice", self.seed);
        match outcome {
            Outcome::Done => self.assert_image(job),
            Outcome::Failed(reason) => {
                assert!(self.conditions.may_fail, "seed {}: job {job} failed: {reason}", self.seed);
                assert!(reason.contains("virtual failure"), "seed {}: {reason}", self.seed);
                self.report.failed += 1;
            }
            Outcome::Cancelled => panic!("seed {}: nobody cancelled job {job}", self.seed),
        }
        if self.open.is_empty() {
            self.report.elapsed = self.now;
        }
    }
}

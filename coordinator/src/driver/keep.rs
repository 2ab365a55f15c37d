//! What is kept of jobs in the store, and for how long.

use super::Driver;
use super::handle::{Input, Reply};
use super::job::{JobRecord, since_1970};
use super::resume::{self, Resumed};
use super::steps::{flat, report};
use crate::room::Room;
use crate::schedule::Outcome;
use crate::store::journal::{Change, SavedInput, SavedResult, SavedRounds};
use crate::types::JobId;
use bytes::Bytes;
use gatherlight_proto::Digest;
use gatherlight_proto::stored::{StoredJob, StoredRounds};
use gatherlight_render::job::Phase;
use std::collections::BTreeSet;
use std::time::Duration;

/// Time between two collections of old blobs.
const COLLECT_EVERY: Duration = Duration::from_secs(60);

impl Driver {
    /// Lists the jobs that an earlier driver left in the store, and goes on with those that had not ended.
    pub(super) fn take_over(&mut self) {
        let jobs = match self.store.journal().map(|j| j.jobs()) {
            None => return,
            Some(Ok(jobs)) => jobs,
            Some(Err(error)) => return tracing::error!(%error, "the store's jobs cannot be read"),
        };
        let mut left = Vec::new();
        for (id, record) in jobs {
            match StoredJob::decode(&record) {
                Ok(job) => left.push((id, job)),
                Err(error) => tracing::error!(job = %id, %error, "a job in the store makes no sense and is left out"),
            }
        }
        left.sort_by_key(|(id, job)| (job.submitted, *id));
        let today = since_1970();
        let age = |job: &StoredJob| match job.last {
            Some(_) => Duration::ZERO,
            None => today.saturating_sub(job.submitted),
        };
        self.before = left.iter().map(|(_, job)| age(job)).max().unwrap_or_default();
        for (id, mut job) in left {
            let ended = job.last.is_some();
            job.restarts += u32::from(!ended);
            let record = JobRecord::new(id, job.clone(), age(&job), self.now());
            self.jobs.insert(id, record);
            self.order.push(id);
            if !ended {
                tracing::info!(job = %id, name = job.submission.name, restarts = job.restarts, "goes on after a restart");
                self.note(id, Change::Job(job.encode()));
                let (store, own) = (self.store.clone(), self.own.clone());
                self.compute.spawn(
                    move || resume::resume(&store, id, &job),
                    move |resumed| report(&own, Input::Resumed(id, flat(resumed))),
                );
            }
        }
        self.forget_old_jobs();
    }

    /// Goes on with a job.
    pub(super) fn resumed(&mut self, id: JobId, resumed: Result<Box<Resumed>, String>) {
        if self.jobs.get(&id).is_none_or(JobRecord::is_final) {
            return;
        }
        let resumed = match resumed {
            Ok(resumed) => *resumed,
            Err(error) => {
                return self.finish(id, Outcome::Failed(format!("it could not go on after a restart: {error}")));
            }
        };
        let Resumed { spec, start, damaged, starts_anew } = resumed;
        if damaged > 0 {
            tracing::warn!(job = %id, damaged, "parts of the job were damaged in the store and are computed again");
        }
        if starts_anew && let Some(job) = self.jobs.get_mut(&id) {
            tracing::warn!(job = %id, program = job.stored.program, "what another version computed is computed again");
            job.stored.program = gatherlight_render::VERSION.to_owned();
            let record = job.stored.encode();
            self.note(id, Change::Restarted);
            self.note(id, Change::Job(record));
        }
        self.begin(id, spec, start);
    }

    /// Notes a change in the journal, where there is one.
    pub(super) fn note(&self, id: JobId, change: Change) {
        if let Some(journal) = self.store.journal() {
            journal.note(id, change, None);
        }
    }

    /// As [`Driver::note`]; `done` hears when it is safe.
    pub(super) fn note_then(&self, id: JobId, change: Change, done: impl FnOnce(Result<(), String>) + Send + 'static) {
        match self.store.journal() {
            Some(journal) => journal.note(id, change, Some(Box::new(done))),
            None => done(Ok(())),
        }
    }

    /// Notes a result that counts. A disk that fails makes it no worse a result.
    pub(super) fn note_result(&mut self, id: JobId, result: SavedResult, room: Room, reply: Reply<bool>) {
        if let Some(job) = self.jobs.get_mut(&id) {
            job.noted_bytes += result.payload.len() as u64;
        }
        self.note_then(id, Change::Result(result), move |_| {
            drop(room);
            let _ = reply.send(true);
        });
    }

    /// Notes what was made of a phase.
    pub(super) fn note_input(&mut self, id: JobId, phase: Phase, gather_radius: f32, payload: Bytes) {
        let Some(counts) = self.scheduler.job(id) else { return };
        let Some(index) = counts.index_of(phase) else { return };
        let stored = counts.work(index).map_or(0, |w| w.stored);
        if let Some(job) = self.jobs.get_mut(&id) {
            job.noted_bytes += payload.len() as u64;
        }
        self.note(id, Change::Input(SavedInput { phase: index, stored, gather_radius, payload }));
    }

    /// Notes the film of all closed rounds, which stands for all that was noted of them.
    pub(super) fn note_rounds(&mut self, id: JobId, film: Vec<u8>) {
        let Some((job, counts)) = self.jobs.get_mut(&id).zip(self.scheduler.job(id)) else { return };
        let rounds = counts.done().rounds;
        let stats = job.keep_stats(rounds, counts).clone();
        let Some(live) = job.live.as_ref() else { return };
        let first = live.phases.iter().take_while(|p| p.round() < rounds).count();
        let kept = live.kept_inputs(rounds);
        let counts = StoredRounds { stats, gather_radii: live.about.gather_radii.clone() }.encode().into();
        job.noted_bytes = 0;
        let saved = SavedRounds { rounds, counts, film: film.into() };
        self.note(id, Change::Rounds { saved, first, kept });
    }

    /// Blobs that jobs refer to.
    fn referenced(&self) -> BTreeSet<Digest> {
        let scenes = self.jobs.values().filter(|j| !j.is_final()).flat_map(|j| j.stored.submission.manifest.blobs());
        let images = self.jobs.values().filter_map(|j| j.image);
        scenes.chain(images).map(|b| b.digest).collect()
    }

    /// Collects old blobs, if the store lacks room for `bytes` more.
    pub(super) fn make_room(&mut self, bytes: u64, reply: Reply<()>) {
        let done = move || {
            let _ = reply.send(());
        };
        if self.store.lacks_room(bytes) { self.collect(bytes, done) } else { done() }
    }

    /// Collects old blobs before the store is full.
    pub(super) fn collect_now_and_then(&mut self) {
        let reserve = self.store.limit_bytes() / 4;
        if self.now().saturating_sub(self.collected) >= COLLECT_EVERY && self.store.lacks_room(reserve) {
            self.collect(reserve, || {});
        }
    }

    fn collect(&mut self, bytes: u64, done: impl FnOnce() + Send + 'static) {
        self.collected = self.now();
        let (store, wanted) = (self.store.clone(), self.referenced());
        self.compute.spawn(move || store.collect(&wanted, bytes), move |_| done());
    }
}

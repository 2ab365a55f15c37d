//! What running jobs would lose with this process: an embedded database that survives a kill at any moment, power cuts included.
//!
//! It holds each job as it was submitted, the results that count, what was made of them, and now and then the film of all closed
//! rounds, which stands for everything before it. Any part of the results may be missing: what is not there is computed again.
//! One thread writes; what has come in while it waited for the disk is committed together, and only then are the workers told
//! that their results were taken.

use bytes::Bytes;
use gatherlight_proto::Digest;
use gatherlight_proto::types::JobId;
use gatherlight_render::photon::EmissionRange;
use redb::{Database, ReadableDatabase, ReadableTable, TableDefinition, WriteTransaction};
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Memory for pages of the database.
const CACHE_BYTES: usize = 64 << 20;
/// Bytes of results that are committed together at most.
const BATCH_BYTES: u64 = 64 << 20;

type Hash = [u8; 32];
type ResultEntry = (u64, u64, Hash, &'static [u8]);
type InputEntry = (u64, f32, Hash, &'static [u8]);
type RoundsEntry = (u32, &'static [u8], Hash, &'static [u8]);
/// Job → [`StoredJob`](gatherlight_proto::stored::StoredJob).
const JOBS: TableDefinition<u64, &[u8]> = TableDefinition::new("jobs");
/// Job, phase, first index → end, microseconds of computing, digest and bytes of the result.
const RESULTS: TableDefinition<(u64, u32, u64), ResultEntry> = TableDefinition::new("results");
/// Job, phase → photons, gather radius, digest and bytes of what was made of it.
const INPUTS: TableDefinition<(u64, u32), InputEntry> = TableDefinition::new("inputs");
/// Job → closed rounds, [`StoredRounds`](gatherlight_proto::stored::StoredRounds), digest and bytes of the film.
const ROUNDS: TableDefinition<u64, RoundsEntry> = TableDefinition::new("rounds");

/// A result that counts.
#[derive(Clone, Debug, PartialEq)]
pub struct SavedResult {
    /// Index of its phase within the job.
    pub phase: usize,
    /// Its indices.
    pub range: EmissionRange,
    /// Time of computing.
    pub busy: Duration,
    /// As the worker sent it.
    pub payload: Bytes,
}

/// What was made of a phase's results.
#[derive(Clone, Debug, PartialEq)]
pub struct SavedInput {
    /// Index of its phase within the job.
    pub phase: usize,
    /// Photons in it.
    pub stored: u64,
    /// Largest gather radius, in world units; 0 where it has none.
    pub gather_radius: f32,
    /// As workers read it.
    pub payload: Bytes,
}

/// The film of all rounds closed so far.
#[derive(Clone, Debug, PartialEq)]
pub struct SavedRounds {
    /// Their number.
    pub rounds: u32,
    /// Counts over them, encoded.
    pub counts: Bytes,
    /// The film, encoded.
    pub film: Bytes,
}

/// Everything kept of a job that has not ended.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SavedWork {
    /// The closed rounds, where they were kept.
    pub rounds: Option<SavedRounds>,
    /// In order of phase.
    pub inputs: Vec<SavedInput>,
    /// In order of phase and index.
    pub results: Vec<SavedResult>,
    /// Entries that were damaged and are left out.
    pub damaged: usize,
}

/// A change to what is kept.
#[derive(Debug)]
pub enum Change {
    /// A job is there, or its record has changed.
    Job(Vec<u8>),
    /// A result counts.
    Result(SavedResult),
    /// Something was made of a phase: its results are not needed any more.
    Input(SavedInput),
    /// Rounds were closed: phases before `first` are not needed any more, but inputs of those in `kept`.
    Rounds {
        /// The film.
        saved: SavedRounds,
        /// The first phase of the next round.
        first: usize,
        /// Phases before it whose inputs later rounds read.
        kept: Vec<usize>,
    },
    /// The job has ended, with this record.
    Ended(Vec<u8>),
    /// Nothing of the job is needed any more.
    Forgotten,
    /// What is kept of the job's work is of no use.
    Restarted,
}

/// Hears whether a change is safe.
type Done = Box<dyn FnOnce(Result<(), String>) + Send>;

enum Message {
    Change(JobId, Change, Option<Done>),
    Stop,
}

/// The database and its writer.
#[derive(Debug)]
pub struct Journal {
    database: Arc<Database>,
    changes: Mutex<Sender<Message>>,
    healthy: Arc<AtomicBool>,
    writer: Option<std::thread::JoinHandle<()>>,
}

fn other(error: impl std::fmt::Display) -> io::Error {
    io::Error::other(error.to_string())
}

impl Journal {
    /// Opens or makes the database at `path`.
    ///
    /// # Errors
    /// When it cannot be made, read or written, is damaged, or another process has it open.
    pub fn open(path: &Path) -> io::Result<Self> {
        let database = Database::builder().set_cache_size(CACHE_BYTES).create(path).map_err(|e| match e {
            redb::DatabaseError::DatabaseAlreadyOpen => other("another coordinator has it open"),
            e => other(format!("{}: {e}; move it away to start without the jobs in it", path.display())),
        })?;
        let transaction = database.begin_write().map_err(other)?;
        transaction.open_table(JOBS).map_err(other)?;
        transaction.open_table(RESULTS).map_err(other)?;
        transaction.open_table(INPUTS).map_err(other)?;
        transaction.open_table(ROUNDS).map_err(other)?;
        transaction.commit().map_err(other)?;
        let (database, healthy) = (Arc::new(database), Arc::new(AtomicBool::new(true)));
        let (changes, incoming) = channel();
        let (own, health) = (database.clone(), healthy.clone());
        let writer =
            std::thread::Builder::new().name("journal".into()).spawn(move || write_all(&own, &incoming, &health))?;
        Ok(Journal { database, changes: Mutex::new(changes), healthy, writer: Some(writer) })
    }
    /// Notes a change; `done` hears when it is safe, or why it is not.
    pub fn note(&self, job: JobId, change: Change, done: Option<Done>) {
        let changes = self.changes.lock().unwrap_or_else(PoisonError::into_inner);
        if let Err(refused) = changes.send(Message::Change(job, change, done))
            && let Message::Change(_, _, Some(done)) = refused.0
        {
            done(Err("the journal has ended".into()));
        }
    }
    /// Whether the last change could be written.
    pub fn is_healthy(&self) -> bool {
        self.healthy.load(Ordering::Relaxed)
    }
    /// All jobs: id and encoded record.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub fn jobs(&self) -> io::Result<Vec<(JobId, Vec<u8>)>> {
        let table = self.database.begin_read().map_err(other)?.open_table(JOBS).map_err(other)?;
        let entries = table.iter().map_err(other)?;
        entries.map(|e| e.map(|(id, job)| (JobId(id.value()), job.value().to_vec())).map_err(other)).collect()
    }
    /// What is kept of a job's work; what is damaged is left out.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub fn work(&self, JobId(job): JobId) -> io::Result<SavedWork> {
        let transaction = self.database.begin_read().map_err(other)?;
        let mut work = SavedWork::default();
        let mut sound = |digest: Hash, bytes: &[u8]| {
            let is_sound = Digest::of(bytes) == Digest(digest);
            work.damaged += usize::from(!is_sound);
            is_sound.then(|| Bytes::copy_from_slice(bytes))
        };
        let rounds = transaction.open_table(ROUNDS).map_err(other)?;
        if let Some(entry) = rounds.get(job).map_err(other)? {
            let (rounds, counts, digest, film) = entry.value();
            let counts = Bytes::copy_from_slice(counts);
            work.rounds = sound(digest, film).map(|film| SavedRounds { rounds, counts, film });
        }
        let inputs = transaction.open_table(INPUTS).map_err(other)?;
        for entry in inputs.range((job, 0)..=(job, u32::MAX)).map_err(other)? {
            let (key, value) = entry.map_err(other)?;
            let (phase, (stored, gather_radius, digest, bytes)) = (key.value().1 as usize, value.value());
            let input = sound(digest, bytes).map(|payload| SavedInput { phase, stored, gather_radius, payload });
            work.inputs.extend(input);
        }
        let results = transaction.open_table(RESULTS).map_err(other)?;
        for entry in results.range((job, 0, 0)..=(job, u32::MAX, u64::MAX)).map_err(other)? {
            let (key, value) = entry.map_err(other)?;
            let ((_, phase, first), (end, busy, digest, bytes)) = (key.value(), value.value());
            let result = sound(digest, bytes).map(|payload| SavedResult {
                phase: phase as usize,
                range: EmissionRange { first, end },
                busy: Duration::from_micros(busy),
                payload,
            });
            work.results.extend(result);
        }
        Ok(work)
    }
}

impl Drop for Journal {
    fn drop(&mut self) {
        drop(self.changes.lock().unwrap_or_else(PoisonError::into_inner).send(Message::Stop));
        if let Some(writer) = self.writer.take() {
            drop(writer.join());
        }
    }
}

fn write_all(database: &Database, incoming: &Receiver<Message>, healthy: &AtomicBool) {
    let mut stopping = false;
    while !stopping {
        let Ok(first) = incoming.recv() else { return };
        let mut batch = Vec::new();
        let (mut bytes, mut next) = (0, Some(first));
        while let Some(message) = next.take() {
            match message {
                Message::Stop => {
                    stopping = true;
                    break;
                }
                Message::Change(job, change, done) => {
                    bytes += change.bytes();
                    batch.push((job, change, done));
                }
            }
            next = if bytes < BATCH_BYTES { incoming.try_recv().ok() } else { None };
        }
        let (changes, waiting): (Vec<_>, Vec<_>) = batch.into_iter().map(|(job, c, done)| ((job, c), done)).unzip();
        let written = write(database, &changes).map_err(|e| e.to_string());
        if let Err(error) = &written
            && healthy.swap(false, Ordering::Relaxed)
        {
            tracing::error!(error, "the store cannot be written: jobs go on, but would not survive a restart");
        } else if written.is_ok() && !healthy.swap(true, Ordering::Relaxed) {
            tracing::info!("the store can be written again");
        }
        waiting.into_iter().flatten().for_each(|done| done(written.clone()));
    }
}

fn write(database: &Database, changes: &[(JobId, Change)]) -> Result<(), redb::Error> {
    let transaction = database.begin_write()?;
    for (job, change) in changes {
        apply(&transaction, job.0, change)?;
    }
    transaction.commit()?;
    Ok(())
}

fn apply(transaction: &WriteTransaction, job: u64, change: &Change) -> Result<(), redb::Error> {
    match change {
        Change::Job(record) => {
            transaction.open_table(JOBS)?.insert(job, &record[..])?;
        }
        Change::Result(SavedResult { phase, range, busy, payload }) => {
            let value = (range.end, busy.as_micros() as u64, Digest::of(payload).0, &payload[..]);
            transaction.open_table(RESULTS)?.insert((job, *phase as u32, range.first), value)?;
        }
        Change::Input(SavedInput { phase, stored, gather_radius, payload }) => {
            let phase = *phase as u32;
            let value = (*stored, *gather_radius, Digest::of(payload).0, &payload[..]);
            transaction.open_table(INPUTS)?.insert((job, phase), value)?;
            drop_results(transaction, (job, phase, 0), (job, phase, u64::MAX))?;
        }
        Change::Rounds { saved, first, kept } => {
            let SavedRounds { rounds, counts, film } = saved;
            let value = (*rounds, &counts[..], Digest::of(film).0, &film[..]);
            transaction.open_table(ROUNDS)?.insert(job, value)?;
            if let Some(last) = first.checked_sub(1) {
                drop_results(transaction, (job, 0, 0), (job, last as u32, u64::MAX))?;
                drop_inputs(transaction, (job, last as u32), |phase| !kept.contains(&(phase as usize)))?;
            }
        }
        Change::Ended(record) => {
            transaction.open_table(JOBS)?.insert(job, &record[..])?;
            drop_work(transaction, job)?;
        }
        Change::Forgotten => {
            transaction.open_table(JOBS)?.remove(job)?;
            drop_work(transaction, job)?;
        }
        Change::Restarted => drop_work(transaction, job)?,
    }
    Ok(())
}

fn drop_work(transaction: &WriteTransaction, job: u64) -> Result<(), redb::Error> {
    transaction.open_table(ROUNDS)?.remove(job)?;
    drop_inputs(transaction, (job, u32::MAX), |_| true)?;
    drop_results(transaction, (job, 0, 0), (job, u32::MAX, u64::MAX))
}

fn drop_inputs(
    transaction: &WriteTransaction,
    (job, last): (u64, u32),
    unwanted: impl Fn(u32) -> bool,
) -> Result<(), redb::Error> {
    transaction.open_table(INPUTS)?.retain_in((job, 0)..=(job, last), |(_, phase), _| !unwanted(phase))?;
    Ok(())
}

fn drop_results(
    transaction: &WriteTransaction,
    first: (u64, u32, u64),
    last: (u64, u32, u64),
) -> Result<(), redb::Error> {
    transaction.open_table(RESULTS)?.retain_in(first..=last, |_, _| false)?;
    Ok(())
}

impl Change {
    fn bytes(&self) -> u64 {
        let length = match self {
            Change::Job(record) | Change::Ended(record) => record.len(),
            Change::Result(result) => result.payload.len(),
            Change::Input(input) => input.payload.len(),
            Change::Rounds { saved, .. } => saved.film.len(),
            Change::Forgotten | Change::Restarted => 0,
        };
        length as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const JOB: JobId = JobId(7);

    fn safe(journal: &Journal, job: JobId, change: Change) {
        let (sender, receiver) = channel();
        journal.note(job, change, Some(Box::new(move |done| drop(sender.send(done)))));
        assert_eq!(receiver.recv(), Ok(Ok(())));
    }
    fn result(phase: usize, first: u64) -> SavedResult {
        let range = EmissionRange { first, end: first + 10 };
        SavedResult { phase, range, busy: Duration::from_micros(5), payload: Bytes::from(vec![first as u8; 100]) }
    }
    fn input(phase: usize) -> SavedInput {
        SavedInput { phase, stored: 3, gather_radius: 0.5, payload: Bytes::from_static(b"map") }
    }
    fn rounds(rounds: u32) -> SavedRounds {
        SavedRounds { rounds, counts: Bytes::from_static(b"counts"), film: Bytes::from_static(b"film") }
    }

    #[test]
    fn what_is_noted_is_there_after_opening_again_until_it_is_not_needed() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("jobs.redb");
        let open = || Journal::open(&path).unwrap_or_else(|e| panic!("{e}"));
        let journal = open();
        safe(&journal, JOB, Change::Job(vec![1, 2]));
        safe(&journal, JobId(8), Change::Result(result(0, 0)));
        for (phase, first) in [(0, 0), (0, 10), (1, 0), (2, 20)] {
            safe(&journal, JOB, Change::Result(result(phase, first)));
        }
        safe(&journal, JOB, Change::Input(input(0)));
        let expected =
            SavedWork { inputs: vec![input(0)], results: vec![result(1, 0), result(2, 20)], ..SavedWork::default() };
        assert!(Journal::open(&path).is_err(), "one process at a time");
        assert_eq!(journal.work(JOB).unwrap(), expected);
        drop(journal);
        let journal = open();
        assert_eq!((journal.jobs().unwrap(), journal.work(JOB).unwrap()), (vec![(JOB, vec![1, 2])], expected));
        for (first, kept) in [(2, vec![0]), (2, vec![])] {
            let left = kept.iter().map(|&p| input(p)).collect();
            safe(&journal, JOB, Change::Rounds { saved: rounds(1), first, kept });
            let expected =
                SavedWork { rounds: Some(rounds(1)), inputs: left, results: vec![result(2, 20)], damaged: 0 };
            assert_eq!(journal.work(JOB).unwrap(), expected);
        }
        safe(&journal, JOB, Change::Ended(vec![3]));
        assert_eq!((journal.jobs().unwrap(), journal.work(JOB).unwrap()), (vec![(JOB, vec![3])], SavedWork::default()));
        safe(&journal, JOB, Change::Forgotten);
        assert_eq!(journal.jobs().unwrap(), []);
        assert_eq!(journal.work(JobId(8)).unwrap().results, [result(0, 0)], "another job's");
    }

    #[test]
    fn damaged_entries_are_left_out() {
        let directory = tempfile::tempdir().unwrap();
        let journal = Journal::open(&directory.path().join("jobs.redb")).unwrap();
        safe(&journal, JOB, Change::Result(result(0, 0)));
        safe(&journal, JOB, Change::Result(result(0, 10)));
        let transaction = journal.database.begin_write().unwrap();
        transaction.open_table(RESULTS).unwrap().insert((JOB.0, 0, 0), (10, 5, [0; 32], &[0; 100][..])).unwrap();
        transaction.commit().unwrap();
        let work = journal.work(JOB).unwrap();
        assert_eq!((work.results, work.damaged), (vec![result(0, 10)], 1));
    }
}

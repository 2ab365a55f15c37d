//! A job that an earlier coordinator left goes on: what is kept of it → where it stood. Runs on the compute threads.

use super::Sink;
use super::handle::{Built, Made};
use super::job::{Spec, first_stats};
use super::live::{Live, StatedError};
use crate::intake;
use crate::result;
use crate::room::Room;
use crate::schedule::Saved;
use crate::schedule::work::{Kind, Total};
use crate::store::Store;
use crate::store::journal::{SavedInput, SavedResult, SavedRounds, SavedWork};
use crate::types::{JobId, JobStats, MapStats};
use gatherlight_proto::message::{BlobRef, InputRef, MapRef};
use gatherlight_proto::payload::map::decode_map;
use gatherlight_proto::payload::{bootstrap, sample_map};
use gatherlight_proto::pieces::Pieces;
use gatherlight_proto::stored::{StoredJob, StoredRounds};
use gatherlight_render::film::MapError;
use gatherlight_render::integrator::Bootstrap;
use gatherlight_render::job::Phase;
use gatherlight_render::photon::EmissionRange;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Where a job stands as its work begins.
pub(super) struct Start {
    pub(super) live: Live,
    /// What is done of it.
    pub(super) saved: Saved,
    /// Counts over the closed rounds, and by later round.
    pub(super) kept: JobStats,
    pub(super) later: BTreeMap<u32, JobStats>,
}

/// A job, ready to go on.
pub(crate) struct Resumed {
    pub(super) spec: Spec,
    pub(super) start: Start,
    /// Entries that were of no use.
    pub(super) damaged: usize,
    /// What was kept is another version's.
    pub(super) starts_anew: bool,
}

impl std::fmt::Debug for Resumed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Resumed").field("spec", &self.spec).finish_non_exhaustive()
    }
}

/// Prepares a job again and takes in what is kept of it. Any part of that may be missing or damaged; then it is done again.
///
/// # Errors
/// When the scene cannot be loaded, or the store cannot be read.
pub(crate) fn resume(store: &Store, id: JobId, job: &StoredJob) -> Result<Box<Resumed>, String> {
    let prepared = intake::prepare(store, &job.submission).map_err(|e| e.to_string())?;
    let work = match store.journal() {
        Some(journal) => journal.work(id).map_err(|e| format!("the coordinator's store failed: {e}"))?,
        None => SavedWork::default(),
    };
    let phases = prepared.phases();
    let spec = Spec { submission: job.submission.clone(), owner: job.owner.clone(), prepared };
    let mut start = Start::new(&spec, phases, None);
    let starts_anew = job.program != gatherlight_render::VERSION;
    let damaged = if starts_anew { 0 } else { start.take_in(work)? };
    Ok(Box::new(Resumed { spec, start, damaged, starts_anew }))
}

impl Start {
    /// That of a new job, of these phases.
    pub(super) fn new(spec: &Spec, phases: Vec<Phase>, sink: Option<Arc<dyn Sink>>) -> Self {
        Start {
            kept: first_stats(&phases, &spec.submission.settings),
            live: Live::new(spec, phases, sink),
            saved: Saved::default(),
            later: BTreeMap::new(),
        }
    }

    /// Takes in what is kept of the job; returns the number of entries that were of no use.
    fn take_in(&mut self, work: SavedWork) -> Result<usize, String> {
        let mut damaged = work.damaged;
        if let Some(rounds) = work.rounds {
            damaged += usize::from(self.rounds(&rounds).is_none());
        }
        for input in work.inputs {
            damaged += usize::from(self.input(input).is_none());
        }
        for saved in work.results {
            damaged += usize::from(self.result(saved)?.is_none());
        }
        self.live.light_sum().map_or(Ok(()), |sum| sum.add_waiting()).map_err(|e| e.to_string())?;
        Ok(damaged)
    }

    /// `None`: it is of no use.
    fn rounds(&mut self, saved: &SavedRounds) -> Option<()> {
        let StoredRounds { stats, gather_radii } = StoredRounds::decode(&saved.counts).ok()?;
        let StatedError { noise, bias } = self.live.restore(&saved.film).ok()?;
        self.saved.rounds = saved.rounds;
        for phase in self.live.phases.iter().take_while(|p| p.round() < saved.rounds) {
            self.saved.totals.entry(Kind::of(*phase)).or_default().units += phase.units();
        }
        for map in &stats.maps {
            let total: &mut Total = self.saved.totals.entry(Kind::Emission(map.kind)).or_default();
            total.stored = map.stored_count;
        }
        self.live.about.gather_radii = gather_radii;
        self.kept = JobStats { noise, bias, ..stats };
        Some(())
    }

    fn input(&mut self, saved: SavedInput) -> Option<()> {
        let SavedInput { phase: index, stored, gather_radius, payload: ref bytes } = saved;
        let phase = *self.live.phases.get(index)?;
        let encoded = Pieces::of(bytes.clone());
        let bytes = encoded.bytes();
        let blob = BlobRef { digest: encoded.list().digest(), bytes: bytes.len() as u64 };
        let (input, made) = match phase {
            Phase::Emission { map: kind, .. } => {
                let BlobRef { digest, bytes } = blob;
                let map = MapRef { kind, digest, bytes };
                (InputRef::Map(map), Made::Map { gather_radius, error: self.map_error(map, &saved.payload) })
            }
            Phase::Bootstrap { paths } => {
                let luminances = bootstrap::decode(bytes, EmissionRange { first: 0, end: paths }).ok()?;
                (InputRef::Bootstrap(blob), Made::Bootstrap(Arc::new(Bootstrap::new(luminances))))
            }
            Phase::SampleMap { .. } => {
                sample_map::decode(bytes, self.live.shape.grid).ok()?;
                (InputRef::SampleMap(blob), Made::SampleMap)
            }
            Phase::Gather { .. } | Phase::Splat { .. } => return None,
        };
        if let InputRef::Map(map) = input {
            let radius = self.live.about.gather_radii.entry(map.kind).or_insert(0.0);
            *radius = radius.max(gather_radius);
        }
        if phase.round() >= self.saved.rounds {
            self.later.entry(phase.round()).or_default().add(&made_stats(input, &made));
        }
        self.saved.inputs.insert(index, (input, stored));
        self.live.serve(phase.round(), Built { input, encoded: Some(encoded), made });
        Some(())
    }

    /// The error of a map, measured anew where no film is kept that knows it.
    fn map_error(&self, map: MapRef, bytes: &[u8]) -> Option<MapError> {
        if self.saved.rounds > 0 {
            return None;
        }
        let decoded = decode_map(bytes, map.kind, map.bytes).ok()?;
        self.live.prepared().map_error(&Arc::new(decoded))
    }

    fn result(&mut self, saved: SavedResult) -> Result<Option<()>, String> {
        let SavedResult { phase: index, range, busy, payload } = saved;
        let Some(&phase) = self.live.phases.get(index) else { return Ok(None) };
        let Ok(read) = result::read(&self.live.shape, phase, range, &payload) else { return Ok(None) };
        if self.saved.add_result(&self.live.phases, index, range, read.stored()) {
            let mut part = JobStats { busy, result_bytes: payload.len() as u64, ..JobStats::default() };
            self.live.put_to_use((read, Room::default()), phase, &mut part)?;
            self.later.entry(phase.round()).or_default().add(&part);
        }
        Ok(Some(()))
    }
}

/// What is counted of something that was made of a phase.
pub(super) fn made_stats(input: InputRef, made: &Made) -> JobStats {
    let mut stats = JobStats::default();
    if let InputRef::Map(MapRef { kind, bytes, .. }) = input {
        stats.maps.push(MapStats { kind, emitted_count: 0, emitted_total: 0, stored_count: 0, bytes });
    }
    if let Made::Bootstrap(bootstrap) = made {
        stats.non_finite.samples = bootstrap.non_finite();
    }
    stats
}

//! Everything heavy of a job that has not ended: results being joined, and what workers read.

use super::Sink;
use super::handle::{Built, Made, Payload, Source};
use super::job::Spec;
use crate::assemble::Parts;
use crate::reduce::LightSum;
use crate::report::About;
use crate::result::Shape;
use crate::room::Room;
use crate::schedule::job::Done;
use crate::types::JobStats;
use gatherlight_proto::message::InputRef;
use gatherlight_proto::pieces::Pieces;
use gatherlight_proto::{Digest, WireError};
use gatherlight_render::film::{Accumulator, Bias, LightImage, MapError, Noise, SampleMap, Tile};
use gatherlight_render::integrator::Bootstrap;
use gatherlight_render::job::{Phase, PreparedJob};
use gatherlight_render::photon::merge::Merger;
use gatherlight_render::photon::{EmissionRange, MapKind};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Something that workers may fetch.
struct Served {
    round: u32,
    digest: Digest,
    encoded: Option<Pieces>,
    sent: Arc<AtomicU64>,
    /// A bootstrap is read in all rounds, a sample map in all to come.
    retires: bool,
}

/// Where the film in the making is.
enum FilmState {
    /// No tile has come yet.
    Empty,
    /// Here.
    Here(Box<Accumulator>),
    /// With the compute threads, which close a round.
    Closing,
}

/// The light image and its sum so far, of the round in the making.
#[derive(Clone)]
struct LightParts {
    empty: Arc<LightImage>,
    sum: Arc<LightSum>,
}

/// Tiles and splats that have to wait, with the memory they take.
type Early = (Vec<Tile>, Option<LightImage>, Room);

/// See the module.
pub(super) struct Live {
    prepared: Arc<PreparedJob>,
    /// Its phases, in order.
    pub(super) phases: Arc<[Phase]>,
    /// How its results look.
    pub(super) shape: Arc<Shape>,
    /// What its image will say of how it was made.
    pub(super) about: About,
    /// Relative error at which the image is good enough.
    target: Option<f32>,
    /// Photons by round and map, from the first result to the building of the map.
    mergers: BTreeMap<(u32, MapKind), Merger>,
    /// Luminances by first bootstrap path, until they are joined.
    luminances: BTreeMap<u64, Vec<f32>>,
    bootstrap: Option<Arc<Bootstrap>>,
    film: FilmState,
    /// Of maps that all rounds read, until there is a film.
    map_errors: Vec<MapError>,
    /// Results of rounds after the one in the making, or while that is being closed.
    early: BTreeMap<u32, Vec<Early>>,
    light: Option<LightParts>,
    served: Vec<Served>,
    /// Bytes sent of what is not served any more.
    retired_bytes: u64,
    blobs: BTreeSet<Digest>,
    sink: Option<Arc<dyn Sink>>,
}

impl Live {
    pub(super) fn new(spec: &Spec, phases: Vec<Phase>, sink: Option<Arc<dyn Sink>>) -> Self {
        let (prepared, shape) = (spec.prepared.clone(), Shape::of(&spec.prepared));
        let light = shape
            .light
            .as_ref()
            .map(|empty| LightParts { sum: Arc::new(LightSum::new(LightImage::clone(empty))), empty: empty.clone() });
        Live {
            about: About::new(&prepared, &phases),
            phases: phases.into(),
            shape: Arc::new(shape),
            target: spec.submission.limits.error,
            mergers: BTreeMap::new(),
            luminances: BTreeMap::new(),
            bootstrap: None,
            film: FilmState::Empty,
            map_errors: Vec::new(),
            early: BTreeMap::new(),
            light,
            served: Vec::new(),
            retired_bytes: 0,
            blobs: spec.submission.manifest.blobs().iter().map(|b| b.digest).collect(),
            sink,
            prepared,
        }
    }
    /// Its scene and settings.
    pub(super) fn prepared(&self) -> &PreparedJob {
        &self.prepared
    }
    /// The sum of its light images, where it has one.
    pub(super) fn light_sum(&self) -> Option<Arc<LightSum>> {
        self.light.as_ref().map(|l| l.sum.clone())
    }
    /// Where this digest is, if it is something of this job that workers read.
    pub(super) fn source(&self, digest: Digest) -> Option<Source> {
        let served = self.served.iter().find(|s| s.digest == digest);
        let memory = served.and_then(|s| Some(Source::Memory { pieces: s.encoded.clone()?, sent: s.sent.clone() }));
        memory.or_else(|| self.blobs.contains(&digest).then_some(Source::Blob(digest)))
    }
    /// Bytes of maps and bootstraps sent so far.
    pub(super) fn sent_bytes(&self) -> u64 {
        self.retired_bytes + self.served.iter().map(Served::sent).sum::<u64>()
    }
    /// Those of one round's maps.
    pub(super) fn sent_bytes_of(&self, round: u32) -> u64 {
        self.served.iter().filter(|s| s.retires && s.round == round).map(Served::sent).sum()
    }

    /// Takes in a result that counts.
    pub(super) fn put_to_use(
        &mut self,
        (payload, room): (Payload, Room),
        phase: Phase,
        stats: &mut JobStats,
    ) -> Result<(), String> {
        match (payload, phase) {
            (Payload::Photons(batch), Phase::Emission { round, map, paths }) => {
                stats.non_finite.photons = stats.non_finite.photons.saturating_add(batch.non_finite);
                let merger = self.mergers.entry((round, map)).or_insert_with(|| new_merger(map, paths));
                merger.insert(batch).map_err(|e| e.to_string())
            }
            (Payload::Luminances(first, part), Phase::Bootstrap { .. }) => {
                self.luminances.insert(first, part);
                Ok(())
            }
            (Payload::Light(light), Phase::Splat { round, .. }) => {
                count_light(&light, stats);
                self.add_to_round(round, Vec::new(), Some(light), room)
            }
            (Payload::Tiles(tiles, light), Phase::Gather { round, .. }) => {
                for tile in &tiles {
                    stats.rays = stats.rays.saturating_add(tile.rays);
                    stats.non_finite.samples = stats.non_finite.samples.saturating_add(tile.non_finite);
                }
                if let Some(light) = &light {
                    count_light(light, stats);
                }
                self.add_to_round(round, tiles, light, room)
            }
            _ => Err("a result is of another kind than its task".into()),
        }
    }
    fn add_to_round(
        &mut self,
        round: u32,
        tiles: Vec<Tile>,
        light: Option<LightImage>,
        room: Room,
    ) -> Result<(), String> {
        if matches!(self.film, FilmState::Empty) {
            // Maps that all rounds read are there before any tile.
            let mut film = Box::new(self.prepared.accumulator());
            self.map_errors.drain(..).for_each(|error| film.add_map_error(Some(error)));
            self.film = FilmState::Here(film);
        }
        match &mut self.film {
            FilmState::Here(film) if film.closed_rounds() == round => {
                tiles.iter().try_for_each(|tile| film.insert(round, tile)).map_err(|e| e.to_string())?;
                self.put_light(light, room)
            }
            _ => {
                self.early.entry(round).or_default().push((tiles, light, room));
                Ok(())
            }
        }
    }
    /// Whether a result of `phase` has to wait until the round before it is closed.
    pub(super) fn is_early(&self, phase: Phase) -> bool {
        phase.makes_image()
            && match &self.film {
                FilmState::Empty => false,
                FilmState::Here(film) => film.closed_rounds() != phase.round(),
                FilmState::Closing => true,
            }
    }
    fn put_light(&mut self, light: Option<LightImage>, room: Room) -> Result<(), String> {
        let Some(light) = light else { return Ok(()) };
        self.light.as_ref().ok_or("the method has no light image")?.sum.put(light, room);
        Ok(())
    }

    /// What the round of `phase` is closed with, once all of its tiles or units are there: the film and what was splatted.
    /// Its film is kept as well, where `noted` bytes of results, which it would stand for, are worth it.
    pub(super) fn take_round(&mut self, phase: Phase, noted: u64) -> Option<Round> {
        let FilmState::Here(film) = std::mem::replace(&mut self.film, FilmState::Closing) else { return None };
        let (prepared, bootstrap) = (self.prepared.clone(), self.bootstrap.clone());
        let keeps = noted > film.bytes() as u64;
        Some(Round { phase, film, light: self.light.clone(), prepared, bootstrap, target: self.target, keeps })
    }
    /// Takes back the film as it was kept; returns its error.
    ///
    /// # Errors
    /// When it is damaged or of another job.
    pub(super) fn restore(&mut self, film: &[u8]) -> Result<StatedError, WireError> {
        let restored = gatherlight_proto::payload::film::decode(film, &self.prepared.accumulator())?;
        let error = StatedError::of(&restored);
        self.film = FilmState::Here(Box::new(restored));
        Ok(error)
    }
    /// Phases before round `round` whose inputs it and later ones read: bootstrap, sample map, and maps where no more are made.
    pub(super) fn kept_inputs(&self, round: u32) -> Vec<usize> {
        let is_emission = |p: &Phase| matches!(p, Phase::Emission { .. });
        let before = self.phases.iter().take_while(|p| p.round() < round).enumerate();
        let makes_own = self.phases.iter().any(|p| p.round() == round && is_emission(p));
        let latest = before.clone().filter(|(_, p)| is_emission(p)).map(|(_, p)| p.round()).max();
        let reads = |p: &Phase| match p {
            Phase::Bootstrap { .. } | Phase::SampleMap { .. } => true,
            Phase::Emission { round, .. } => !makes_own && Some(*round) == latest,
            _ => false,
        };
        before.filter(|(_, p)| reads(p)).map(|(i, _)| i).collect()
    }
    /// Takes back the film of a closed round, and adds what came meanwhile of the next.
    pub(super) fn closed(&mut self, film: Box<Accumulator>) -> Result<(), String> {
        let round = film.closed_rounds();
        self.film = FilmState::Here(film);
        let early = self.early.remove(&round).unwrap_or_default();
        early.into_iter().try_for_each(|(tiles, light, room)| self.add_to_round(round, tiles, light, room))
    }

    /// What the map of a round is built from.
    pub(super) fn take_photons(&mut self, round: u32, kind: MapKind, paths: u64) -> (Merger, Arc<PreparedJob>) {
        let merger = self.mergers.remove(&(round, kind)).unwrap_or_else(|| new_merger(kind, paths));
        (merger, self.prepared.clone())
    }
    /// What the bootstrap is built from.
    pub(super) fn take_luminances(&mut self) -> BTreeMap<u64, Vec<f32>> {
        std::mem::take(&mut self.luminances)
    }
    /// Where the samples of the rounds to come go, by those that are closed.
    pub(super) fn sample_map(&self) -> Option<Arc<SampleMap>> {
        if let FilmState::Here(film) = &self.film { film.sample_map().cloned().map(Arc::new) } else { None }
    }
    /// Where workers in this process find what they read.
    pub(super) fn sink(&self) -> Option<Arc<dyn Sink>> {
        self.sink.clone()
    }
    /// Lets workers fetch what was made of a phase of `round`.
    pub(super) fn serve(&mut self, round: u32, built: Built) {
        let Built { input, encoded, made } = built;
        let (digest, retires) = (input.blob().digest, matches!(input, InputRef::Map(_)));
        match made {
            Made::Bootstrap(bootstrap) => self.bootstrap = Some(bootstrap),
            Made::Map { error: Some(error), .. } => self.map_errors.push(error),
            Made::Map { error: None, .. } | Made::SampleMap => {}
        }
        self.served.push(Served { round, digest, encoded, sent: Arc::default(), retires });
    }
    /// Drops the maps of `round`.
    pub(super) fn retire(&mut self, round: u32) {
        let sink = self.sink.clone();
        let retired = self.served.extract_if(.., |s| s.retires && s.round == round);
        for served in retired {
            self.retired_bytes += served.sent();
            if let Some(sink) = &sink {
                sink.withdraw(served.digest);
            }
        }
    }
    /// What the image is made of.
    pub(super) fn parts(&mut self, done: Done) -> Parts {
        // Of a round that a limit has cut off.
        self.mergers.clear();
        self.early.clear();
        let film = match std::mem::replace(&mut self.film, FilmState::Empty) {
            FilmState::Here(film) => *film,
            FilmState::Empty | FilmState::Closing => self.prepared.accumulator(),
        };
        Parts {
            prepared: self.prepared.clone(),
            film,
            rounds: done.rounds,
            light: self.light.take().map(|l| l.sum),
            bootstrap: self.bootstrap.clone(),
        }
    }
}

/// A round that is complete, on its way through the compute threads.
pub(super) struct Round {
    phase: Phase,
    film: Box<Accumulator>,
    light: Option<LightParts>,
    prepared: Arc<PreparedJob>,
    bootstrap: Option<Arc<Bootstrap>>,
    target: Option<f32>,
    keeps: bool,
}

impl Round {
    /// Closes it, on the current rayon pool.
    ///
    /// # Errors
    /// When tiles are missing, or a light image is of another job.
    pub(super) fn close(self) -> Result<ClosedRound, String> {
        let Round { phase, mut film, light, prepared, bootstrap, target, keeps } = self;
        let (round, tiles) = (phase.round(), matches!(phase, Phase::Gather { .. }));
        if film.closed_rounds() != round || (tiles && !film.is_round_complete()) {
            return Err(format!("tiles are missing from round {round}"));
        }
        let sum = |parts: LightParts| parts.sum.finish(LightImage::clone(&parts.empty)).map_err(|e| e.to_string());
        let light = light.map(sum).transpose()?;
        prepared.close(&mut film, light.as_ref(), bootstrap.as_deref());
        let error = (target.is_some() || is_told(film.closed_rounds())).then(|| StatedError::of(&film));
        let is_good_enough = film.closed_rounds() >= LEAST_ROUNDS
            && error.and_then(|e| e.total(&film)).zip(target).is_some_and(|(e, target)| e <= f64::from(target));
        // One that cannot be kept costs time after a restart, nothing else.
        let kept = if keeps { gatherlight_proto::payload::film::encode(&film).ok() } else { None };
        Ok(ClosedRound { round, is_good_enough, error, film, kept })
    }
}

/// Rounds before whose closing no image is said to be good enough: the noise is known by their differences.
const LEAST_ROUNDS: u32 = 4;

/// Whether the error is told after so many rounds, if nothing hangs on it: it takes a pass over the image.
fn is_told(rounds: u32) -> bool {
    rounds.is_multiple_of((rounds / 16).max(1).next_power_of_two())
}

/// What an image says of its own error.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct StatedError {
    pub(crate) noise: Option<Noise>,
    pub(crate) bias: Option<Bias>,
}

impl StatedError {
    /// That of the closed rounds, on the current rayon pool.
    pub(crate) fn of(film: &Accumulator) -> Self {
        StatedError { noise: film.noise(), bias: film.bias() }
    }
    /// Both together, relative; `None` while a part of it is not known.
    fn total(&self, film: &Accumulator) -> Option<f64> {
        let bias = match self.bias {
            None if film.is_blurred() => return None,
            bias => bias.map_or(0.0, |b| b.relative),
        };
        self.noise.map(|n| n.relative.hypot(bias))
    }
}

/// A round that has been closed.
#[derive(Debug)]
pub(crate) struct ClosedRound {
    pub(super) round: u32,
    pub(super) is_good_enough: bool,
    /// Where it was told.
    pub(super) error: Option<StatedError>,
    pub(super) film: Box<Accumulator>,
    /// The film as it is to be kept.
    pub(super) kept: Option<Vec<u8>>,
}

fn count_light(light: &LightImage, stats: &mut JobStats) {
    stats.rays = stats.rays.saturating_add(light.rays());
    stats.mutations.add(light.mutations());
    stats.non_finite.splats = stats.non_finite.splats.saturating_add(light.non_finite());
}

impl Drop for Live {
    fn drop(&mut self) {
        if let Some(sink) = &self.sink {
            self.served.iter().for_each(|s| sink.withdraw(s.digest));
        }
    }
}

impl Served {
    fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }
}

fn new_merger(kind: MapKind, paths: u64) -> Merger {
    Merger::new(kind, EmissionRange { first: 0, end: paths })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest;
    use gatherlight_proto::message::{MapRef, Submission};
    use gatherlight_render::import::SceneBundle;
    use gatherlight_render::job::PhotonMap;
    use gatherlight_render::photon::PhotonBatch;
    use gatherlight_render::settings::{Method, RenderSettings};
    use std::sync::Mutex;

    /// What is offered and not withdrawn.
    #[derive(Default)]
    struct Offers(Mutex<Vec<Digest>>);

    impl Sink for Offers {
        fn offer_map(&self, digest: Digest, _: Arc<PhotonMap>) {
            self.0.lock().unwrap().push(digest);
        }
        fn offer_bootstrap(&self, digest: Digest, _: Arc<Bootstrap>) {
            self.0.lock().unwrap().push(digest);
        }
        fn offer_sample_map(&self, digest: Digest, _: Arc<SampleMap>) {
            self.0.lock().unwrap().push(digest);
        }
        fn withdraw(&self, digest: Digest) {
            let mut offers = self.0.lock().unwrap();
            let place = offers.iter().position(|d| *d == digest).expect("was offered");
            offers.swap_remove(place);
        }
    }

    fn spec(rounds: u32) -> Spec {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes/caustic-ring.glb");
        let root = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let bundle = SceneBundle { name: "ring".into(), root: root.into(), externals: Vec::new() };
        let settings =
            RenderSettings { method: Method::Progressive, width: 32, height: 16, rounds, ..RenderSettings::default() };
        let prepared = Arc::new(PreparedJob::prepare(&bundle, &settings).unwrap_or_else(|e| panic!("{e}")));
        Spec { submission: Submission::new(manifest::pack(&bundle).0, settings), owner: String::new(), prepared }
    }

    fn empty_map() -> PhotonMap {
        let range = EmissionRange { first: 0, end: 1 };
        let (positions, powers, normals) = (Vec::new(), Vec::new(), Vec::new());
        PhotonMap::build(
            MapKind::Global,
            PhotonBatch { range, positions, powers, normals, vertices: None, non_finite: 0 },
        )
    }

    #[test]
    fn what_is_held_does_not_grow_with_the_rounds() {
        let (rounds, offers) = (50, Arc::new(Offers::default()));
        let spec = spec(rounds);
        let mut live = Live::new(&spec, spec.prepared.phases(), Some(offers.clone()));
        let (grid, channels, mut stats) = (spec.prepared.grid(), spec.prepared.channels(), JobStats::default());
        for round in 0..rounds {
            let (merger, _) = live.take_photons(round, MapKind::Global, 0);
            assert!(merger.is_complete());
            // Every third round has the map of the one before, byte for byte.
            let digest = Digest([(round - u32::from(round % 3 == 2)) as u8; 32]);
            offers.offer_map(digest, Arc::new(empty_map()));
            let input = InputRef::Map(MapRef { kind: MapKind::Global, digest, bytes: 0 });
            live.serve(
                round,
                Built {
                    input,
                    encoded: Some(Pieces::of((&b"map"[..]).into())),
                    made: Made::Map { gather_radius: 1.0, error: None },
                },
            );
            let Some(Source::Memory { pieces, sent }) = live.source(digest) else { panic!("is not served") };
            sent.fetch_add(pieces.bytes().len() as u64, Ordering::Relaxed);
            for index in 0..grid.len() {
                let pixels = vec![1.0; 256 * channels.len()];
                let tile = Tile { index, pixels, non_finite: 0, rays: 1 };
                let phase = Phase::Gather { round, tiles: grid.len() };
                live.put_to_use((Payload::Tiles(vec![tile], None), Room::default()), phase, &mut stats).unwrap();
            }
            let closed =
                live.take_round(Phase::Gather { round, tiles: grid.len() }, 0).expect("is there").close().unwrap();
            live.closed(closed.film).unwrap();
            // As the scheduler has it: the next round's map is there before this round is over.
            if round > 0 {
                live.retire(round - 1);
            }
            assert_eq!((live.served.len(), live.mergers.len(), offers.0.lock().unwrap().len()), (1, 0, 1));
            assert!(live.source(digest).is_some());
            assert_eq!(live.sent_bytes(), 3 * u64::from(round + 1));
        }
        assert_eq!(stats.rays, u64::from(rounds * grid.len()));
        let parts = live.parts(Done { rounds, ..Done::default() });
        assert_eq!(parts.film.closed_rounds(), rounds);
        drop(live);
        assert!(offers.0.lock().unwrap().is_empty());
    }
}

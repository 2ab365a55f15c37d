//! The coordinator's own part of a job: joining results, serving what workers read, putting the image together. What
//! computes runs on the compute threads and reports back.

use super::Driver;
use super::handle::{Built, Handle, Image, Input, Made, Source};
use super::live::{ClosedRound, StatedError};
use super::resume::made_stats;
use crate::compute::Panicked;
use crate::schedule::Event;
use crate::schedule::job::Done;
use crate::types::JobId;
use crate::{assemble, merge};
use gatherlight_proto::Digest;
use gatherlight_proto::collective::Collective;
use gatherlight_proto::message::InputRef;
use gatherlight_render::job::Phase;
use tokio::sync::mpsc;

impl Driver {
    /// Joins the results of an emission or bootstrap phase, makes the sample map, or closes the round of a gather or splat.
    pub(super) fn build(&mut self, id: JobId, phase: Phase) {
        let Some(job) = self.jobs.get_mut(&id) else { return };
        let noted = if self.store.journal().is_some() { job.noted_bytes } else { 0 };
        let Some(live) = job.live.as_mut() else { return };
        let (own, sink) = (self.own.clone(), live.sink());
        let built = move |result| report(&own, Input::Built(id, phase, flat(result)));
        match phase {
            Phase::Emission { round, map, paths } => {
                let (merger, prepared) = live.take_photons(round, map, paths);
                self.compute.spawn(move || merge::build_map(map, merger, &prepared, sink.as_deref()), built);
            }
            Phase::Bootstrap { paths } => {
                let luminances = live.take_luminances();
                self.compute.spawn(move || merge::build_bootstrap(paths, luminances, sink.as_deref()), built);
            }
            Phase::SampleMap { .. } => {
                let map = live.sample_map();
                self.compute.spawn(move || merge::build_sample_map(map, sink.as_deref()), built);
            }
            Phase::Gather { .. } | Phase::Splat { .. } => {
                let Some(round) = live.take_round(phase, noted) else { return };
                let own = self.own.clone();
                let closed = move |result| report(&own, Input::Closed(id, flat(result)));
                self.compute.spawn(move || round.close(), closed);
            }
        }
        self.refresh(id);
    }

    /// Serves what was made of a phase.
    pub(super) fn built(&mut self, id: JobId, phase: Phase, built: Result<Built, String>) {
        let built = match built {
            Ok(built) => built,
            Err(error) => return self.event(Event::StepFailed { job: id, error }),
        };
        let (input, round) = (built.input, phase.round());
        let gather_radius = if let Made::Map { gather_radius, .. } = built.made { gather_radius } else { 0.0 };
        let payload = built.encoded.as_ref().map(|e| e.bytes().clone()).unwrap_or_default();
        self.note_input(id, phase, gather_radius, payload);
        let Some(job) = self.jobs.get_mut(&id) else { return };
        job.add_stats(round, &made_stats(input, &built.made));
        let Some(live) = job.live.as_mut() else { return };
        if let InputRef::Map(map) = input {
            let radius = live.about.gather_radii.entry(map.kind).or_insert(0.0);
            *radius = radius.max(gather_radius);
            job.stats.gather_radius = live.about.gather_radii.values().copied().reduce(f32::max);
        }
        live.serve(round, built);
        if self.config.sink.is_none() {
            self.announce(input.blob());
        }
        tracing::info!(job = %id, round, ?input, "built");
        self.event(Event::Built { job: id, round, input });
        self.refresh(id);
    }

    /// Goes on with the film of a closed round.
    pub(super) fn closed(&mut self, id: JobId, closed: Result<ClosedRound, String>) {
        let Some(job) = self.jobs.get_mut(&id) else { return };
        let Some(live) = job.live.as_mut() else { return };
        let result = closed.and_then(|c| {
            live.closed(c.film)?;
            Ok((c.round, c.is_good_enough, c.error, c.kept))
        });
        match result {
            Ok((round, is_good_enough, error, kept)) => {
                if let Some(error) = error {
                    job.state_error(error);
                }
                self.event(Event::Closed { job: id, round, is_good_enough });
                if let Some(film) = kept {
                    self.note_rounds(id, film);
                }
            }
            Err(error) => self.event(Event::StepFailed { job: id, error }),
        }
        self.refresh(id);
    }

    /// Drops the maps of a round that is complete.
    pub(super) fn retire(&mut self, id: JobId, round: u32) {
        if let Some(live) = self.jobs.get_mut(&id).and_then(|j| j.live.as_mut()) {
            live.retire(round);
        }
        self.end_broadcasts();
    }

    /// Has the light images that came in added to their sum.
    pub(super) fn add_light(&self, id: JobId) {
        let Some(sum) = self.jobs.get(&id).and_then(|j| j.live.as_ref()?.light_sum()) else { return };
        let own = self.own.clone();
        let failed = move |error| report(&own, Input::Assembled(id, Err(error)));
        self.compute.spawn(
            move || sum.add_waiting().map_err(|e| e.to_string()),
            move |result| flat(result).unwrap_or_else(failed),
        );
    }

    /// Puts the image together.
    pub(super) fn assemble(&mut self, id: JobId, done: Done) {
        let Some(job) = self.jobs.get_mut(&id) else { return };
        if let Some(counts) = self.scheduler.job(id) {
            job.count(counts);
        }
        let Some(live) = job.live.as_mut() else { return };
        let parts = live.parts(done);
        let metadata = live.about.metadata(live.prepared().settings(), &job.stats);
        let (own, store, keep) = (self.own.clone(), self.store.clone(), self.config.keep);
        self.compute.spawn(
            move || assemble::finish(parts, metadata, keep, &store),
            move |image| report(&own, Input::Assembled(id, flat(image))),
        );
        self.refresh(id);
    }

    pub(super) fn assembled(&mut self, id: JobId, image: Result<(Image, StatedError), String>) {
        let Some(job) = self.jobs.get_mut(&id) else { return };
        let image = image.map(|(image, error)| {
            job.state_error(error);
            image
        });
        match image {
            Ok(Image::Film(film, metadata)) => job.kept_film = Some((film, *metadata)),
            Ok(Image::Stored(blob)) => job.image = Some(blob),
            Err(error) => return self.event(Event::StepFailed { job: id, error }),
        }
        self.event(Event::Assembled { job: id });
    }

    /// Where this digest is: a map or bootstrap of a live job, or a blob of a live job's scene. Anything else is nobody's
    /// business.
    pub(super) fn source(&self, digest: Digest) -> Option<Source> {
        self.jobs.values().filter_map(|j| j.live.as_ref()).find_map(|live| live.source(digest))
    }
}

/// By what collective the results of a phase come together.
pub(super) fn collective(phase: Phase) -> Collective {
    match phase {
        Phase::Emission { .. } => Collective::GatherPhotons,
        Phase::Bootstrap { .. } => Collective::GatherLuminances,
        Phase::Splat { .. } => Collective::ReduceLight,
        // A sample map is made of tiles.
        Phase::SampleMap { .. } | Phase::Gather { .. } => Collective::GatherTiles,
    }
}

/// From a compute thread to the driver, if it is still there.
pub(super) fn report(own: &mpsc::WeakSender<Input>, input: Input) {
    if let Some(handle) = Handle::upgrade(own) {
        handle.report(input);
    }
}

/// A panic is a failure like others.
pub(super) fn flat<T>(result: Result<Result<T, String>, Panicked>) -> Result<T, String> {
    result.unwrap_or_else(|panic| Err(panic.to_string()))
}

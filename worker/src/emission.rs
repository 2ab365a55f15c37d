//! An emission lease → photons as bytes. Runs on the compute threads.

use bytes::Bytes;
use gatherlight_proto::payload::photons;
use gatherlight_render::job::PreparedJob;
use gatherlight_render::photon::{EmissionRange, MapKind};
use std::time::{Duration, Instant};

/// Traces the photon paths of `range` and encodes what they stored; also returns the time it took.
pub fn compute(job: &PreparedJob, map: MapKind, range: EmissionRange) -> (Bytes, Duration) {
    let begun = Instant::now();
    let batch = job.emit(0, map, range);
    (photons::encode_batch(&batch), begun.elapsed())
}

//! Emission and bootstrap leases → photons and luminances as bytes. Runs on the compute threads.

use bytes::Bytes;
use gatherlight_proto::payload::{bootstrap, photons};
use gatherlight_render::job::PreparedJob;
use gatherlight_render::photon::{EmissionRange, MapKind};
use std::time::{Duration, Instant};

/// Traces the photon paths of `range` of `round` and encodes what they stored; also returns the time it took.
pub fn compute(job: &PreparedJob, round: u32, map: MapKind, range: EmissionRange) -> (Bytes, Duration) {
    let begun = Instant::now();
    let batch = job.emit(round, map, range);
    (photons::encode_batch(&batch), begun.elapsed())
}

/// Traces the bootstrap paths of `range` and encodes their luminances; also returns the time it took.
pub fn compute_bootstrap(job: &PreparedJob, range: EmissionRange) -> (Bytes, Duration) {
    let begun = Instant::now();
    let luminances = job.bootstrap(range);
    (bootstrap::encode(range, &luminances), begun.elapsed())
}

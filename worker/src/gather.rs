//! A gather lease → tiles as bytes. Runs on the compute threads.

use bytes::Bytes;
use gatherlight_proto::payload::tiles;
use gatherlight_render::job::{Inputs, PhotonMaps, PreparedJob};
use gatherlight_render::photon::EmissionRange;
use rayon::prelude::*;
use std::time::{Duration, Instant};

/// Renders the tiles of `range`, in parallel, and encodes them in order; also returns the time it took.
pub fn compute(job: &PreparedJob, maps: &PhotonMaps, range: EmissionRange) -> (Bytes, Duration) {
    let begun = Instant::now();
    let inputs = Inputs { maps: maps.clone(), bootstrap: None };
    // Tile numbers are 32 bits wide; a coordinator that asks for others gets tiles that it will refuse.
    let indices = range.first.min(u64::from(u32::MAX)) as u32..range.end.min(u64::from(u32::MAX)) as u32;
    // One tile at a time for each thread: neighbouring tiles differ much in cost.
    let rendered: Vec<_> =
        indices.into_par_iter().with_max_len(1).map(|tile| job.gather(&inputs, 0, tile, None)).collect();
    (tiles::encode(&rendered, job.channels().len()), begun.elapsed())
}

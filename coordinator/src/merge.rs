//! Batches → one map, ready for broadcast. Runs on the compute threads.

use crate::driver::{BuiltMap, MapSink};
use bytes::Bytes;
use gatherlight_proto::Digest;
use gatherlight_proto::limits::MAX_MAP_BYTES;
use gatherlight_proto::message::MapRef;
use gatherlight_proto::payload::map::encode_map;
use gatherlight_render::job::PreparedJob;
use gatherlight_render::photon::MapKind;
use gatherlight_render::photon::merge::Merger;

/// Joins the batches in path order, builds the search structure and hands it to `sink`, or encodes it, once for all
/// workers. Each step frees what the one before it held.
///
/// # Errors
/// When photon paths are missing, or the map is too large to send.
pub(crate) fn build(
    kind: MapKind,
    merger: Merger,
    prepared: &PreparedJob,
    sink: Option<&MapSink>,
) -> Result<BuiltMap, String> {
    let merged = merger.finish().map_err(|e| e.to_string())?;
    let stored_count = merged.len() as u64;
    let map = prepared.build_map(kind, merged);
    let gather_radius = prepared.gather_radius(&map);
    if let Some(sink) = sink {
        let digest = Digest(map.digest());
        sink(digest, map);
        let map = MapRef { kind, digest, bytes: 0 };
        return Ok(BuiltMap { map, bytes: Bytes::new(), stored_count, gather_radius });
    }
    let encoded = encode_map(&map);
    drop(map);
    let bytes = encoded.len() as u64;
    if bytes > MAX_MAP_BYTES {
        let text = "(MAX_MAP_BYTES): emit fewer photons";
        return Err(format!("the {} map has {bytes} bytes, over {MAX_MAP_BYTES} {text}", kind.name()));
    }
    let map = MapRef { kind, digest: Digest::of(&encoded), bytes };
    Ok(BuiltMap { map, bytes: encoded, stored_count, gather_radius })
}

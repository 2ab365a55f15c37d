//! Results of emission and bootstrap leases → what workers read, ready for broadcast. Runs on the compute threads.

use crate::driver::{Built, Made, Sink};
use bytes::Bytes;
use gatherlight_proto::Digest;
use gatherlight_proto::limits::MAX_MAP_BYTES;
use gatherlight_proto::message::{BlobRef, InputRef, MapRef};
use gatherlight_proto::payload::map::encode_map;
use gatherlight_proto::payload::{bootstrap, sample_map};
use gatherlight_proto::pieces::Pieces;
use gatherlight_render::film::SampleMap;
use gatherlight_render::integrator::Bootstrap;
use gatherlight_render::job::PreparedJob;
use gatherlight_render::photon::merge::Merger;
use gatherlight_render::photon::{EmissionRange, MapKind};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Joins the batches in path order, builds the search structure and hands it to `sink`, or encodes it, once for all
/// workers. Each step frees what the one before it held.
///
/// # Errors
/// When photon paths are missing, or the map is too large to send.
pub(crate) fn build_map(
    kind: MapKind,
    merger: Merger,
    prepared: &PreparedJob,
    sink: Option<&dyn Sink>,
) -> Result<Built, String> {
    let merged = merger.finish().map_err(|e| e.to_string())?;
    let map = Arc::new(prepared.build_map(kind, merged));
    let made = Made::Map { gather_radius: prepared.gather_radius(&map), error: prepared.map_error(&map) };
    if let Some(sink) = sink {
        let digest = Digest(map.digest());
        sink.offer_map(digest, map);
        return Ok(Built { input: InputRef::Map(MapRef { kind, digest, bytes: 0 }), encoded: None, made });
    }
    let encoded = encode_map(&map);
    drop(map);
    let bytes = sized(&format!("the {} map", kind.name()), &encoded, "emit fewer photons")?;
    let encoded = Pieces::of(encoded);
    let map = MapRef { kind, digest: encoded.list().digest(), bytes };
    Ok(Built { input: InputRef::Map(map), encoded: Some(encoded), made })
}

/// Joins the luminances of bootstrap paths [0, `paths`), which came in pieces by first path, and hands them to `sink`
/// or encodes them.
///
/// # Errors
/// When paths are missing, or they are too many to send.
pub(crate) fn build_bootstrap(
    paths: u64,
    pieces: BTreeMap<u64, Vec<f32>>,
    sink: Option<&dyn Sink>,
) -> Result<Built, String> {
    let mut luminances: Vec<f32> = Vec::with_capacity(pieces.values().map(Vec::len).sum());
    for (first, piece) in pieces {
        if first != luminances.len() as u64 {
            return Err(format!("bootstrap path {} is missing", luminances.len()));
        }
        luminances.extend(piece);
    }
    if luminances.len() as u64 != paths {
        return Err(format!("{} bootstrap paths of {paths} are there", luminances.len()));
    }
    let encoded = Pieces::of(bootstrap::encode(EmissionRange { first: 0, end: paths }, &luminances));
    let digest = encoded.list().digest();
    let joined = Arc::new(Bootstrap::new(luminances));
    let made = Made::Bootstrap(joined.clone());
    if let Some(sink) = sink {
        sink.offer_bootstrap(digest, joined);
        return Ok(Built { input: InputRef::Bootstrap(BlobRef { digest, bytes: 0 }), encoded: None, made });
    }
    let bytes = sized("the bootstrap", encoded.bytes(), "trace fewer bootstrap paths")?;
    Ok(Built { input: InputRef::Bootstrap(BlobRef { digest, bytes }), encoded: Some(encoded), made })
}

/// Hands the sample map, which the closed rounds have made, to `sink`, or encodes it.
///
/// # Errors
/// When the rounds have made none.
pub(crate) fn build_sample_map(map: Option<Arc<SampleMap>>, sink: Option<&dyn Sink>) -> Result<Built, String> {
    let map = map.ok_or("the closed rounds have not decided where the samples go")?;
    let encoded = Pieces::of(sample_map::encode(&map));
    let digest = encoded.list().digest();
    if let Some(sink) = sink {
        sink.offer_sample_map(digest, map);
        let input = InputRef::SampleMap(BlobRef { digest, bytes: 0 });
        return Ok(Built { input, encoded: None, made: Made::SampleMap });
    }
    let bytes = sized("the sample map", encoded.bytes(), "render fewer pixels")?;
    let input = InputRef::SampleMap(BlobRef { digest, bytes });
    Ok(Built { input, encoded: Some(encoded), made: Made::SampleMap })
}

/// The length of `encoded`, if it may be sent.
fn sized(what: &str, encoded: &Bytes, advice: &str) -> Result<u64, String> {
    let bytes = encoded.len() as u64;
    if bytes > MAX_MAP_BYTES {
        return Err(format!("{what} has {bytes} bytes, over {MAX_MAP_BYTES} (MAX_MAP_BYTES): {advice}"));
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bootstrap_is_joined_in_path_order_and_gaps_are_errors() {
        let pieces = |list: &[(u64, &[f32])]| list.iter().map(|&(f, l)| (f, l.to_vec())).collect::<BTreeMap<_, _>>();
        let built = build_bootstrap(5, pieces(&[(3, &[4.0, 5.0]), (0, &[1.0, 2.0, 3.0])]), None).unwrap();
        let Made::Bootstrap(joined) = built.made else { panic!("is a bootstrap") };
        assert_eq!(joined.weights(), [1.0, 2.0, 3.0, 4.0, 5.0]);
        let all = EmissionRange { first: 0, end: 5 };
        assert_eq!(bootstrap::decode(built.encoded.unwrap().bytes(), all), Ok(vec![1.0, 2.0, 3.0, 4.0, 5.0]));
        assert!(build_bootstrap(5, pieces(&[(0, &[1.0]), (2, &[3.0, 4.0, 5.0])]), None).is_err());
        assert!(build_bootstrap(5, pieces(&[(0, &[1.0])]), None).is_err());
        assert!(build_bootstrap(0, BTreeMap::new(), None).is_ok());
    }
}

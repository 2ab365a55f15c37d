//! Decoders of what comes from the network.

use super::Choices;
use gatherlight_proto::Digest;
use gatherlight_proto::chunk::Assembler;
use gatherlight_proto::message::{DeliverHeader, FromWorker, PassRequest, Route, SceneManifest, ToWorker};
use gatherlight_proto::payload::{bootstrap, gather, light, map, photons};
use gatherlight_proto::types::{JobProgress, Limits};
use gatherlight_proto::wire::{self, Chunk};
use gatherlight_render::film::{ChannelSet, LightImage, TileGrid};
use gatherlight_render::photon::{EmissionRange, MapKind};
use gatherlight_render::settings::RenderSettings;
use prost::Message;
use std::fmt::Debug;

/// Longest payload that the chunks may announce here.
const LIMIT_BYTES: u64 = 1 << 16;
/// Most photons that a map may claim here.
const MAX_PHOTONS: u64 = 1 << 12;

/// The grid of the payloads: more tiles than one, those at the edges cut.
pub(super) const GRID: TileGrid = TileGrid { width: 37, height: 21 };

/// Their indices.
pub(super) const RANGE: EmissionRange = EmissionRange { first: 1, end: 4 };

/// A stream of length-delimited chunks is put together.
pub(super) fn chunks(mut bytes: &[u8]) {
    let mut assembler = Assembler::new("payload", LIMIT_BYTES, "LIMIT_BYTES");
    while !bytes.is_empty() {
        let Ok(chunk) = Chunk::decode_length_delimited(&mut bytes) else { return };
        if assembler.push(&chunk).is_err() {
            return;
        }
        assert!(assembler.received() <= LIMIT_BYTES);
    }
    if let Ok((payload, digest)) = assembler.finish() {
        assert_eq!(Digest::of(&payload), digest, "what is taken is what was announced");
    }
}

/// A message is decoded, checked, and survives the way back.
pub(super) fn messages(bytes: &[u8]) {
    let mut choices = Choices(bytes);
    let kind = choices.below(9);
    let bytes = choices.0;
    match kind {
        0 => survives::<wire::WorkerMessage, FromWorker>(bytes, |m| m.clone().into()),
        1 => survives::<wire::CoordinatorMessage, ToWorker>(bytes, |m| m.clone().into()),
        2 => survives::<wire::DeliverHeader, DeliverHeader>(bytes, |m| (*m).into()),
        3 => survives::<wire::Job, JobProgress>(bytes, |m| m.into()),
        4 => survives::<wire::RenderSettings, RenderSettings>(bytes, |m| m.into()),
        5 => survives::<wire::SceneManifest, SceneManifest>(bytes, |m| m.into()),
        7 => survives::<wire::Route, Route>(bytes, |m| m.clone().into()),
        8 => survives::<wire::PassRequest, PassRequest>(bytes, |&m| m.into()),
        _ => survives::<wire::Limits, Limits>(bytes, |m| (*m).into()),
    }
}

fn survives<W, D>(bytes: &[u8], back: impl Fn(&D) -> W)
where
    W: Message + Default,
    D: TryFrom<W> + PartialEq + Debug,
    D::Error: Debug,
{
    let Ok(message) = W::decode(bytes) else { return };
    let Ok(domain) = D::try_from(message) else { return };
    let again = D::try_from(back(&domain)).expect("what was taken once is taken again");
    // A number that is not one differs from itself; nothing of the kind gets through.
    assert_eq!(again, domain);
}

/// A result, a map or a bootstrap is decoded.
pub(super) fn payloads(bytes: &[u8]) {
    let mut choices = Choices(bytes);
    let kind = choices.below(8);
    let bytes = choices.0;
    let empty = LightImage::new(GRID, 1, 1.0);
    match kind {
        0 | 1 => {
            if let Ok(batch) = photons::decode_batch(bytes, RANGE, kind == 1) {
                assert_eq!(batch.range, RANGE);
            }
        }
        2 | 3 => {
            let of = MapKind::ALL[usize::from(kind - 2)];
            drop(map::decode_map(bytes, of, MAX_PHOTONS));
        }
        4 => {
            if let Ok(luminances) = bootstrap::decode(bytes, RANGE) {
                assert_eq!(luminances.len() as u64, RANGE.len());
            }
        }
        5 => drop(light::decode(bytes, &empty)),
        _ => {
            let light = (kind == 7).then_some(&empty);
            if let Ok((tiles, _)) = gather::decode(bytes, RANGE, GRID, &ChannelSet::new(&[]), light) {
                assert_eq!(tiles.len() as u64, RANGE.len());
            }
        }
    }
}

//! Transfers.

use super::micros;
use crate::collective::{Collective, Transfer, Transfers};
use crate::error::WireError;
use crate::wire;
use std::time::Duration;

impl From<Collective> for wire::Collective {
    fn from(c: Collective) -> Self {
        match c {
            Collective::BroadcastScene => wire::Collective::BroadcastScene,
            Collective::BroadcastMap => wire::Collective::BroadcastMap,
            Collective::BroadcastBootstrap => wire::Collective::BroadcastBootstrap,
            Collective::BroadcastSampleMap => wire::Collective::BroadcastSampleMap,
            Collective::GatherPhotons => wire::Collective::GatherPhotons,
            Collective::GatherLuminances => wire::Collective::GatherLuminances,
            Collective::GatherTiles => wire::Collective::GatherTiles,
            Collective::ReduceLight => wire::Collective::ReduceLight,
        }
    }
}

fn collective(value: i32) -> Result<Collective, WireError> {
    let known = Collective::ALL.into_iter().find(|&c| value == i32::from(wire::Collective::from(c)));
    known.ok_or_else(|| WireError::invalid("transfer.collective", format!("{value} is unknown here")))
}

/// As they are sent: those that there are any of.
pub(super) fn transfers(transfers: &Transfers) -> Vec<wire::Transfer> {
    let one = |(c, t): (Collective, Transfer)| wire::Transfer {
        collective: wire::Collective::from(c).into(),
        count: t.count,
        bytes: t.bytes,
        micros: micros(t.time),
    };
    transfers.iter().map(one).collect()
}

/// Refuses more than one entry a kind, and kinds that are unknown.
pub(super) fn read_transfers(sent: &[wire::Transfer]) -> Result<Transfers, WireError> {
    let limit = Collective::ALL.len() as u64;
    WireError::check_limit("kinds of transfers", sent.len() as u64, limit, "number of collectives")?;
    let mut transfers = Transfers::default();
    for t in sent {
        let kind = collective(t.collective)?;
        if transfers.of(kind).count > 0 || t.count == 0 {
            return Err(WireError::invalid("transfer", format!("{} twice, or none of them", kind.name())));
        }
        let transfer = Transfer { count: t.count, bytes: t.bytes, time: Duration::from_micros(t.micros) };
        transfers.record(kind, transfer);
    }
    Ok(transfers)
}

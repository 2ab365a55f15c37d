//! Memory for results on their way in: received or decoded, and not yet merged. Whoever delivers waits for room before any
//! of a result is sent, so workers that are faster than the merge wait, and nothing piles up here.
//!
//! What is to be merged next always finds room: results that have to wait here until another round is closed get at most
//! half of it, and every other one leaves again without waiting for any further result.

use crate::driver::Ticket;
use std::sync::Arc;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Bytes that one permit stands for.
const UNIT_BYTES: u64 = 1 << 10;
/// Bytes of a decoded photon or tile, and of what it was decoded from, for each byte on the wire.
const DECODED_FACTOR: u64 = 4;
/// Bytes of a pixel in a plane of a light image: three sums of 128 bits.
const SPLAT_BYTES: u64 = 48;

/// All the room there is; clones share it.
#[derive(Clone, Debug)]
pub(crate) struct Rooms {
    all: Arc<Semaphore>,
    /// The half that results may take which wait for another round.
    early: Arc<Semaphore>,
    /// Permits of a half.
    half: u32,
}

/// Memory taken by one result; given back when the last clone is dropped.
#[derive(Clone, Debug, Default)]
pub struct Room {
    _permits: Arc<Vec<OwnedSemaphorePermit>>,
}

impl Rooms {
    /// Room for `bytes`, rounded up to two units.
    pub(crate) fn new(bytes: u64) -> Self {
        let half = (bytes / UNIT_BYTES / 2).clamp(1, u64::from(u32::MAX / 2)) as u32;
        let semaphore = |permits: u32| Arc::new(Semaphore::new(permits as usize));
        Rooms { all: semaphore(2 * half), early: semaphore(half), half }
    }
    /// Waits until there is room for `bytes`, first come, first served; what is larger than half of all takes that half.
    pub(crate) async fn take(&self, bytes: u64, is_early: bool) -> Room {
        let units = bytes.div_ceil(UNIT_BYTES).clamp(1, u64::from(self.half)) as u32;
        let mut permits = Vec::with_capacity(2);
        // Neither semaphore is ever closed.
        if is_early {
            permits.extend(self.early.clone().acquire_many_owned(units).await.ok());
        }
        permits.extend(self.all.clone().acquire_many_owned(units).await.ok());
        Room { _permits: Arc::new(permits) }
    }
}

/// Bytes that a result of `bytes` on the wire may take here until it is merged.
pub(crate) fn needed(ticket: &Ticket, bytes: u64) -> u64 {
    let decoded = bytes.saturating_mul(DECODED_FACTOR);
    match &ticket.shape.light {
        Some(light) if ticket.phase.1.makes_image() => {
            let grid = light.grid();
            let pixels = u64::from(grid.width) * u64::from(grid.height);
            decoded.saturating_add(pixels * u64::from(light.planes()) * SPLAT_BYTES)
        }
        _ => decoded,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;
    use tokio::time::timeout;

    const KIB: u64 = 1 << 10;

    async fn take(rooms: &Rooms, kib: u64, is_early: bool) -> Option<Room> {
        timeout(Duration::from_millis(50), rooms.take(kib * KIB, is_early)).await.ok()
    }

    #[tokio::test]
    async fn more_than_there_is_room_for_waits_until_some_is_given_back() {
        let rooms = Rooms::new(100 * KIB);
        let (a, b) = (take(&rooms, 50, false).await, take(&rooms, 30, false).await);
        assert!(a.is_some() && b.is_some() && take(&rooms, 21, false).await.is_none());
        drop(b);
        assert!(take(&rooms, 50, false).await.is_some());
    }

    #[tokio::test]
    async fn what_is_to_be_merged_next_finds_room_however_much_is_early() {
        let rooms = Rooms::new(100 * KIB);
        let early = [take(&rooms, 30, true).await, take(&rooms, 20, true).await];
        assert!(early.iter().all(Option::is_some));
        assert!(take(&rooms, 1, true).await.is_none());
        // One that is larger than all of it, too.
        assert!(take(&rooms, 1_000, false).await.is_some());
    }

    #[tokio::test]
    async fn an_early_one_that_waits_does_not_keep_others_from_what_is_left() {
        let rooms = Rooms::new(100 * KIB);
        let _held = take(&rooms, 40, true).await;
        let own = rooms.clone();
        let waiting = tokio::spawn(async move { own.take(20 * KIB, true).await });
        tokio::task::yield_now().await;
        assert!(take(&rooms, 50, false).await.is_some());
        waiting.abort();
    }
}

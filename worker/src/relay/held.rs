//! What a worker holds as bytes: scene files for the next jobs, and what it passes on. Plain data, no network.

use super::transfer::Transfer;
use gatherlight_proto::Digest;
use gatherlight_proto::message::{BlobRef, PassTicket, Route};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// Part of a worker's memory for payloads that have arrived and that nobody here needs at the moment.
const KEPT_SHARE: u64 = 4;
/// Part of a worker's memory for payloads that are announced and arriving before they are needed.
const AHEAD_SHARE: u64 = 2;

/// See the module.
pub(super) struct Held {
    memory_bytes: u64,
    routes: BTreeMap<Digest, Route>,
    /// The latest used last.
    transfers: VecDeque<Arc<Transfer>>,
}

impl Held {
    /// Nothing, of a worker that may use `memory_bytes`.
    pub(super) fn new(memory_bytes: u64) -> Self {
        Held { memory_bytes, routes: BTreeMap::new(), transfers: VecDeque::new() }
    }
    /// Takes in a route. The earlier one to the same payload is forgotten.
    pub(super) fn put_route(&mut self, route: Route) {
        self.routes.insert(route.blob.digest, route);
    }
    /// The way to this payload, if it was told.
    pub(super) fn route(&self, digest: Digest) -> Option<Route> {
        self.routes.get(&digest).cloned()
    }
    /// Whether this ticket lets its holder have this payload; `None`: not known (yet).
    pub(super) fn admits(&self, digest: Digest, ticket: &PassTicket) -> Option<bool> {
        self.routes.get(&digest).map(|r| r.ticket.is(ticket))
    }
    /// Forgets all routes, which were of a session that is over. What has arrived stays.
    pub(super) fn forget_routes(&mut self) {
        self.routes.clear();
    }
    /// This payload, if it is here or arriving.
    pub(super) fn get(&mut self, digest: Digest) -> Option<Arc<Transfer>> {
        let place = self.transfers.iter().position(|t| t.blob().digest == digest)?;
        let transfer = self.transfers.remove(place).filter(|t| !t.is_failed())?;
        self.transfers.push_back(transfer.clone());
        Some(transfer)
    }
    /// The same, or a new one, which is to be filled; says whether it is new.
    pub(super) fn get_or_begin(&mut self, blob: BlobRef) -> (Arc<Transfer>, bool) {
        if let Some(transfer) = self.get(blob.digest) {
            return (transfer, false);
        }
        self.make_room();
        let transfer = Arc::new(Transfer::new(blob));
        self.transfers.push_back(transfer.clone());
        (transfer, true)
    }
    /// Whether a payload of `bytes` may be fetched before it is needed.
    pub(super) fn has_room_ahead(&self, bytes: u64) -> bool {
        let arriving: u64 = self.transfers.iter().filter(|t| !t.is_complete()).map(|t| t.blob().bytes).sum();
        arriving.saturating_add(bytes) <= self.memory_bytes / AHEAD_SHARE
    }
    /// Drops this payload, and the way to it.
    pub(super) fn forget(&mut self, digest: Digest) {
        self.routes.remove(&digest);
        self.transfers.retain(|t| t.blob().digest != digest);
    }
    /// Drops the oldest payloads that are here until the rest is within its share. Who is reading one keeps it alive.
    pub(super) fn make_room(&mut self) {
        self.transfers.retain(|t| !t.is_failed());
        let mut kept: u64 = self.transfers.iter().filter(|t| t.is_complete()).map(|t| t.blob().bytes).sum();
        let limit = self.memory_bytes / KEPT_SHARE;
        self.transfers.retain(|t| {
            let drop = kept > limit && t.is_complete();
            kept -= if drop { t.blob().bytes } else { 0 };
            !drop
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gatherlight_proto::pieces::Pieces;

    fn complete(held: &mut Held, n: u8, bytes: usize) -> BlobRef {
        let payload = Pieces::of(vec![n; bytes].into());
        let blob = BlobRef { digest: payload.list().digest(), bytes: bytes as u64 };
        let (transfer, is_new) = held.get_or_begin(blob);
        assert!(is_new);
        transfer.put_list(&payload.list().to_bytes()).unwrap();
        transfer.put(0, 0, payload.bytes()).unwrap();
        blob
    }

    fn kept(held: &mut Held, blobs: &[BlobRef]) -> Vec<bool> {
        held.make_room();
        blobs.iter().map(|b| held.transfers.iter().any(|t| t.blob() == *b)).collect()
    }

    #[test]
    fn what_has_arrived_is_kept_within_a_quarter_of_the_memory_the_latest_used_longest() {
        let mut held = Held::new(4_000);
        let blobs: Vec<BlobRef> = (0..3).map(|n| complete(&mut held, n, 300)).collect();
        assert!(held.get(blobs[0].digest).is_some());
        let more = complete(&mut held, 9, 300);
        assert_eq!(kept(&mut held, &[blobs[0], blobs[1], blobs[2], more]), [true, false, true, true]);
        let large = complete(&mut held, 10, 1_001);
        assert_eq!(kept(&mut held, &[blobs[0], large]), [false, false]);
    }

    #[test]
    fn what_is_announced_is_fetched_ahead_within_half_of_the_memory() {
        let mut held = Held::new(1_000);
        assert!(held.has_room_ahead(500) && !held.has_room_ahead(501));
        let arriving = BlobRef { digest: Digest([7; 32]), bytes: 300 };
        let (transfer, _) = held.get_or_begin(arriving);
        assert!(held.has_room_ahead(200) && !held.has_room_ahead(201));
        transfer.fail("gone".into());
        assert!(held.get(arriving.digest).is_none() && held.has_room_ahead(500));
    }

    #[test]
    fn tickets_are_of_a_session() {
        let mut held = Held::new(1_000);
        let blob = BlobRef { digest: Digest([7; 32]), bytes: 300 };
        let (mine, other) = (PassTicket([1; 16]), PassTicket([2; 16]));
        assert_eq!(held.admits(blob.digest, &mine), None);
        held.put_route(Route { blob, ticket: mine, sources: Default::default() });
        assert_eq!([mine, other].map(|t| held.admits(blob.digest, &t)), [Some(true), Some(false)]);
        held.forget_routes();
        assert_eq!(held.admits(blob.digest, &mine), None);
        held.get_or_begin(blob);
        held.forget(blob.digest);
        assert!(held.get(blob.digest).is_none());
    }
}

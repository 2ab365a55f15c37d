//! The broadcast collective: which worker gets a payload from whom.
//!
//! A payload is announced to all workers that relay when it is first needed: each is told its sources and begins at once. Who
//! joins later is a latecomer and nobody's source. No payload passes through here, only digests, addresses and tickets.

pub mod plan;

use gatherlight_proto::Digest;
use gatherlight_proto::message::{BlobRef, PassTicket, Route, WorkerId};
use gatherlight_proto::pieces::STRIPES;
use std::collections::BTreeMap;
use std::net::SocketAddr;

/// One payload on its way.
#[derive(Debug)]
struct Broadcast {
    blob: BlobRef,
    ticket: PassTicket,
    /// Workers that relay and were there when it was announced, in the order of the plan.
    members: Vec<(WorkerId, SocketAddr)>,
    /// Halves that each of them passes on.
    halves: Vec<u32>,
}

impl Broadcast {
    fn route(&self, sources: [Vec<SocketAddr>; STRIPES]) -> Route {
        Route { blob: self.blob, ticket: self.ticket, sources }
    }
    fn to_member(&self, place: usize) -> Route {
        let addresses =
            |stripe| plan::sources(stripe, place, self.members.len()).map(|p| self.members[p].1).collect::<Vec<_>>();
        self.route(std::array::from_fn(addresses))
    }
}

/// All payloads on their way.
#[derive(Debug, Default)]
pub struct Broadcasts {
    by_digest: BTreeMap<Digest, Broadcast>,
}

impl Broadcasts {
    /// Begins to broadcast `blob` to the workers that relay, or begins anew; returns what each of them has to be told.
    pub fn announce(
        &mut self,
        blob: BlobRef,
        ticket: PassTicket,
        members: Vec<(WorkerId, SocketAddr)>,
    ) -> Vec<(WorkerId, Route)> {
        let halves = plan::halves(members.len());
        let broadcast = Broadcast { blob, ticket, members, halves };
        let routes = broadcast.members.iter().enumerate().map(|(place, m)| (m.0, broadcast.to_member(place))).collect();
        self.by_digest.insert(blob.digest, broadcast);
        routes
    }
    /// The way to `worker`, where the payload was announced. A member's is what it was told; a latecomer that `relays` asks
    /// for each half a member that is still `there` and passes on least; any other worker asks the coordinator.
    pub fn route(
        &mut self,
        digest: Digest,
        worker: WorkerId,
        relays: bool,
        there: impl Fn(WorkerId) -> bool,
    ) -> Option<Route> {
        let broadcast = self.by_digest.get_mut(&digest)?;
        if let Some(place) = broadcast.members.iter().position(|m| m.0 == worker) {
            return Some(broadcast.to_member(place));
        }
        if !relays {
            return Some(broadcast.route(Default::default()));
        }
        let Broadcast { members, halves, .. } = &mut *broadcast;
        let mut host = || plan::host(halves, |p| there(members[p].0)).map(|p| members[p].1).into_iter().collect();
        let sources = std::array::from_fn(|_| host());
        Some(broadcast.route(sources))
    }
    /// Whether the payload was announced.
    pub fn is_announced(&self, digest: Digest) -> bool {
        self.by_digest.contains_key(&digest)
    }
    /// Whether this ticket lets its holder have this payload.
    pub fn admits(&self, digest: Digest, ticket: &PassTicket) -> bool {
        self.by_digest.get(&digest).is_some_and(|b| b.ticket.is(ticket))
    }
    /// Forgets payloads that are not `wanted` any more.
    pub fn retain(&mut self, wanted: impl Fn(Digest) -> bool) {
        self.by_digest.retain(|&digest, _| wanted(digest));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn members(count: u64) -> Vec<(WorkerId, SocketAddr)> {
        (0..count).map(|i| (WorkerId(i), SocketAddr::from(([10, 0, 0, i as u8], 7421)))).collect()
    }

    const BLOB: BlobRef = BlobRef { digest: Digest([3; 32]), bytes: 1 << 20 };
    const TICKET: PassTicket = PassTicket([4; 16]);

    #[test]
    fn members_are_told_their_sources_and_hear_the_same_when_they_ask() {
        let mut broadcasts = Broadcasts::default();
        let routes = broadcasts.announce(BLOB, TICKET, members(5));
        assert_eq!(routes.len(), 5);
        for (worker, route) in routes {
            assert_eq!((route.blob, route.ticket), (BLOB, TICKET));
            assert_eq!(broadcasts.route(BLOB.digest, worker, true, |_| true), Some(route));
        }
    }

    #[test]
    fn latecomers_share_those_who_are_still_there_and_the_others_ask_the_coordinator() {
        let mut broadcasts = Broadcasts::default();
        broadcasts.announce(BLOB, TICKET, members(3));
        let mut sources = |worker, relays, there: u64| {
            let route =
                broadcasts.route(BLOB.digest, WorkerId(worker), relays, |w| w.0 < there).expect("was announced");
            route.sources
        };
        let both = |i: usize, j: usize| [vec![members(3)[i].1], vec![members(3)[j].1]];
        // Of three, the first and the last pass on two halves each.
        assert_eq!(
            [sources(7, true, 2), sources(8, true, 2), sources(9, true, 2)],
            [both(1, 1), both(0, 1), both(0, 1)]
        );
        assert_eq!(sources(9, true, 0), [vec![], vec![]]);
        assert_eq!(sources(9, false, 3), [vec![], vec![]]);
        assert_eq!(broadcasts.route(Digest([9; 32]), WorkerId(1), true, |_| true), None);
    }

    #[test]
    fn a_ticket_admits_to_its_payload_as_long_as_that_is_wanted() {
        let mut broadcasts = Broadcasts::default();
        broadcasts.announce(BLOB, TICKET, Vec::new());
        let admits = |b: &Broadcasts, digest, ticket| b.admits(Digest([digest; 32]), &PassTicket([ticket; 16]));
        assert_eq!([(3, 4), (3, 5), (2, 4)].map(|(d, t)| admits(&broadcasts, d, t)), [true, false, false]);
        broadcasts.retain(|digest| digest != BLOB.digest);
        assert!(!admits(&broadcasts, 3, 4));
    }
}

//! Telling workers from whom they get what they read, and who may have it from here.

use super::Driver;
use super::handle::Source;
use crate::random::random_bytes;
use gatherlight_proto::Digest;
use gatherlight_proto::message::{BlobRef, PassTicket, Route, SessionKey, ToWorker, WorkerId};

impl Driver {
    /// Tells the workers that relay, have the memory for it and keep up, to get `blob` and pass it on. One that does not may come later, as
    /// nobody's source.
    pub(super) fn announce(&mut self, blob: BlobRef) {
        let ticket = PassTicket(random_bytes());
        let (now, quiet) = (self.now(), self.scheduler.policy().quiet_after);
        let keeps_up = |id: WorkerId| self.scheduler.workers().get(&id).is_some_and(|w| w.is_prompt(now, quiet));
        let mut members = self.sessions.relays(blob.bytes);
        members.retain(|&(id, _)| keeps_up(id));
        for (worker, route) in self.broadcasts.announce(blob, ticket, members) {
            self.send(worker, ToWorker::Route(route));
        }
    }

    /// From whom the worker of this session gets this digest; a scene blob is announced when the first one asks.
    pub(super) fn locate(&mut self, session: SessionKey, digest: Digest) -> Option<Route> {
        let worker = self.sessions.worker(session)?;
        let source = self.source(digest)?;
        if !self.broadcasts.is_announced(digest) {
            self.announce(BlobRef { digest, bytes: source.len(&self.store)? });
        }
        let (relays, sessions) = (self.sessions.relays_itself(worker), &self.sessions);
        self.broadcasts.route(digest, worker, relays, |w| sessions.is_open(w))
    }

    /// The bytes that this ticket lets its holder have from here.
    pub(super) fn pass(&self, digest: Digest, ticket: &PassTicket) -> Option<Source> {
        self.broadcasts.admits(digest, ticket).then(|| self.source(digest)).flatten()
    }

    /// Forgets the ways of what no job serves any more.
    pub(super) fn end_broadcasts(&mut self) {
        let mut broadcasts = std::mem::take(&mut self.broadcasts);
        broadcasts.retain(|digest| self.source(digest).is_some());
        self.broadcasts = broadcasts;
    }
}

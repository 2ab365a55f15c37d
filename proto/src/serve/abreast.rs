//! Keeping the streams of one payload abreast as they are handed out.
//!
//! Streams that share a link do not share it equally, and whoever is below the slower one has a link to spare at first and
//! lacks it later: with shares of 40 and 60 % a broadcast over two trees takes a sixth longer than with equal ones. So a stream that
//! is ahead waits for those that are a little behind, but for none that has stopped or crawls.

use crate::pieces::STRIPES;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::Notify;
use tokio::time::{Instant, timeout};

/// Pieces that one stream may be ahead of another.
const AHEAD: u64 = 8;
/// Pieces behind at which a stream is not waited for: it began later.
const BEHIND: u64 = 8 * AHEAD;
/// Longest wait for others, at a time and beyond half of all time. Who shares a link is quick while nobody else uses it; who is
/// not is slow by itself, and holds nobody up any longer.
const PATIENCE: Duration = Duration::from_millis(250);

/// The streams of one payload that leave here; clones share them.
#[derive(Clone, Debug, Default)]
pub struct Abreast(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    /// Pieces handed out of each stream, counted within its stripe.
    streams: Mutex<BTreeMap<u64, u64>>,
    moved: Notify,
}

/// One stream among those of its payload, until it is dropped.
#[derive(Debug)]
pub struct Place {
    shared: Arc<Shared>,
    id: u64,
    began: Instant,
    waited: Duration,
    is_patient: bool,
}

impl Abreast {
    /// A stream of the stripe that piece `first` of the payload is in, from that piece on.
    pub fn join(&self, first: u64) -> Place {
        let mut streams = self.0.lock();
        let id = streams.last_key_value().map_or(0, |(id, _)| id + 1);
        streams.insert(id, first / STRIPES as u64);
        Place { shared: self.0.clone(), id, began: Instant::now(), waited: Duration::ZERO, is_patient: true }
    }
    /// Whether there is no stream.
    pub fn is_idle(&self) -> bool {
        self.0.lock().is_empty()
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<u64, u64>> {
        self.streams.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Place {
    /// Waits until the next piece of this stream may be handed out, and counts it.
    pub async fn advance(&mut self) {
        if self.is_patient && self.has_to_wait() {
            let began = Instant::now();
            let left = (PATIENCE + (began - self.began) / 2).saturating_sub(self.waited).min(PATIENCE);
            self.is_patient = timeout(left, self.others()).await.is_ok();
            self.waited += began.elapsed();
        }
        if let Some(own) = self.shared.lock().get_mut(&self.id) {
            *own += 1;
        }
        self.shared.moved.notify_waiters();
    }
    /// Ready when nobody has to be waited for.
    async fn others(&self) {
        loop {
            let moved = self.shared.moved.notified();
            tokio::pin!(moved);
            // From here on no move is missed.
            moved.as_mut().enable();
            if !self.has_to_wait() {
                return;
            }
            moved.await;
        }
    }
    fn has_to_wait(&self) -> bool {
        let streams = self.shared.lock();
        let own = streams.get(&self.id).copied().unwrap_or(0);
        streams.values().any(|&other| (AHEAD..BEHIND).contains(&own.saturating_sub(other)))
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.shared.lock().remove(&self.id);
        self.shared.moved.notify_waiters();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    async fn advance(place: &mut Place, pieces: u64) -> Duration {
        let began = Instant::now();
        for _ in 0..pieces {
            place.advance().await;
        }
        began.elapsed()
    }

    /// Hands out a piece every `period`.
    async fn walk(mut place: Place, pieces: u64, period: Duration) {
        for _ in 0..pieces {
            tokio::time::sleep(period).await;
            place.advance().await;
        }
    }

    #[tokio::test(start_paused = true)]
    async fn who_is_ahead_waits_for_who_is_a_little_behind() {
        let payload = Abreast::default();
        let (mut fast, slow) = (payload.join(0), payload.join(0));
        assert_eq!(advance(&mut fast, AHEAD).await, Duration::ZERO);
        let period = Duration::from_millis(10);
        let walking = tokio::spawn(walk(slow, 20, period));
        assert_eq!(advance(&mut fast, 20).await, 20 * period);
        assert!(walking.await.is_ok());
        assert_eq!(advance(&mut fast, 100).await, Duration::ZERO);
    }

    #[tokio::test(start_paused = true)]
    async fn nobody_waits_long_for_who_has_stopped_or_crawls() {
        let payload = Abreast::default();
        let (mut fast, stopped) = (payload.join(0), payload.join(0));
        assert_eq!(advance(&mut fast, 1_000).await, PATIENCE);
        drop((fast, stopped));
        let (mut fast, slow) = (payload.join(0), payload.join(0));
        tokio::spawn(walk(slow, 1_000, Duration::from_millis(100)));
        let waited = advance(&mut fast, 1_000).await;
        assert!((PATIENCE..=2 * PATIENCE).contains(&waited), "{waited:?}");
    }

    #[tokio::test(start_paused = true)]
    async fn nobody_waits_for_who_begins_much_later_or_is_gone() {
        let payload = Abreast::default();
        let mut first = payload.join(0);
        advance(&mut first, 100).await;
        let mut late = payload.join(0);
        assert_eq!(advance(&mut first, 100).await, Duration::ZERO);
        assert_eq!(advance(&mut late, 100).await, Duration::ZERO);
        drop(first);
        assert_eq!(advance(&mut late, 500).await, Duration::ZERO);
        assert!(!payload.is_idle());
        drop(late);
        assert!(payload.is_idle());
    }
}

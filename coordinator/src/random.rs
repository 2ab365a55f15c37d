//! Numbers that cannot be guessed, for ids and sessions. Never for light transport.

use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher, Hasher};
use std::sync::atomic::{AtomicU64, Ordering};

static COUNTER: AtomicU64 = AtomicU64::new(0);

/// 64 random bits: SipHash of a counter under keys that the operating system drew.
pub(crate) fn random_u64() -> u64 {
    let mut hasher = RandomState::new().build_hasher();
    hasher.write_u64(COUNTER.fetch_add(1, Ordering::Relaxed));
    hasher.finish()
}

#[cfg(test)]
mod tests {
    #[test]
    fn numbers_do_not_repeat() {
        let drawn: std::collections::BTreeSet<u64> = (0..1_000).map(|_| super::random_u64()).collect();
        assert_eq!(drawn.len(), 1_000);
    }
}

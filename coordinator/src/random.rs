//! Numbers that cannot be guessed, for ids, sessions and tokens. Never for light transport.

/// `N` random bytes of the operating system.
///
/// # Panics
/// When it has none, which a running system always has: without them nothing here would be secret.
pub(crate) fn random_bytes<const N: usize>() -> [u8; N] {
    let mut bytes = [0; N];
    if let Err(error) = getrandom::fill(&mut bytes) {
        panic!("the operating system gives no random numbers: {error}");
    }
    bytes
}

/// 64 random bits.
pub(crate) fn random_u64() -> u64 {
    u64::from_le_bytes(random_bytes())
}

#[cfg(test)]
mod tests {
    #[test]
    fn numbers_do_not_repeat() {
        let drawn: std::collections::BTreeSet<u64> = (0..1_000).map(|_| super::random_u64()).collect();
        assert_eq!(drawn.len(), 1_000);
    }
}

//! How much of something each peer may have at once.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use tokio_stream::{Stream, StreamExt};
use tonic::Status;

/// At most `limit` of something for each key: the owner of jobs, or `()` for all together.
#[derive(Debug)]
pub(super) struct Quota<K> {
    what: &'static str,
    limit: usize,
    open: Arc<Mutex<BTreeMap<K, usize>>>,
}

/// One of them, given back when dropped.
#[derive(Debug)]
pub(super) struct Slot<K: Ord> {
    key: K,
    open: Arc<Mutex<BTreeMap<K, usize>>>,
}

impl<K: Ord + Clone> Quota<K> {
    /// `what` names them in refusals.
    pub(super) fn new(what: &'static str, limit: usize) -> Self {
        Quota { what, limit, open: Arc::default() }
    }
    /// One more for `key`.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED`, when it has as many as it may have.
    pub(super) fn take(&self, key: K) -> Result<Slot<K>, Status> {
        let mut counts = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let count = counts.entry(key.clone()).or_default();
        if *count >= self.limit {
            let (what, limit) = (self.what, self.limit);
            return Err(Status::resource_exhausted(format!("{limit} {what} are open already, the most at once")));
        }
        *count += 1;
        Ok(Slot { key, open: self.open.clone() })
    }
}

impl<K: Ord> Drop for Slot<K> {
    fn drop(&mut self) {
        let mut counts = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = counts.get_mut(&self.key) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&self.key);
            }
        }
    }
}

/// `stream`, which keeps `held` until it ends or is dropped.
pub(super) fn holding<T, H>(stream: impl Stream<Item = T> + Send, held: H) -> impl Stream<Item = T> + Send
where
    H: Send,
{
    stream.map(move |item| {
        let _ = &held;
        item
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_key_has_its_own_and_gets_them_back() {
        let quota = Quota::new("uploads", 2);
        let first = quota.take("a").expect("one");
        let _second = quota.take("a").expect("two");
        let refused = quota.take("a").expect_err("no third one");
        assert_eq!(refused.code(), tonic::Code::ResourceExhausted);
        assert!(refused.message().contains("2 uploads"), "{refused}");
        let _other = quota.take("b").expect("another's");
        drop(first);
        let third = quota.take("a").expect("again");
        drop((third, _second, _other));
        assert!(quota.open.lock().expect("is not poisoned").is_empty(), "nothing is left behind");
    }
}

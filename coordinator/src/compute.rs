//! The threads that compute, apart from those that wait.

use rayon::{ThreadPool, ThreadPoolBuilder};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use tokio::sync::oneshot;

/// Shared handle to a pool of compute threads.
#[derive(Clone, Debug)]
pub struct Compute {
    pool: Arc<ThreadPool>,
    /// Computations that wait or run.
    open: Arc<AtomicUsize>,
}

/// A computation that did not come to its end.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a computation panicked: {0}")]
pub struct Panicked(pub String);

impl Compute {
    /// `threads` threads; 0: one per core.
    ///
    /// # Errors
    /// When the system gives no threads.
    pub fn new(threads: usize) -> Result<Self, String> {
        let builder = ThreadPoolBuilder::new().num_threads(threads).thread_name(|i| format!("compute-{i}"));
        let pool = builder.build().map_err(|e| e.to_string())?;
        Ok(Compute { pool: Arc::new(pool), open: Arc::default() })
    }
    /// The pool itself.
    pub fn pool(&self) -> &Arc<ThreadPool> {
        &self.pool
    }
    /// Computations that wait or run.
    pub fn open(&self) -> usize {
        self.open.load(Ordering::Relaxed)
    }
    /// Runs `f` on the pool without waiting, then `report` with what came of it: always, even when `f` panics.
    pub fn spawn<T>(
        &self,
        f: impl FnOnce() -> T + Send + 'static,
        report: impl FnOnce(Result<T, Panicked>) + Send + 'static,
    ) {
        let open = self.open.clone();
        open.fetch_add(1, Ordering::Relaxed);
        self.pool.spawn(move || {
            let result = catch_unwind(AssertUnwindSafe(f)).map_err(|panic| Panicked(message(&*panic)));
            if let Err(error) = &result {
                tracing::error!(%error);
            }
            open.fetch_sub(1, Ordering::Relaxed);
            report(result);
        });
    }
    /// Runs `f` on the pool and waits for it without holding an async thread.
    ///
    /// # Errors
    /// When `f` panics.
    pub async fn run<T: Send + 'static>(&self, f: impl FnOnce() -> T + Send + 'static) -> Result<T, Panicked> {
        let (reply, result) = oneshot::channel();
        self.spawn(f, move |result| drop(reply.send(result)));
        result.await.unwrap_or_else(|_| Err(Panicked("its thread ended".into())))
    }
}

fn message(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "no message".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn results_and_panics_come_back() {
        let compute = Compute::new(1).expect("a thread");
        assert_eq!(compute.run(|| 6 * 7).await, Ok(42));
        assert_eq!(compute.run(|| panic!("as {}", "meant")).await, Err::<(), _>(Panicked("as meant".into())));
        assert_eq!(compute.run(|| 1).await, Ok(1));
    }
}

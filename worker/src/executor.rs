//! The compute threads.

use crate::error::TaskError;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use tokio::sync::oneshot;

/// A pool of compute threads; async threads only wait for it.
#[derive(Clone, Debug)]
pub struct Executor {
    pool: Arc<ThreadPool>,
}

impl Executor {
    /// `threads` threads; 0: one per core.
    ///
    /// # Errors
    /// When the system gives none.
    pub fn new(threads: usize) -> Result<Self, String> {
        let builder = ThreadPoolBuilder::new().num_threads(threads).thread_name(|i| format!("render-{i}"));
        Ok(Executor { pool: Arc::new(builder.build().map_err(|e| e.to_string())?) })
    }
    /// Number of threads.
    pub fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }
    /// Runs `f` on the pool.
    ///
    /// # Errors
    /// When `f` panics.
    pub async fn run<T: Send + 'static>(&self, f: impl FnOnce() -> T + Send + 'static) -> Result<T, TaskError> {
        let (reply, result) = oneshot::channel();
        self.pool.spawn(move || {
            let result = catch_unwind(AssertUnwindSafe(f)).map_err(|panic| TaskError::Panicked(message(&*panic)));
            drop(reply.send(result));
        });
        result.await.unwrap_or_else(|_| Err(TaskError::Panicked("its thread ended".into())))
    }
}

fn message(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "no message".into())
}

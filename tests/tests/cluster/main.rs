//! Coordinator and workers, in this process or as programs of their own. One test program, since each would compile the same
//! asynchronous code again.

mod access;
mod determinism;
mod hostile;
mod jobs;
mod processes;
mod relay;
mod restart;
mod store_faults;

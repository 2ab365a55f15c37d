//! What clients see of jobs and workers.

use gatherlight_render::export::ImageMetadata;
use gatherlight_render::film::Film;
use std::time::Duration;

pub use gatherlight_proto::types::{
    JobId, JobProgress, JobState, JobStats, Limit, Limits, MapStats, NonFinite, ParseJobIdError, WorkerInfo,
};

/// A finished job of [`crate::embedded::render`].
#[derive(Clone, Debug)]
pub struct JobResult {
    /// The image.
    pub film: Film,
    /// How it was made, for its file.
    pub metadata: ImageMetadata,
    /// Counts.
    pub stats: JobStats,
    /// Wall time.
    pub elapsed: Duration,
}

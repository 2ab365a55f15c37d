//! A whole job in this process: the cluster's own coordinator and workers, joined by in-memory streams.

use crate::types::{JobProgress, JobResult};
use gatherlight_render::import::SceneBundle;
use gatherlight_render::settings::RenderSettings;

/// Where to compute; cannot change the image.
#[derive(Clone, Debug)]
pub struct Config {
    /// Compute threads of each worker; 0: one per core.
    pub threads: usize,
    /// Workers, ≥ 1.
    pub workers: usize,
}

impl Default for Config {
    fn default() -> Self {
        Config { threads: 0, workers: 1 }
    }
}

/// Why an embedded render did not finish.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The scene or a setting is at fault.
    #[error(transparent)]
    Job(#[from] gatherlight_render::job::JobError),
    /// The job failed; the text says why.
    #[error("{0}")]
    Failed(String),
    /// Threads or the in-memory cluster could not be started.
    #[error("cannot start: {0}")]
    Start(String),
}

/// Renders `bundle` with `settings` and blocks until done. `progress` is called at most ten times a second, on another
/// thread than the caller's, and last with the final state.
///
/// # Errors
/// When the scene or the settings make no sense, or the work failed.
pub fn render(
    _bundle: &SceneBundle,
    _settings: &RenderSettings,
    _config: &Config,
    _progress: impl FnMut(&JobProgress) + Send,
) -> Result<JobResult, RenderError> {
    Err(RenderError::Start("the in-process cluster is not there yet".into()))
}

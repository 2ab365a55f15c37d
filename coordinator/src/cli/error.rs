//! Why a command did not do its work, and the exit code that tells so.

use crate::client::ClientError;
use crate::embedded::RenderError;
use crate::server::ServeError;
use gatherlight_render::error::{ImageError, SceneError, SettingsError};
use gatherlight_render::job::JobError;

/// A failed command. Its text says what was wrong, where, and what to do.
#[derive(Debug, thiserror::Error)]
pub(super) enum CliError {
    /// What was asked for makes no sense; exit code 2.
    #[error("{0}")]
    Usage(String),
    /// The work failed; exit code 1.
    #[error("{0}")]
    Failed(String),
    /// The user interrupted; the text, if any, is already printed. Exit code 130, as shells have it.
    #[error("interrupted")]
    Interrupted,
}

impl CliError {
    /// The process's exit code.
    pub(super) fn exit_code(&self) -> u8 {
        match self {
            CliError::Usage(_) => 2,
            CliError::Failed(_) => 1,
            CliError::Interrupted => 130,
        }
    }
}

/// What a command returns.
pub(super) type CliResult = Result<(), CliError>;

impl From<SettingsError> for CliError {
    fn from(e: SettingsError) -> Self {
        CliError::Usage(e.to_string())
    }
}

impl From<JobError> for CliError {
    fn from(e: JobError) -> Self {
        match e {
            JobError::Settings(e) => e.into(),
            // A camera that is not there is a wrong option, though only the scene can tell.
            JobError::Scene(SceneError::Invalid { place, message }) if place.starts_with("--") => {
                CliError::Usage(format!("{place}: {message}"))
            }
            JobError::Scene(e) => CliError::Failed(e.to_string()),
        }
    }
}

impl From<RenderError> for CliError {
    fn from(e: RenderError) -> Self {
        match e {
            RenderError::Job(e) => e.into(),
            other => CliError::Failed(other.to_string()),
        }
    }
}

impl From<ClientError> for CliError {
    fn from(e: ClientError) -> Self {
        match e {
            ClientError::Url { .. } => CliError::Usage(e.to_string()),
            other => CliError::Failed(other.to_string()),
        }
    }
}

impl From<ServeError> for CliError {
    fn from(e: ServeError) -> Self {
        match e {
            ServeError::Access(text) => CliError::Usage(text),
            other => CliError::Failed(other.to_string()),
        }
    }
}

impl From<ImageError> for CliError {
    fn from(e: ImageError) -> Self {
        CliError::Failed(e.to_string())
    }
}

//! From a submission to a job: blobs there, scene loaded and prepared, then the driver.

use crate::compute::Compute;
use crate::driver::{Handle, Spec, SubmitError};
use crate::store::Store;
use crate::types::{JobId, Limits};
use gatherlight_proto::message::{BlobRef, SceneManifest};
use gatherlight_render::import::SceneBundle;
use gatherlight_render::job::{JobError, PreparedJob};
use gatherlight_render::settings::RenderSettings;
use std::sync::Arc;

/// What a client wants.
#[derive(Clone, Debug)]
pub(crate) struct Submission {
    /// Name for listings.
    pub(crate) name: String,
    /// Name of the token that submits it; empty where there are none.
    pub(crate) owner: String,
    /// Makes a repeated submission the same job.
    pub(crate) request_key: [u8; 16],
    /// The scene's files, all in the store.
    pub(crate) manifest: SceneManifest,
    /// What determines the image.
    pub(crate) settings: RenderSettings,
    /// When to end it early.
    pub(crate) limits: Limits,
    /// Jobs of higher priority get workers first.
    pub(crate) priority: i32,
}

/// Why a submission did not become a job.
#[derive(Debug, thiserror::Error)]
pub(crate) enum IntakeError {
    /// Scene or settings are at fault.
    #[error(transparent)]
    Job(#[from] JobError),
    /// A blob was not uploaded, or its length is not the one the manifest says.
    #[error("{0}")]
    Blob(String),
    /// There are too many jobs.
    #[error(transparent)]
    Driver(#[from] SubmitError),
    /// The scene could not be prepared for a reason that is not its own.
    #[error("{0}")]
    Internal(String),
}

/// Prepares the scene on the compute threads and hands the job to the driver.
///
/// # Errors
/// When blobs are missing, the scene or the settings are at fault, or there are too many jobs.
pub(crate) async fn submit(
    driver: &Handle,
    compute: &Compute,
    store: &Arc<Store>,
    submission: Submission,
) -> Result<JobId, IntakeError> {
    if let Some(job) = driver.find(&submission.owner, submission.request_key).await {
        return Ok(job);
    }
    let Submission { name, request_key, manifest, settings, limits, priority, owner } = submission;
    let (files, own) = (manifest.clone(), settings.clone());
    let blobs = store.clone();
    let prepare = move || {
        let bundle = load(&blobs, &files)?;
        PreparedJob::prepare(&bundle, &own).map_err(IntakeError::from)
    };
    let prepared = compute.run(prepare).await.map_err(|e| IntakeError::Internal(e.to_string()))??;
    let prepared = Arc::new(prepared);
    Ok(driver.submit(Spec { name, request_key, manifest, settings, limits, priority, owner, prepared }).await?)
}

pub(crate) fn load(store: &Store, manifest: &SceneManifest) -> Result<SceneBundle, IntakeError> {
    let file = |what: &str, blob: BlobRef| -> Result<Arc<[u8]>, IntakeError> {
        let bytes = store.get(blob.digest).map_err(|e| IntakeError::Blob(format!("{what}: {e}")))?;
        if bytes.len() as u64 != blob.bytes {
            let text = format!("{what}: has {} bytes, the manifest says {}", bytes.len(), blob.bytes);
            return Err(IntakeError::Blob(text));
        }
        Ok(Arc::from(&bytes[..]))
    };
    Ok(SceneBundle {
        name: manifest.name.clone(),
        root: file(&manifest.name, manifest.root)?,
        externals: manifest
            .externals
            .iter()
            .map(|(uri, blob)| Ok((uri.clone(), file(uri, *blob)?)))
            .collect::<Result<_, IntakeError>>()?,
    })
}

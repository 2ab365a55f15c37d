//! From a submission to a job: blobs there, scene loaded and prepared, then the driver.

use crate::compute::Compute;
use crate::driver::{Handle, Spec, SubmitError};
use crate::store::Store;
use crate::types::JobId;
use gatherlight_proto::message::{BlobRef, SceneManifest, Submission};
use gatherlight_render::import::SceneBundle;
use gatherlight_render::job::{JobError, PreparedJob};
use std::sync::Arc;

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

/// Prepares the scene on the compute threads and hands the job of `owner` to the driver.
///
/// # Errors
/// When blobs are missing, the scene or the settings are at fault, or there are too many jobs.
pub(crate) async fn submit(
    driver: &Handle,
    compute: &Compute,
    store: &Arc<Store>,
    owner: &str,
    submission: Submission,
) -> Result<JobId, IntakeError> {
    if let Some(job) = driver.find(owner, submission.request_key).await {
        return Ok(job);
    }
    let (blobs, own) = (store.clone(), submission.clone());
    let prepared = compute.run(move || prepare(&blobs, &own)).await;
    let prepared = prepared.map_err(|e| IntakeError::Internal(e.to_string()))??;
    Ok(driver.submit(Spec { submission, owner: owner.to_owned(), prepared }).await?)
}

/// Loads and prepares the scene, on the current rayon pool.
///
/// # Errors
/// When blobs are missing, or the scene or the settings are at fault.
pub(crate) fn prepare(store: &Store, submission: &Submission) -> Result<Arc<PreparedJob>, IntakeError> {
    let bundle = load(store, &submission.manifest)?;
    Ok(Arc::new(PreparedJob::prepare(&bundle, &submission.settings)?))
}

fn load(store: &Store, manifest: &SceneManifest) -> Result<SceneBundle, IntakeError> {
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

//! What clients call.

use super::quota::{Quota, holding};
use super::{Context, ReplyStream, stored_chunks};
use crate::access::Identity;
use crate::driver::{NoImage, SubmitError};
use crate::intake::{self, IntakeError};
use crate::store::StoreError;
use crate::types::{JobId, JobProgress};
use gatherlight_proto::WireError;
use gatherlight_proto::error::truncated;
use gatherlight_proto::limits::{MAX_EXTERNALS, PROTOCOL_VERSION};
use gatherlight_proto::message::{BlobRef, Submission};
use gatherlight_proto::wire::jobs_server::Jobs;
use gatherlight_proto::wire::{self, Chunk};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Semaphore, mpsc, watch};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};

/// Least time between two snapshots of one watcher.
const WATCH_INTERVAL: Duration = Duration::from_millis(100);
/// Submissions that load and prepare their scenes at once.
const MAX_INTAKES: usize = 2;
/// Longest error and name in a listing, in bytes.
const MAX_LISTED_ERROR_BYTES: usize = 512;
/// Longest name of a worker in a listing, in bytes: as many of them as may join have to fit into one message.
const MAX_LISTED_WORKER_BYTES: usize = 128;
/// Time an upload has to send its next chunk.
const PATIENCE: Duration = Duration::from_secs(60);
/// Uploads of one owner at once.
const MAX_UPLOADS: usize = 32;
/// Submissions of one owner that wait or load at once.
const MAX_SUBMISSIONS: usize = 32;
/// Watches of one owner at once.
const MAX_WATCHES: usize = 512;
/// Images that one owner fetches at once.
const MAX_FETCHES: usize = 32;

pub(super) struct JobsService {
    context: Context,
    intakes: Semaphore,
    uploads: Quota<Arc<str>>,
    submissions: Quota<Arc<str>>,
    watches: Quota<Arc<str>>,
    fetches: Quota<Arc<str>>,
}

impl JobsService {
    pub(super) fn new(context: Context) -> Self {
        JobsService {
            context,
            intakes: Semaphore::new(MAX_INTAKES),
            uploads: Quota::new("uploads", MAX_UPLOADS),
            submissions: Quota::new("submissions", MAX_SUBMISSIONS),
            watches: Quota::new("watches", MAX_WATCHES),
            fetches: Quota::new("fetches", MAX_FETCHES),
        }
    }
    /// A job of the caller's. Another's is as unknown as none.
    async fn watched(&self, caller: &Identity, job: u64) -> Result<watch::Receiver<JobProgress>, Status> {
        let watched = self.context.driver.watch(JobId(job)).await;
        watched.filter(|w| caller.sees(&w.borrow().owner)).ok_or_else(|| no_job(job))
    }
}

/// Who makes a call; the gate has put it there.
fn caller<T>(request: &Request<T>) -> Result<Identity, Status> {
    let identity = request.extensions().get::<Identity>().cloned();
    identity.ok_or_else(|| Status::internal("a call came past the gate"))
}

fn no_job(job: u64) -> Status {
    Status::not_found(format!("there is no job {} on this coordinator", JobId(job)))
}

impl From<StoreError> for Status {
    fn from(e: StoreError) -> Self {
        match e {
            StoreError::Wire(e) => e.into(),
            StoreError::Full { .. } => Status::resource_exhausted(e.to_string()),
            StoreError::Io(_) => Status::internal(e.to_string()),
        }
    }
}

impl From<IntakeError> for Status {
    fn from(e: IntakeError) -> Self {
        let text = e.to_string();
        match e {
            IntakeError::Job(_) => Status::invalid_argument(text),
            IntakeError::Blob(_) => Status::failed_precondition(text),
            IntakeError::Driver(SubmitError::Full(_) | SubmitError::Memory { .. }) => Status::resource_exhausted(text),
            IntakeError::Driver(SubmitError::TimeLimit(_) | SubmitError::ErrorLimit(_)) => {
                Status::invalid_argument(text)
            }
            IntakeError::Driver(SubmitError::Closed) => Status::unavailable(text),
            IntakeError::Driver(SubmitError::Store(_)) => Status::internal(text),
            IntakeError::Internal(_) => Status::internal(text),
        }
    }
}

#[tonic::async_trait]
impl Jobs for JobsService {
    type WatchStream = ReplyStream<wire::Job>;
    type FetchImageStream = ReplyStream<Chunk>;

    async fn greet(&self, _: Request<wire::GreetRequest>) -> Result<Response<wire::GreetReply>, Status> {
        let version = gatherlight_render::VERSION.to_owned();
        Ok(Response::new(wire::GreetReply { protocol: PROTOCOL_VERSION, version }))
    }

    async fn missing(&self, request: Request<wire::MissingRequest>) -> Result<Response<wire::MissingReply>, Status> {
        let asked = request.into_inner().blobs;
        WireError::check_limit("blobs asked for", asked.len() as u64, MAX_EXTERNALS as u64 + 1, "MAX_EXTERNALS")?;
        let blobs = asked.into_iter().map(BlobRef::try_from).collect::<Result<Vec<_>, _>>()?;
        let missing: Vec<&BlobRef> = blobs.iter().filter(|b| !self.context.store.touch(b.digest)).collect();
        let wanted = missing.iter().fold(0u64, |sum, b| sum.saturating_add(b.bytes));
        self.context.driver.make_room(wanted).await;
        Ok(Response::new(wire::MissingReply { digests: missing.iter().map(|b| b.digest.to_bytes()).collect() }))
    }

    async fn upload(&self, request: Request<Streaming<Chunk>>) -> Result<Response<wire::UploadReply>, Status> {
        let _slot = self.uploads.take(caller(&request)?.name)?;
        let mut inbound = request.into_inner();
        let mut upload = self.context.store.upload();
        let next = async |inbound: &mut Streaming<Chunk>| {
            let waited = tokio::time::timeout(PATIENCE, inbound.message()).await;
            waited.unwrap_or_else(|_| Err(Status::deadline_exceeded("the next chunk did not come in time")))
        };
        while let Some(chunk) = next(&mut inbound).await? {
            let pushed = tokio::task::spawn_blocking(move || upload.push(&chunk).map(|()| upload)).await;
            upload = pushed.map_err(|e| Status::internal(e.to_string()))??;
        }
        let finished = tokio::task::spawn_blocking(move || upload.finish()).await;
        finished.map_err(|e| Status::internal(e.to_string()))??;
        Ok(Response::new(wire::UploadReply {}))
    }

    async fn submit(&self, request: Request<wire::SubmitRequest>) -> Result<Response<wire::SubmitReply>, Status> {
        let owner = caller(&request)?.name;
        let _slot = self.submissions.take(owner.clone())?;
        let submission = Submission::try_from(request.into_inner())?;
        let _turn = self.intakes.acquire().await.map_err(|e| Status::internal(e.to_string()))?;
        let Context { driver, compute, store, .. } = &self.context;
        let job = intake::submit(driver, compute, store, &owner, submission).await?;
        Ok(Response::new(wire::SubmitReply { job: job.0 }))
    }

    async fn list(&self, request: Request<wire::ListRequest>) -> Result<Response<wire::ListReply>, Status> {
        let caller = caller(&request)?;
        let jobs = self.context.driver.list().await;
        let listed = jobs.iter().filter(|j| caller.sees(&j.owner)).map(|j| {
            let mut job = wire::Job::from(j);
            // All of them have to fit into one message; the whole error is in `Get`.
            job.error = truncated(&job.error, MAX_LISTED_ERROR_BYTES).to_owned();
            job.name = truncated(&job.name, MAX_LISTED_ERROR_BYTES).to_owned();
            job
        });
        Ok(Response::new(wire::ListReply { jobs: listed.collect() }))
    }

    async fn get(&self, request: Request<wire::GetRequest>) -> Result<Response<wire::Job>, Status> {
        let watched = self.watched(&caller(&request)?, request.into_inner().job).await?;
        let job = wire::Job::from(&*watched.borrow());
        Ok(Response::new(job))
    }

    async fn watch(&self, request: Request<wire::WatchRequest>) -> Result<Response<Self::WatchStream>, Status> {
        let caller = caller(&request)?;
        let slot = self.watches.take(caller.name.clone())?;
        let watched = self.watched(&caller, request.into_inner().job).await?;
        let (sender, receiver) = mpsc::channel(1);
        tokio::spawn(forward(watched, sender));
        Ok(Response::new(Box::pin(holding(ReceiverStream::new(receiver), slot))))
    }

    async fn fetch_image(
        &self,
        request: Request<wire::FetchImageRequest>,
    ) -> Result<Response<Self::FetchImageStream>, Status> {
        let caller = caller(&request)?;
        let slot = self.fetches.take(caller.name.clone())?;
        let job = request.into_inner().job;
        self.watched(&caller, job).await?;
        let image = self.context.driver.image(JobId(job)).await.map_err(|e| match e {
            NoImage::NoJob => no_job(job),
            NoImage::NotDone(state) => {
                let text = format!("job {} has no image: its state is {state}", JobId(job));
                Status::failed_precondition(text)
            }
        })?;
        let chunks = stored_chunks(self.context.store.clone(), image.digest)?;
        Ok(Response::new(Box::pin(holding(chunks, slot))))
    }

    async fn cancel(&self, request: Request<wire::CancelRequest>) -> Result<Response<wire::Job>, Status> {
        let caller = caller(&request)?;
        let job = request.into_inner().job;
        self.watched(&caller, job).await?;
        let progress = self.context.driver.cancel(JobId(job)).await.ok_or_else(|| no_job(job))?;
        Ok(Response::new((&progress).into()))
    }

    async fn workers(&self, _: Request<wire::WorkersRequest>) -> Result<Response<wire::WorkersReply>, Status> {
        let workers = self.context.driver.workers().await;
        let listed = workers.iter().map(|w| {
            let mut worker = wire::Worker::from(w);
            worker.name = truncated(&worker.name, MAX_LISTED_WORKER_BYTES).to_owned();
            worker
        });
        Ok(Response::new(wire::WorkersReply { workers: listed.collect() }))
    }
}

/// Sends snapshots as they change, not more often than [`WATCH_INTERVAL`], up to and with the final one.
async fn forward(mut watched: watch::Receiver<JobProgress>, sender: mpsc::Sender<Result<wire::Job, Status>>) {
    loop {
        let (job, last) = {
            let progress = watched.borrow_and_update();
            (wire::Job::from(&*progress), progress.state.is_final())
        };
        if sender.send(Ok(job)).await.is_err() || last {
            return;
        }
        tokio::select! {
            () = tokio::time::sleep(WATCH_INTERVAL) => {}
            () = sender.closed() => return,
        }
        if watched.changed().await.is_err() {
            return;
        }
    }
}

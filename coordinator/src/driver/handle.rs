//! How the rest of the coordinator speaks to the driver.

use super::job::Spec;
use super::live::{ClosedRound, StatedError};
use super::resume::Resumed;
use crate::result::Shape;
use crate::room::Room;
use crate::store::Store;
use crate::types::{JobId, JobProgress, WorkerInfo};
use bytes::Bytes;
use gatherlight_proto::Digest;
use gatherlight_proto::collective::Transfers;
use gatherlight_proto::message::{
    BlobRef, DeliverHeader, FromWorker, Hello, InputRef, LeaseId, PassTicket, Route, SessionKey, ToWorker, WorkerId,
};
use gatherlight_proto::pieces::Pieces;
use gatherlight_render::export::ImageMetadata;
use gatherlight_render::film::{Film, LightImage, MapError, Tile};
use gatherlight_render::integrator::Bootstrap;
use gatherlight_render::job::Phase;
use gatherlight_render::photon::{EmissionRange, PhotonBatch};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Duration;
use tokio::sync::{mpsc, oneshot, watch};

/// Inputs waiting for the driver before senders wait.
const QUEUE: usize = 256;

/// Answer to an input.
pub(crate) type Reply<T> = oneshot::Sender<T>;

/// Everything that reaches the driver.
#[derive(Debug)]
pub(crate) enum Input {
    Submit(Box<Spec>, Reply<Result<JobId, SubmitError>>),
    Find(String, [u8; 16], Reply<Option<JobId>>),
    List(Reply<Vec<JobProgress>>),
    Watch(JobId, Reply<Option<watch::Receiver<JobProgress>>>),
    Cancel(JobId, Reply<Option<JobProgress>>),
    Image(JobId, Reply<Result<BlobRef, NoImage>>),
    Film(JobId, Reply<Option<(Film, ImageMetadata)>>),
    Workers(Reply<Vec<WorkerInfo>>),
    Join(Hello, Reply<Joined>),
    Message(WorkerId, FromWorker),
    Left(WorkerId),
    Offer(DeliverHeader, Reply<Offered>),
    /// The digest of a result whose lease's twin was faster.
    Repeated(WorkerId, DeliverHeader, Digest),
    Refuse(Ticket, String),
    Complete(Box<Delivery>, Reply<bool>),
    Locate(SessionKey, Digest, Reply<Option<Route>>),
    Pass(Digest, PassTicket, Reply<Option<Source>>),
    /// What was made of a phase.
    Built(JobId, Phase, Result<Built, String>),
    Closed(JobId, Result<ClosedRound, String>),
    Assembled(JobId, Result<(Image, StatedError), String>),
    /// A job that an earlier coordinator left is ready to go on.
    Resumed(JobId, Result<Box<Resumed>, String>),
    /// Room for so many bytes of blobs is wanted.
    MakeRoom(u64, Reply<()>),
    Shutdown,
}

/// Why a job was not taken.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SubmitError {
    /// Too many unfinished jobs.
    #[error("{0} jobs are waiting or running, the limit of this coordinator; wait or raise its --max-jobs")]
    Full(usize),
    /// The job's plan needs more memory than the coordinator gives one job.
    #[error(
        "the job needs about {needed} bytes of the coordinator's memory, over its limit of {limit}; raise its \
         --max-job-memory, or ask for fewer photons, pixels or layers"
    )]
    Memory {
        /// Bytes needed, by the plan.
        needed: u64,
        /// The limit.
        limit: u64,
    },
    /// The job has a time limit that can never end it.
    #[error("a time limit ends a job between two rounds, and this one has a single round: method {0}")]
    TimeLimit(&'static str),
    /// The job has an error limit and nothing to know its error by.
    #[error("an error limit needs rounds to compare, and this job has none: method {0}")]
    ErrorLimit(&'static str),
    /// The job could not be written down.
    #[error("the coordinator's store cannot be written, so the job would not survive a restart: {0}")]
    Store(String),
    /// The coordinator is shutting down.
    #[error("the coordinator is shutting down")]
    Closed,
}

/// Why there is no image to fetch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NoImage {
    /// No such job.
    NoJob,
    /// The job is not done; its state's name.
    NotDone(&'static str),
}

/// A worker was taken in.
#[derive(Debug)]
pub struct Joined {
    /// Its number.
    pub worker: WorkerId,
    /// Messages for it; ends when it is dismissed.
    pub messages: mpsc::Receiver<ToWorker>,
    /// Ready when it is dismissed.
    pub dismissed: oneshot::Receiver<()>,
}

/// Permission to deliver a result, and what is needed to read it.
#[derive(Clone, Debug)]
pub struct Ticket {
    /// Who delivers.
    pub worker: WorkerId,
    /// The lease.
    pub lease: LeaseId,
    /// Its attempt.
    pub attempt: u32,
    /// The indices the worker says it computed.
    pub range: EmissionRange,
    /// Time the worker says it computed.
    pub busy: Duration,
    /// What the worker says it fetched for it.
    pub fetched: Transfers,
    /// The phase it is part of, and its index within the job.
    pub phase: (usize, Phase),
    /// How the job's results look.
    pub shape: Arc<Shape>,
    /// Whether the result has to wait here until another round is closed.
    pub is_early: bool,
}

/// What is to be done with a result that a worker offers.
#[derive(Debug)]
pub enum Offered {
    /// It is wanted.
    Wanted(Box<Ticket>),
    /// The same indices were done by another worker meanwhile: only its digest is of interest.
    Repeated(WorkerId),
    /// The lease is no longer the worker's.
    Stale,
}

/// A decoded result.
#[derive(Debug)]
pub enum Payload {
    /// Of an emission lease.
    Photons(PhotonBatch),
    /// Of a bootstrap lease: luminances from the lease's first path on.
    Luminances(u64, Vec<f32>),
    /// Of a splat lease.
    Light(LightImage),
    /// Of a gather lease; with what its samples splatted, where the method does.
    Tiles(Vec<Tile>, Option<LightImage>),
}

impl Payload {
    /// Photons in it.
    pub fn stored(&self) -> u64 {
        match self {
            Payload::Photons(batch) => batch.len() as u64,
            _ => 0,
        }
    }
}

/// A result that arrived whole.
#[derive(Debug)]
pub struct Delivery {
    /// What it is for.
    pub ticket: Ticket,
    /// What it holds.
    pub payload: Payload,
    /// As it was sent.
    pub raw: Bytes,
    /// Digest of that.
    pub digest: Digest,
    /// From its announcement to its last byte.
    pub transfer: Duration,
    /// The memory it takes until it is merged and noted.
    pub room: Room,
}

/// Where the bytes of a digest come from.
#[derive(Clone, Debug)]
pub enum Source {
    /// The store has it.
    Blob(Digest),
    /// A photon map, a bootstrap or a sample map in memory; add to the counter what is sent of it.
    Memory {
        /// All of it, shared.
        pieces: Pieces,
        /// Bytes sent so far.
        sent: Arc<AtomicU64>,
    },
}

impl Source {
    /// Its length in bytes.
    pub(super) fn len(&self, store: &Store) -> Option<u64> {
        match self {
            Source::Blob(digest) => store.len(*digest).ok(),
            Source::Memory { pieces, .. } => Some(pieces.bytes().len() as u64),
        }
    }
}

/// Something workers read, ready for broadcast.
#[derive(Debug)]
pub(crate) struct Built {
    pub(crate) input: InputRef,
    /// As it is sent; `None` where every worker is in this process.
    pub(crate) encoded: Option<Pieces>,
    pub(crate) made: Made,
}

/// What the driver has to know of it.
#[derive(Debug)]
pub(crate) enum Made {
    Map {
        /// Largest gather radius the map is searched with, in world units.
        gather_radius: f32,
        /// What it makes wrong in the image, where no later map makes up for it.
        error: Option<MapError>,
    },
    Bootstrap(Arc<Bootstrap>),
    SampleMap,
}

/// A finished image.
#[derive(Debug)]
pub(crate) enum Image {
    /// Kept as it is, for the caller in this process.
    Film(Film, Box<ImageMetadata>),
    /// An EXR file in the store.
    Stored(BlobRef),
}

/// The driver's address. Clones share it; when the last is gone, the driver ends.
#[derive(Clone, Debug)]
pub struct Handle {
    inputs: mpsc::Sender<Input>,
}

impl Handle {
    pub(crate) fn channel() -> (Handle, mpsc::Receiver<Input>) {
        let (inputs, receiver) = mpsc::channel(QUEUE);
        (Handle { inputs }, receiver)
    }
    async fn ask<T>(&self, input: impl FnOnce(Reply<T>) -> Input) -> Option<T> {
        let (reply, answer) = oneshot::channel();
        self.inputs.send(input(reply)).await.ok()?;
        answer.await.ok()
    }
    /// Starts a job.
    ///
    /// # Errors
    /// When there are too many.
    pub async fn submit(&self, spec: Spec) -> Result<JobId, SubmitError> {
        self.ask(|reply| Input::Submit(Box::new(spec), reply)).await.unwrap_or(Err(SubmitError::Closed))
    }
    /// The job that this owner submitted with this key.
    pub async fn find(&self, owner: &str, request_key: [u8; 16]) -> Option<JobId> {
        self.ask(|reply| Input::Find(owner.to_owned(), request_key, reply)).await.flatten()
    }
    /// All jobs, oldest first.
    pub async fn list(&self) -> Vec<JobProgress> {
        self.ask(Input::List).await.unwrap_or_default()
    }
    /// A job's latest snapshot, now and later.
    pub async fn watch(&self, job: JobId) -> Option<watch::Receiver<JobProgress>> {
        self.ask(|reply| Input::Watch(job, reply)).await.flatten()
    }
    /// Cancels a job; its snapshot afterwards.
    pub async fn cancel(&self, job: JobId) -> Option<JobProgress> {
        self.ask(|reply| Input::Cancel(job, reply)).await.flatten()
    }
    /// Where a job's finished image is.
    ///
    /// # Errors
    /// When there is none.
    pub async fn image(&self, job: JobId) -> Result<BlobRef, NoImage> {
        self.ask(|reply| Input::Image(job, reply)).await.unwrap_or(Err(NoImage::NoJob))
    }
    /// Takes a job's film out, where films are kept.
    pub async fn film(&self, job: JobId) -> Option<(Film, ImageMetadata)> {
        self.ask(|reply| Input::Film(job, reply)).await.flatten()
    }
    /// The workers.
    pub async fn workers(&self) -> Vec<WorkerInfo> {
        self.ask(Input::Workers).await.unwrap_or_default()
    }
    /// Inputs that wait for the driver.
    pub(crate) fn queued(&self) -> usize {
        self.inputs.max_capacity() - self.inputs.capacity()
    }
    /// Takes in a worker.
    pub async fn join(&self, hello: Hello) -> Option<Joined> {
        self.ask(|reply| Input::Join(hello, reply)).await
    }
    /// Passes on what a worker said.
    pub async fn message(&self, worker: WorkerId, message: FromWorker) {
        drop(self.inputs.send(Input::Message(worker, message)).await);
    }
    /// A worker's session ended.
    pub async fn left(&self, worker: WorkerId) {
        drop(self.inputs.send(Input::Left(worker)).await);
    }
    /// Whether this result is wanted. Asked before any of it is read.
    pub async fn offer(&self, header: DeliverHeader) -> Offered {
        self.ask(|reply| Input::Offer(header, reply)).await.unwrap_or(Offered::Stale)
    }
    /// The digest of a result whose lease's twin was faster.
    pub async fn repeated(&self, worker: WorkerId, header: DeliverHeader, digest: Digest) {
        drop(self.inputs.send(Input::Repeated(worker, header, digest)).await);
    }
    /// Collects old blobs where there is no room for `bytes` more.
    pub async fn make_room(&self, bytes: u64) {
        self.ask(|reply| Input::MakeRoom(bytes, reply)).await;
    }
    /// A result was damaged or senseless.
    pub async fn refuse(&self, ticket: Ticket, error: String) {
        drop(self.inputs.send(Input::Refuse(ticket, error)).await);
    }
    /// Hands in a result; returns whether it counts, once it is safe.
    pub async fn complete(&self, delivery: Delivery) -> bool {
        self.ask(|reply| Input::Complete(Box::new(delivery), reply)).await.unwrap_or(false)
    }
    /// From whom the worker of this session gets this digest.
    pub async fn locate(&self, session: SessionKey, digest: Digest) -> Option<Route> {
        self.ask(|reply| Input::Locate(session, digest, reply)).await.flatten()
    }
    /// The bytes that a ticket lets its holder have.
    pub async fn pass(&self, digest: Digest, ticket: PassTicket) -> Option<Source> {
        self.ask(|reply| Input::Pass(digest, ticket, reply)).await.flatten()
    }
    /// Ends the driver: sessions and watches are closed, and whoever asks from now on hears that it is shutting down.
    pub async fn shutdown(&self) {
        drop(self.inputs.send(Input::Shutdown).await);
    }
    /// For compute threads: reports a result, waiting if the driver is busy.
    pub(crate) fn report(&self, input: Input) {
        drop(self.inputs.blocking_send(input));
    }
    pub(crate) fn downgrade(&self) -> mpsc::WeakSender<Input> {
        self.inputs.downgrade()
    }
    pub(crate) fn upgrade(weak: &mpsc::WeakSender<Input>) -> Option<Handle> {
        weak.upgrade().map(|inputs| Handle { inputs })
    }
}

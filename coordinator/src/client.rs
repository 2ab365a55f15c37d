//! Speaks to a coordinator elsewhere.

use crate::manifest;
use crate::random::{random_bytes, random_u64};
use crate::types::{JobId, JobProgress, Limits, WorkerInfo};
use bytes::Bytes;
use gatherlight_proto::chunk::{Assembler, chunks};
use gatherlight_proto::connect::{Stamp, endpoint, pause, reason};
use gatherlight_proto::credentials::Credentials;
use gatherlight_proto::error::truncated;
use gatherlight_proto::limits::{MAX_IMAGE_BYTES, MAX_MESSAGE_BYTES, PROTOCOL_VERSION};
use gatherlight_proto::message::Submission;
use gatherlight_proto::version::Versions;
use gatherlight_proto::wire::jobs_client::JobsClient;
use gatherlight_proto::{Digest, WireError, wire};
use gatherlight_render::import::SceneBundle;
use gatherlight_render::job;
use gatherlight_render::settings::RenderSettings;
use std::collections::BTreeMap;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio_stream::Stream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;
use tonic::{Code, Response, Status, Streaming};

/// Time between two reports of upload progress.
const REPORT_INTERVAL: Duration = Duration::from_millis(100);

/// Longest time without a word of the coordinator after which a client that has reached it before gives up.
const RETRY_FOR: Duration = Duration::from_secs(300);

/// Attempts to reach a coordinator before giving up, by default.
pub const DEFAULT_ATTEMPTS: u32 = 5;

/// Why a request was not answered.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The URL makes no sense.
    #[error("{url:?} is no coordinator URL: {reason}; write it like http://localhost:7420")]
    Url {
        /// As given.
        url: String,
        /// What is wrong.
        reason: String,
    },
    /// Nothing answers there.
    #[error(
        "cannot reach the coordinator at {url} ({attempts} attempts): {reason}; is `gatherlight serve` running there?"
    )]
    Unreachable {
        /// The address tried.
        url: String,
        /// How often.
        attempts: u32,
        /// The last failure.
        reason: String,
    },
    /// Both sides speak different protocol versions; the text names them.
    #[error("{0}")]
    Version(String),
    /// The token or certificate is missing, unknown, or does not allow it.
    #[error("the coordinator at {url} refuses: {reason}")]
    Denied {
        /// Its address.
        url: String,
        /// Its reason.
        reason: String,
    },
    /// There is no such job, or its image is not there.
    #[error("{0}")]
    NotFound(String),
    /// The coordinator refused: scene, settings or a limit; the text says what and how to do better.
    #[error("{0}")]
    Refused(String),
    /// The connection broke, or the peer does not keep to the protocol.
    #[error("the coordinator at {url}: {reason}")]
    Transport {
        /// Its address.
        url: String,
        /// What happened.
        reason: String,
    },
}

/// Calls repeated since the connection broke.
#[derive(Default)]
struct Retries {
    count: u32,
    since: Option<Instant>,
}

/// Why a call of several steps did not succeed.
enum Failure {
    /// The connection broke.
    Broken(Status),
    /// It never will.
    Final(ClientError),
}

impl From<ClientError> for Failure {
    fn from(error: ClientError) -> Self {
        Failure::Final(error)
    }
}

/// Whether a call failed because of the connection, or of a coordinator that is shutting down: not by an answer.
fn is_broken(status: &Status) -> bool {
    std::error::Error::source(status).is_some() || matches!(status.code(), Code::Unavailable | Code::Cancelled)
}

fn innermost(status: &Status) -> String {
    match std::error::Error::source(status) {
        Some(source) => reason(source),
        None => status.message().to_owned(),
    }
}

/// A job to submit.
#[derive(Clone, Debug)]
pub struct SubmitRequest {
    /// Name for listings.
    pub name: String,
    /// The scene's files.
    pub bundle: SceneBundle,
    /// What determines the image.
    pub settings: RenderSettings,
    /// When to end it early.
    pub limits: Limits,
    /// Jobs of higher priority get workers first: from −100 to 100.
    pub priority: i32,
}

/// A finished image.
#[derive(Clone, Debug)]
pub struct FetchedImage {
    /// The EXR file's bytes, digest checked.
    pub exr: Bytes,
    /// BLAKE3 digest, hexadecimal.
    pub digest: String,
}

/// Snapshots of a job, ending after the final one.
pub type ProgressStream = Pin<Box<dyn Stream<Item = Result<JobProgress, ClientError>> + Send>>;

type Jobs = JobsClient<InterceptedService<Channel, Stamp>>;

/// Hears why a call is repeated.
#[derive(Clone)]
struct Notice(Arc<dyn Fn(&str) + Send + Sync>);

impl std::fmt::Debug for Notice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Notice")
    }
}

/// A connection to a coordinator; clones share it.
#[derive(Clone, Debug)]
pub struct Client {
    url: Arc<str>,
    notice: Notice,
    jobs: Jobs,
}

/// Connects to the coordinator at `url` (`http://HOST:PORT`), trying `attempts` times with growing pauses, and checks
/// that both sides speak the same protocol.
///
/// # Errors
/// When the URL makes no sense, nothing answers (the text has the address), or the versions differ (it has both).
pub async fn connect(url: &str, attempts: u32) -> Result<Client, ClientError> {
    connect_with(url, attempts, &Credentials::default()).await
}

/// As [`connect`], proving itself by `credentials`; `https://HOST:PORT` where they name an authority to trust.
///
/// # Errors
/// As [`connect`], and when the coordinator does not know the token or certificate.
pub async fn connect_with(url: &str, attempts: u32, credentials: &Credentials) -> Result<Client, ClientError> {
    open(url, attempts, credentials, Versions::own()).await
}

/// As [`connect`], claiming other versions than this build's; for tests.
///
/// # Errors
/// As [`connect`].
pub async fn connect_as(url: &str, attempts: u32, versions: Versions) -> Result<Client, ClientError> {
    open(url, attempts, &Credentials::default(), versions).await
}

async fn open(url: &str, attempts: u32, credentials: &Credentials, versions: Versions) -> Result<Client, ClientError> {
    let endpoint = endpoint(url, credentials).map_err(|reason| ClientError::Url { url: url.into(), reason })?;
    let attempts = attempts.max(1);
    let mut last = String::new();
    for attempt in 0..attempts {
        if attempt > 0 {
            tokio::time::sleep(pause(attempt, random_u64())).await;
        }
        match endpoint.connect().await {
            Ok(channel) => {
                let jobs = JobsClient::with_interceptor(channel, Stamp::new(versions, credentials));
                let jobs = jobs.max_decoding_message_size(MAX_MESSAGE_BYTES);
                let client = Client { url: url.into(), notice: Notice(Arc::new(|_| {})), jobs };
                client.greet().await?;
                return Ok(client);
            }
            Err(error) => last = reason(&error),
        }
    }
    Err(ClientError::Unreachable { url: url.into(), attempts, reason: last })
}

impl Client {
    async fn greet(&self) -> Result<(), ClientError> {
        let reply = self.jobs.clone().greet(wire::GreetRequest {}).await.map_err(|s| self.failed(&s))?.into_inner();
        if reply.protocol != PROTOCOL_VERSION {
            return Err(ClientError::Version(format!(
                "version mismatch: the coordinator at {} is gatherlight {} with protocol {}, this client is gatherlight \
                 {} with protocol {PROTOCOL_VERSION}; install the same version on both",
                self.url,
                truncated(&reply.version, 32),
                reply.protocol,
                gatherlight_render::VERSION,
            )));
        }
        Ok(())
    }
    fn failed(&self, status: &Status) -> ClientError {
        let text = status.message().to_owned();
        match status.code() {
            Code::NotFound => ClientError::NotFound(text),
            Code::Unauthenticated | Code::PermissionDenied => {
                ClientError::Denied { url: self.url.to_string(), reason: text }
            }
            Code::FailedPrecondition if text.starts_with("version mismatch") => ClientError::Version(text),
            Code::InvalidArgument | Code::FailedPrecondition | Code::ResourceExhausted => ClientError::Refused(text),
            _ => self.transport(text),
        }
    }
    fn transport(&self, reason: impl Into<String>) -> ClientError {
        ClientError::Transport { url: self.url.to_string(), reason: reason.into() }
    }
    fn senseless(&self, error: WireError) -> ClientError {
        self.transport(format!("it sent something senseless: {error}"))
    }
    fn snapshot(&self, job: wire::Job) -> Result<JobProgress, ClientError> {
        JobProgress::try_from(job).map_err(|e| self.senseless(e))
    }
    /// The same, but `notice` hears when the connection broke and a call is repeated.
    pub fn noticing(self, notice: impl Fn(&str) + Send + Sync + 'static) -> Self {
        Client { notice: Notice(Arc::new(notice)), ..self }
    }
    /// Calls the coordinator, again and again while the connection is broken: one that is started again goes on with its jobs.
    async fn call<T, F>(&self, call: impl Fn(Jobs) -> F) -> Result<T, ClientError>
    where
        F: Future<Output = Result<Response<T>, Status>>,
    {
        let mut retries = Retries::default();
        loop {
            match call(self.jobs.clone()).await {
                Ok(reply) => return Ok(reply.into_inner()),
                Err(status) => self.may_repeat(&mut retries, self.failure(status)).await?,
            }
        }
    }
    /// Whether `status` is an answer, or the connection's fault.
    fn failure(&self, status: Status) -> Failure {
        if is_broken(&status) { Failure::Broken(status) } else { Failure::Final(self.failed(&status)) }
    }
    /// Waits before a call is repeated; the error, where there is no hope.
    async fn may_repeat(&self, retries: &mut Retries, failure: Failure) -> Result<(), ClientError> {
        let status = match failure {
            Failure::Broken(status) => status,
            Failure::Final(error) => return Err(error),
        };
        let since = *retries.since.get_or_insert_with(Instant::now);
        if since.elapsed() > RETRY_FOR {
            return Err(self.failed(&status));
        }
        if retries.count == 0 {
            let reason = innermost(&status);
            (self.notice.0)(&format!("the connection to {} broke ({reason}); trying again", self.url));
        }
        tokio::time::sleep(pause(retries.count, random_u64())).await;
        retries.count += 1;
        Ok(())
    }
    /// The coordinator's address.
    pub fn url(&self) -> &str {
        &self.url
    }
    /// Uploads what the image needs of the scene and the coordinator lacks, and starts a job. `uploaded` hears (bytes sent, bytes to send).
    ///
    /// # Errors
    /// When the scene, the settings or a limit is at fault, or the connection breaks.
    pub async fn submit(
        &self,
        request: &SubmitRequest,
        mut uploaded: impl FnMut(u64, u64) + Send,
    ) -> Result<JobId, ClientError> {
        // A scene that is damaged is sent as it is: the coordinator says what is wrong with it.
        let needed = job::cut(&request.bundle, &request.settings).unwrap_or_else(|_| request.bundle.clone());
        let (manifest, files) = manifest::pack(&needed);
        let submission = Submission {
            name: request.name.clone(),
            // However often it is sent, it is one job.
            request_key: random_bytes(),
            manifest,
            settings: request.settings.clone(),
            limits: request.limits,
            priority: request.priority,
        };
        let mut retries = Retries::default();
        loop {
            match self.submit_once(&submission, &files, &mut uploaded).await {
                Ok(id) => return Ok(id),
                Err(failure) => self.may_repeat(&mut retries, failure).await?,
            }
        }
    }
    async fn submit_once(
        &self,
        submission: &Submission,
        files: &BTreeMap<Digest, Bytes>,
        uploaded: &mut (impl FnMut(u64, u64) + Send),
    ) -> Result<JobId, Failure> {
        let failed = |status| self.failure(status);
        let blobs = submission.manifest.blobs().into_iter().map(Into::into).collect();
        let missing = self.jobs.clone().missing(wire::MissingRequest { blobs }).await.map_err(failed)?;
        let mut wanted = Vec::new();
        for digest in missing.into_inner().digests {
            let digest = Digest::try_from(&digest[..]).map_err(|e| self.senseless(e))?;
            let bytes = files.get(&digest).ok_or_else(|| self.transport("it asks for a file of another scene"))?;
            wanted.push((digest, bytes.clone()));
        }
        let total: u64 = wanted.iter().map(|(_, bytes)| bytes.len() as u64).sum();
        let sent = Arc::new(AtomicU64::new(0));
        for (digest, bytes) in wanted {
            self.upload(digest, bytes, &sent, |now| uploaded(now, total)).await.map_err(failed)?;
        }
        uploaded(total, total);
        let reply = self.jobs.clone().submit(wire::SubmitRequest::from(submission)).await.map_err(failed)?;
        Ok(JobId(reply.into_inner().job))
    }
    async fn upload(
        &self,
        digest: Digest,
        bytes: Bytes,
        sent: &Arc<AtomicU64>,
        mut report: impl FnMut(u64) + Send,
    ) -> Result<(), Status> {
        let count = sent.clone();
        let pieces = chunks(bytes, digest).inspect(move |c| {
            count.fetch_add(c.data.len() as u64, Ordering::Relaxed);
        });
        let mut jobs = self.jobs.clone();
        let mut upload = std::pin::pin!(jobs.upload(tokio_stream::iter(pieces)));
        loop {
            tokio::select! {
                done = &mut upload => return done.map(drop),
                () = tokio::time::sleep(REPORT_INTERVAL) => report(sent.load(Ordering::Relaxed)),
            }
        }
    }
    /// All jobs the coordinator knows, oldest first.
    ///
    /// # Errors
    /// When the connection breaks.
    pub async fn list(&self) -> Result<Vec<JobProgress>, ClientError> {
        let reply = self.call(|mut jobs| async move { jobs.list(wire::ListRequest {}).await }).await?;
        reply.jobs.into_iter().map(|j| self.snapshot(j)).collect()
    }
    /// One job.
    ///
    /// # Errors
    /// When there is no such job or the connection breaks.
    pub async fn get(&self, id: JobId) -> Result<JobProgress, ClientError> {
        let reply = self.call(|mut jobs| async move { jobs.get(wire::GetRequest { job: id.0 }).await }).await?;
        self.snapshot(reply)
    }
    /// Snapshots of one job as it goes on, until its final state; also where the coordinator is started again meanwhile.
    ///
    /// # Errors
    /// When there is no such job, or the connection breaks and does not come back.
    pub async fn watch(&self, id: JobId) -> Result<ProgressStream, ClientError> {
        let first = self.call(|mut jobs| async move { jobs.watch(wire::WatchRequest { job: id.0 }).await }).await?;
        let (sender, receiver) = tokio::sync::mpsc::channel(1);
        let client = self.clone();
        tokio::spawn(async move {
            if let Err(error) = client.watch_on(id, first, &sender).await {
                drop(sender.send(Err(error)).await);
            }
        });
        Ok(Box::pin(ReceiverStream::new(receiver)))
    }
    async fn watch_on(
        &self,
        id: JobId,
        mut stream: Streaming<wire::Job>,
        sender: &tokio::sync::mpsc::Sender<Result<JobProgress, ClientError>>,
    ) -> Result<(), ClientError> {
        let mut retries = Retries::default();
        loop {
            let broken = match stream.message().await {
                Ok(Some(job)) => {
                    let snapshot = self.snapshot(job)?;
                    let last = snapshot.state.is_final();
                    retries = Retries::default();
                    if sender.send(Ok(snapshot)).await.is_err() || last {
                        return Ok(());
                    }
                    continue;
                }
                Ok(None) => Status::unavailable("the coordinator stopped reporting"),
                Err(status) => status,
            };
            self.may_repeat(&mut retries, self.failure(broken)).await?;
            stream = self.call(|mut jobs| async move { jobs.watch(wire::WatchRequest { job: id.0 }).await }).await?;
        }
    }
    /// The finished image. `received` hears (bytes received, bytes in all).
    ///
    /// # Errors
    /// When there is no such job, it is not done, or the connection breaks and does not come back.
    pub async fn fetch(
        &self,
        id: JobId,
        mut received: impl FnMut(u64, u64) + Send,
    ) -> Result<FetchedImage, ClientError> {
        let mut retries = Retries::default();
        loop {
            match self.fetch_once(id, &mut received).await {
                Ok(image) => return Ok(image),
                Err(failure) => self.may_repeat(&mut retries, failure).await?,
            }
        }
    }
    async fn fetch_once(
        &self,
        id: JobId,
        received: &mut (impl FnMut(u64, u64) + Send),
    ) -> Result<FetchedImage, Failure> {
        let failed = |status| self.failure(status);
        let senseless = |e: WireError| Failure::Final(self.senseless(e));
        let request = wire::FetchImageRequest { job: id.0 };
        let mut stream = self.jobs.clone().fetch_image(request).await.map_err(failed)?.into_inner();
        let mut assembler = Assembler::new("image size in bytes", MAX_IMAGE_BYTES, "MAX_IMAGE_BYTES");
        let mut total = 0;
        while let Some(chunk) = stream.message().await.map_err(failed)? {
            total = total.max(chunk.total_bytes);
            assembler.push(&chunk).map_err(senseless)?;
            received(assembler.received(), total);
        }
        let (exr, digest) = assembler.finish().map_err(senseless)?;
        Ok(FetchedImage { exr, digest: digest.to_string() })
    }
    /// Cancels a job; one that has ended stays as it is. Returns its state afterwards.
    ///
    /// # Errors
    /// When there is no such job or the connection breaks.
    pub async fn cancel(&self, id: JobId) -> Result<JobProgress, ClientError> {
        let reply = self.call(|mut jobs| async move { jobs.cancel(wire::CancelRequest { job: id.0 }).await }).await?;
        self.snapshot(reply)
    }
    /// The workers that are there.
    ///
    /// # Errors
    /// When the connection breaks.
    pub async fn workers(&self) -> Result<Vec<WorkerInfo>, ClientError> {
        let reply = self.call(|mut jobs| async move { jobs.workers(wire::WorkersRequest {}).await }).await?;
        Ok(reply.workers.into_iter().map(Into::into).collect())
    }
}

//! What coordinator and workers say to each other, as domain types.

use crate::collective::Transfers;
use crate::digest::Digest;
use crate::pieces::STRIPES;
use crate::types::{JobId, Limits};
use gatherlight_render::photon::{EmissionRange, MapKind};
use gatherlight_render::settings::RenderSettings;
use std::fmt;
use std::net::SocketAddr;
use std::time::Duration;

/// Names a lease for ever.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct LeaseId(pub u64);

/// Names a worker's session for ever; a worker that comes back gets another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct WorkerId(pub u64);

/// The secret name of a worker's session, for its fetches and deliveries: 128 random bits. Never shown by `Debug`.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SessionKey(pub [u8; 16]);

impl fmt::Debug for SessionKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SessionKey(…)")
    }
}

/// A photon map to fetch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapRef {
    /// Which map.
    pub kind: MapKind,
    /// BLAKE3 of its encoded bytes.
    pub digest: Digest,
    /// Length of its encoded bytes.
    pub bytes: u64,
}

/// What later phases read, once it is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputRef {
    /// A photon map.
    Map(MapRef),
    /// The joined bootstrap.
    Bootstrap(BlobRef),
    /// Where the samples go.
    SampleMap(BlobRef),
}

impl InputRef {
    /// As it is fetched.
    pub fn blob(&self) -> BlobRef {
        match *self {
            InputRef::Map(map) => BlobRef { digest: map.digest, bytes: map.bytes },
            InputRef::Bootstrap(blob) | InputRef::SampleMap(blob) => blob,
        }
    }
}

/// What to do with a lease's indices.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Task {
    /// Trace these photon paths.
    Emission {
        /// The round, from 0.
        round: u32,
        /// For this map.
        map: MapKind,
    },
    /// Trace these bootstrap paths.
    Bootstrap,
    /// Compute these units of the round's splat phase.
    Splat {
        /// The round, from 0.
        round: u32,
        /// The bootstrap they read, where there is one.
        bootstrap: Option<BlobRef>,
    },
    /// Render these tiles.
    Gather {
        /// The round, from 0.
        round: u32,
        /// The maps they read.
        maps: Vec<MapRef>,
        /// How many samples each pixel takes, where they are not all alike.
        sample_map: Option<BlobRef>,
    },
}

impl Task {
    /// Bytes of the maps, bootstrap and sample map it reads.
    pub fn input_bytes(&self) -> u64 {
        match self {
            Task::Emission { .. } | Task::Bootstrap => 0,
            Task::Splat { bootstrap, .. } => bootstrap.map_or(0, |b| b.bytes),
            Task::Gather { maps, sample_map, .. } => {
                maps.iter().map(|m| m.bytes).sum::<u64>() + sample_map.map_or(0, |b| b.bytes)
            }
        }
    }
}

/// Indices of one phase of one job, given to one worker for a time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lease {
    /// Its name.
    pub id: LeaseId,
    /// How many times these indices were leased, this one included.
    pub attempt: u32,
    /// The job.
    pub job: JobId,
    /// The indices.
    pub range: EmissionRange,
    /// What to do.
    pub task: Task,
}

/// A file by its content.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BlobRef {
    /// BLAKE3.
    pub digest: Digest,
    /// Length in bytes.
    pub bytes: u64,
}

/// A scene's files by their content.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct SceneManifest {
    /// The root file's name, without directory.
    pub name: String,
    /// The root file.
    pub root: BlobRef,
    /// External files by URI, in file order.
    pub externals: Vec<(String, BlobRef)>,
}

impl SceneManifest {
    /// Every blob once, the root first.
    pub fn blobs(&self) -> Vec<BlobRef> {
        let mut blobs = vec![self.root];
        for &(_, blob) in &self.externals {
            if !blobs.contains(&blob) {
                blobs.push(blob);
            }
        }
        blobs
    }
}

/// What a client wants rendered.
#[derive(Clone, Debug, PartialEq)]
pub struct Submission {
    /// Name for listings.
    pub name: String,
    /// Makes a repeated submission the same job.
    pub request_key: [u8; 16],
    /// The scene's files.
    pub manifest: SceneManifest,
    /// What determines the image.
    pub settings: RenderSettings,
    /// When to end it early.
    pub limits: Limits,
    /// Jobs of higher priority get workers first.
    pub priority: i32,
}

impl Submission {
    /// Without a name or limits.
    pub fn new(manifest: SceneManifest, settings: RenderSettings) -> Self {
        let limits = Limits::default();
        Submission { name: String::new(), request_key: [0; 16], manifest, settings, limits, priority: 0 }
    }
}

/// A worker introduces itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hello {
    /// Name for listings.
    pub name: String,
    /// Compute threads, ≥ 1.
    pub threads: u32,
    /// Memory it may use, in bytes.
    pub memory_bytes: u64,
    /// Where it listens for other workers; `None`: it does not relay.
    pub relay: Option<RelayAddress>,
}

/// Where a worker listens for other workers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RelayAddress {
    /// The address.
    pub address: SocketAddr,
    /// Its user gave it; otherwise it holds only where the worker is seen to connect from that address, and is not behind NAT.
    pub given: bool,
}

/// Lets its holder have one payload, from the coordinator or from any worker that relays it. Not a session's secret, since
/// workers show it to each other.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct PassTicket(pub [u8; 16]);

impl PassTicket {
    /// Whether it is `other`, in a time that does not tell where they differ.
    pub fn is(&self, other: &PassTicket) -> bool {
        self.0.iter().zip(other.0).fold(0, |all, (a, b)| all | (a ^ b)) == 0
    }
}

impl fmt::Debug for PassTicket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("PassTicket(…)")
    }
}

/// From whom a worker gets a payload.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Route {
    /// The payload.
    pub blob: BlobRef,
    /// What to show.
    pub ticket: PassTicket,
    /// For each stripe, workers to ask, in this order; after them the coordinator.
    pub sources: [Vec<SocketAddr>; STRIPES],
}

/// What a worker asks of a relay.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PassRequest {
    /// The payload.
    pub digest: Digest,
    /// From its [`Route`].
    pub ticket: PassTicket,
    /// The stripe, below [`STRIPES`].
    pub stripe: usize,
    /// First piece wanted.
    pub first: u64,
}

/// From a worker.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FromWorker {
    /// First message.
    Hello(Hello),
    /// Still there.
    Heartbeat,
    /// A lease could not be done.
    TaskFailed {
        /// The lease.
        lease: LeaseId,
        /// Its attempt.
        attempt: u32,
        /// Why.
        error: String,
    },
    /// A lease is given back undone.
    TaskReturned {
        /// The lease.
        lease: LeaseId,
        /// Its attempt.
        attempt: u32,
    },
    /// No more leases, please.
    Draining,
}

/// To a worker.
#[derive(Clone, Debug, PartialEq)]
pub enum ToWorker {
    /// First message.
    Welcome {
        /// The session's number.
        worker: WorkerId,
        /// The session's secret name, to locate and deliver.
        session: SessionKey,
        /// Time between heartbeats.
        heartbeat: Duration,
    },
    /// A job is coming.
    Prepare {
        /// The job.
        job: JobId,
        /// Its scene.
        scene: SceneManifest,
        /// Its settings.
        settings: Box<RenderSettings>,
    },
    /// Do this.
    Lease(Lease),
    /// Not wanted any more.
    Revoke(LeaseId),
    /// The job has ended.
    Forget(JobId),
    /// This will be read soon: begin to get it, and to pass it on.
    Route(Route),
}

/// What comes before a result's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DeliverHeader {
    /// From [`ToWorker::Welcome`].
    pub session: SessionKey,
    /// The lease.
    pub lease: LeaseId,
    /// Its attempt.
    pub attempt: u32,
    /// The indices computed.
    pub range: EmissionRange,
    /// Time spent computing.
    pub busy: Duration,
    /// Length of the result in bytes.
    pub bytes: u64,
    /// BLAKE3 of the result.
    pub digest: Digest,
    /// What the worker fetched since its last result.
    pub fetched: Transfers,
}

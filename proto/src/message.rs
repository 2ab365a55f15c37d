//! What coordinator and workers say to each other, as domain types.

use crate::digest::Digest;
use crate::types::JobId;
use gatherlight_render::photon::{EmissionRange, MapKind};
use gatherlight_render::settings::RenderSettings;
use std::time::Duration;

/// Names a lease for ever.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct LeaseId(pub u64);

/// Names a worker's session for ever; a worker that comes back gets another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct WorkerId(pub u64);

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

/// A worker introduces itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hello {
    /// Name for listings.
    pub name: String,
    /// Compute threads, ≥ 1.
    pub threads: u32,
    /// Memory it may use, in bytes.
    pub memory_bytes: u64,
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
        /// The session's secret name, for fetches and deliveries.
        session: u64,
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
}

/// What comes before a result's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DeliverHeader {
    /// From [`ToWorker::Welcome`].
    pub session: u64,
    /// The lease.
    pub lease: LeaseId,
    /// Its attempt.
    pub attempt: u32,
    /// The indices computed.
    pub range: EmissionRange,
    /// Time spent computing.
    pub busy: Duration,
}

//! What a worker holds: prepared scenes and maps of the present jobs, and scene files by digest for the next ones.

use crate::client::Remote;
use crate::error::TaskError;
use crate::executor::Executor;
use crate::session::Announced;
use crate::shared::Shared;
use bytes::Bytes;
use gatherlight_proto::Digest;
use gatherlight_proto::limits::{MAX_BLOB_BYTES, MAX_MAP_BYTES};
use gatherlight_proto::message::{BlobRef, MapRef};
use gatherlight_proto::payload::map::decode_map;
use gatherlight_proto::types::JobId;
use gatherlight_render::import::SceneBundle;
use gatherlight_render::job::{PhotonMap, PhotonMaps, PreparedJob};
use gatherlight_render::photon::MapKind;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// Part of a worker's memory for scene files that no present job needs any more.
const BLOB_SHARE: u64 = 4;
/// Bytes of memory a photon takes at least, to bound what a map may claim to hold.
const MIN_PHOTON_BYTES: u64 = 16;

/// One job's heavy parts.
#[derive(Default)]
struct Held {
    prepared: Option<Arc<PreparedJob>>,
    maps: PhotonMaps,
    digests: Vec<Digest>,
}

/// The cache of one worker; it outlives its sessions.
pub struct Cache {
    memory_bytes: u64,
    shared: Shared,
    jobs: BTreeMap<JobId, Held>,
    /// Scene files, the latest used last.
    blobs: VecDeque<(Digest, Bytes)>,
    blob_bytes: u64,
}

impl Cache {
    /// An empty cache of a worker that may use `memory_bytes` beside what is `shared`.
    pub fn new(memory_bytes: u64, shared: Shared) -> Self {
        Cache { memory_bytes, shared, jobs: BTreeMap::new(), blobs: VecDeque::new(), blob_bytes: 0 }
    }
    /// Drops what is held for a job.
    pub fn forget(&mut self, job: JobId) {
        self.jobs.remove(&job);
    }
    /// Drops what is held for all jobs; scene files stay.
    pub fn forget_all(&mut self) {
        self.jobs.clear();
    }
    /// The job's scene, fetched and built the first time.
    ///
    /// # Errors
    /// When a file does not come, or the scene cannot be built.
    pub async fn prepared(
        &mut self,
        id: JobId,
        job: &Announced,
        remote: &Remote,
        executor: &Executor,
    ) -> Result<Arc<PreparedJob>, TaskError> {
        if let Some(prepared) = self.jobs.get(&id).and_then(|j| j.prepared.clone()) {
            return Ok(prepared);
        }
        let prepared = match self.shared.scene(&job.scene, &job.settings) {
            Some(prepared) => prepared,
            None => {
                let bundle = self.bundle(job, remote).await?;
                let settings = job.settings.clone();
                Arc::new(executor.run(move || PreparedJob::prepare(&bundle, &settings)).await??)
            }
        };
        self.jobs.entry(id).or_default().prepared = Some(prepared.clone());
        Ok(prepared)
    }
    /// The job's maps, fetched the first time.
    ///
    /// # Errors
    /// When a map does not come, is not what it should be, or does not fit.
    pub async fn maps(
        &mut self,
        id: JobId,
        wanted: &[MapRef],
        remote: &Remote,
        executor: &Executor,
    ) -> Result<PhotonMaps, TaskError> {
        for &map in wanted {
            if self.jobs.get(&id).is_some_and(|j| j.digests.contains(&map.digest)) {
                continue;
            }
            let decoded = self.map(map, remote, executor).await?;
            let held = self.jobs.entry(id).or_default();
            match map.kind {
                MapKind::Global => held.maps.global = Some(decoded),
                MapKind::Caustic => held.maps.caustic = Some(decoded),
            }
            held.digests.push(map.digest);
        }
        Ok(self.jobs.entry(id).or_default().maps.clone())
    }
    async fn map(&self, map: MapRef, remote: &Remote, executor: &Executor) -> Result<Arc<PhotonMap>, TaskError> {
        if let Some(shared) = self.shared.map(map.digest) {
            return Ok(shared);
        }
        let limit = self.memory_bytes;
        if map.bytes > limit {
            return Err(TaskError::Memory { map: map.kind.name(), bytes: map.bytes, limit });
        }
        let what = format!("the {} map", map.kind.name());
        let blob = BlobRef { digest: map.digest, bytes: map.bytes };
        let bytes = remote.fetch(&what, blob, MAX_MAP_BYTES, "MAX_MAP_BYTES").await?;
        let max_photons = limit / MIN_PHOTON_BYTES;
        let decoded = executor.run(move || decode_map(&bytes, map.kind, max_photons)).await??;
        Ok(Arc::new(decoded))
    }
    async fn bundle(&mut self, job: &Announced, remote: &Remote) -> Result<SceneBundle, TaskError> {
        let scene = &job.scene;
        let mut externals = Vec::with_capacity(scene.externals.len());
        let root = self.blob(&scene.name, scene.root, remote).await?;
        for (uri, blob) in &scene.externals {
            externals.push((uri.clone(), Arc::from(&self.blob(uri, *blob, remote).await?[..])));
        }
        Ok(SceneBundle { name: scene.name.clone(), root: Arc::from(&root[..]), externals })
    }
    async fn blob(&mut self, what: &str, blob: BlobRef, remote: &Remote) -> Result<Bytes, TaskError> {
        if let Some(i) = self.blobs.iter().position(|(d, _)| *d == blob.digest)
            && let Some(entry) = self.blobs.remove(i)
        {
            self.blobs.push_back(entry.clone());
            return Ok(entry.1);
        }
        let bytes = remote.fetch(what, blob, MAX_BLOB_BYTES, "MAX_BLOB_BYTES").await?;
        self.keep(blob.digest, bytes.clone());
        Ok(bytes)
    }
    fn keep(&mut self, digest: Digest, bytes: Bytes) {
        let limit = self.memory_bytes / BLOB_SHARE;
        if bytes.len() as u64 > limit {
            return;
        }
        self.blob_bytes += bytes.len() as u64;
        self.blobs.push_back((digest, bytes));
        while self.blob_bytes > limit {
            let Some((_, oldest)) = self.blobs.pop_front() else { return };
            self.blob_bytes -= oldest.len() as u64;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scene_files_are_kept_within_a_quarter_of_the_memory() {
        let mut cache = Cache::new(4_000, Shared::default());
        let digests: Vec<Digest> = (0..5).map(|i| Digest([i; 32])).collect();
        digests.iter().for_each(|&d| cache.keep(d, Bytes::from(vec![0; 300])));
        assert_eq!(cache.blobs.iter().map(|b| b.0).collect::<Vec<_>>(), digests[2..]);
        cache.keep(Digest([9; 32]), Bytes::from(vec![0; 1_001]));
        assert_eq!((cache.blobs.len(), cache.blob_bytes), (3, 900));
    }
}

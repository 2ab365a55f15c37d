//! What a worker holds: prepared scenes, bootstraps, sample maps and the present round's maps of the present jobs, and scene files by digest
//! for the next ones.

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
use gatherlight_proto::payload::{bootstrap, sample_map};
use gatherlight_proto::types::JobId;
use gatherlight_render::film::SampleMap;
use gatherlight_render::import::SceneBundle;
use gatherlight_render::integrator::Bootstrap;
use gatherlight_render::job::{Phase, PhotonMap, PhotonMaps, PreparedJob};
use gatherlight_render::photon::{EmissionRange, MapKind};
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
    /// At most one of each kind: those of the round that was gathered last.
    maps: BTreeMap<MapKind, (Digest, Arc<PhotonMap>)>,
    bootstrap: Option<(Digest, Arc<Bootstrap>)>,
    sample_map: Option<(Digest, Arc<SampleMap>)>,
}

impl Held {
    /// Drops maps that are not among those `wanted`: they are of a round that is over.
    fn keep_only(&mut self, wanted: &[MapRef]) {
        self.maps.retain(|&kind, (digest, _)| wanted.iter().any(|w| w.kind == kind && w.digest == *digest));
    }
    fn photon_maps(&self) -> PhotonMaps {
        let map = |kind| self.maps.get(&kind).map(|(_, map)| map.clone());
        PhotonMaps { global: map(MapKind::Global), caustic: map(MapKind::Caustic) }
    }
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
    /// The maps of a round of the job, fetched the first time; those of another round are dropped before.
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
        self.jobs.entry(id).or_default().keep_only(wanted);
        for &map in wanted {
            if self.jobs.get(&id).is_some_and(|j| j.maps.contains_key(&map.kind)) {
                continue;
            }
            let decoded = self.map(map, remote, executor).await?;
            self.jobs.entry(id).or_default().maps.insert(map.kind, (map.digest, decoded));
        }
        Ok(self.jobs.entry(id).or_default().photon_maps())
    }
    /// The job's bootstrap, fetched the first time.
    ///
    /// # Errors
    /// When it does not come, is not what it should be, or does not fit.
    pub async fn bootstrap(
        &mut self,
        id: JobId,
        wanted: BlobRef,
        prepared: &PreparedJob,
        remote: &Remote,
        executor: &Executor,
    ) -> Result<Arc<Bootstrap>, TaskError> {
        if let Some((digest, held)) = self.jobs.get(&id).and_then(|j| j.bootstrap.clone())
            && digest == wanted.digest
        {
            return Ok(held);
        }
        let joined = match self.shared.bootstrap(wanted.digest) {
            Some(shared) => shared,
            None => {
                let what = "bootstrap";
                self.check_fits(what, wanted.bytes)?;
                let bytes = remote.fetch(&format!("the {what}"), wanted, MAX_MAP_BYTES, "MAX_MAP_BYTES").await?;
                let paths = prepared.phases().iter().find_map(|p| match *p {
                    Phase::Bootstrap { paths } => Some(paths),
                    _ => None,
                });
                let all = EmissionRange { first: 0, end: paths.unwrap_or(0) };
                let decode = move || bootstrap::decode(&bytes, all).map(Bootstrap::new);
                Arc::new(executor.run(decode).await??)
            }
        };
        self.jobs.entry(id).or_default().bootstrap = Some((wanted.digest, joined.clone()));
        Ok(joined)
    }
    /// The job's sample map, fetched the first time.
    ///
    /// # Errors
    /// When it does not come, is not what it should be, or does not fit.
    pub async fn sample_map(
        &mut self,
        id: JobId,
        wanted: BlobRef,
        prepared: &PreparedJob,
        remote: &Remote,
    ) -> Result<Arc<SampleMap>, TaskError> {
        if let Some((digest, held)) = self.jobs.get(&id).and_then(|j| j.sample_map.clone())
            && digest == wanted.digest
        {
            return Ok(held);
        }
        let map = match self.shared.sample_map(wanted.digest) {
            Some(shared) => shared,
            None => {
                self.check_fits("sample map", wanted.bytes)?;
                let bytes = remote.fetch("the sample map", wanted, MAX_MAP_BYTES, "MAX_MAP_BYTES").await?;
                Arc::new(sample_map::decode(&bytes, prepared.grid())?)
            }
        };
        self.jobs.entry(id).or_default().sample_map = Some((wanted.digest, map.clone()));
        Ok(map)
    }
    fn check_fits(&self, what: &str, bytes: u64) -> Result<(), TaskError> {
        let limit = self.memory_bytes;
        if bytes > limit {
            return Err(TaskError::Memory { what: what.into(), bytes, limit });
        }
        Ok(())
    }
    async fn map(&self, map: MapRef, remote: &Remote, executor: &Executor) -> Result<Arc<PhotonMap>, TaskError> {
        if let Some(shared) = self.shared.map(map.digest) {
            return Ok(shared);
        }
        let what = format!("{} map", map.kind.name());
        self.check_fits(&what, map.bytes)?;
        let blob = BlobRef { digest: map.digest, bytes: map.bytes };
        let bytes = remote.fetch(&format!("the {what}"), blob, MAX_MAP_BYTES, "MAX_MAP_BYTES").await?;
        let max_photons = self.memory_bytes / MIN_PHOTON_BYTES;
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
    use gatherlight_render::photon::PhotonBatch;

    #[test]
    fn a_round_s_maps_replace_those_of_the_round_before() {
        let mut held = Held::default();
        let map = |kind, round: u8| MapRef { kind, digest: Digest([round; 32]), bytes: 1 };
        let empty = |kind| {
            let range = EmissionRange { first: 0, end: 0 };
            let (positions, powers, normals) = (Vec::new(), Vec::new(), Vec::new());
            Arc::new(PhotonMap::build(
                kind,
                PhotonBatch { range, positions, powers, normals, vertices: None, non_finite: 0 },
            ))
        };
        for round in 0..100 {
            // Some rounds lack the caustic map.
            let kinds = if round % 3 == 0 { &MapKind::ALL[..1] } else { &MapKind::ALL[..] };
            let wanted: Vec<MapRef> = kinds.iter().map(|&kind| map(kind, round)).collect();
            held.keep_only(&wanted);
            assert!(held.maps.is_empty(), "round {round}");
            wanted.iter().for_each(|w| drop(held.maps.insert(w.kind, (w.digest, empty(w.kind)))));
            held.keep_only(&wanted);
            assert_eq!(held.maps.len(), kinds.len());
            assert_eq!(held.photon_maps().caustic.is_some(), kinds.len() == 2);
        }
    }

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

//! What a worker holds to compute with: prepared scenes, bootstraps, sample maps and the present round's maps of the present jobs.
//! Their bytes are the relay's.

use crate::client::Remote;
use crate::error::TaskError;
use crate::executor::Executor;
use crate::session::Announced;
use crate::shared::Shared;
use bytes::Bytes;
use gatherlight_proto::Digest;
use gatherlight_proto::collective::{Collective, Transfer, Transfers};
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
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

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
    /// Drops maps that are not among those `wanted`, and returns their digests: they are of a round that is over.
    fn keep_only(&mut self, wanted: &[MapRef]) -> Vec<Digest> {
        let is_over = |kind: &MapKind, map: &mut (Digest, Arc<PhotonMap>)| {
            !wanted.iter().any(|w| w.kind == *kind && w.digest == map.0)
        };
        self.maps.extract_if(.., is_over).map(|(_, (digest, _))| digest).collect()
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
    /// What was fetched since it was last asked for.
    fetched: Transfers,
}

impl Cache {
    /// An empty cache of a worker that may use `memory_bytes` beside what is `shared`.
    pub fn new(memory_bytes: u64, shared: Shared) -> Self {
        Cache { memory_bytes, shared, jobs: BTreeMap::new(), fetched: Transfers::default() }
    }
    /// What was fetched since this was last asked.
    pub fn take_fetched(&mut self) -> Transfers {
        std::mem::take(&mut self.fetched)
    }
    /// Drops what is held for a job.
    pub fn forget(&mut self, job: JobId) {
        self.jobs.remove(&job);
    }
    /// Drops what is held for all jobs.
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
        let over = self.jobs.entry(id).or_default().keep_only(wanted);
        over.into_iter().for_each(|digest| remote.forget(digest));
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
                let bytes = self.read(Collective::BroadcastBootstrap, "bootstrap", wanted, remote).await?;
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
                let bytes = self.read(Collective::BroadcastSampleMap, "sample map", wanted, remote).await?;
                Arc::new(sample_map::decode(&bytes, prepared.grid())?)
            }
        };
        self.jobs.entry(id).or_default().sample_map = Some((wanted.digest, map.clone()));
        Ok(map)
    }
    /// Fetches something that the job's tasks read, if it fits.
    async fn read(&mut self, kind: Collective, what: &str, blob: BlobRef, remote: &Remote) -> Result<Bytes, TaskError> {
        let (bytes, limit) = (blob.bytes, self.memory_bytes);
        if bytes > limit {
            return Err(TaskError::Memory { what: what.into(), bytes, limit });
        }
        self.fetch(kind, &format!("the {what}"), blob, (MAX_MAP_BYTES, "MAX_MAP_BYTES"), remote).await
    }
    /// Fetches, and counts what came.
    async fn fetch(
        &mut self,
        kind: Collective,
        what: &str,
        blob: BlobRef,
        (limit_bytes, limit_name): (u64, &'static str),
        remote: &Remote,
    ) -> Result<Bytes, TaskError> {
        let began = Instant::now();
        let (read, is_new) = remote.fetch(what, blob, limit_bytes, limit_name).await?;
        if is_new {
            self.fetched.record(kind, Transfer { count: 1, bytes: blob.bytes, time: began.elapsed() });
        }
        Ok(read)
    }
    async fn map(&mut self, map: MapRef, remote: &Remote, executor: &Executor) -> Result<Arc<PhotonMap>, TaskError> {
        if let Some(shared) = self.shared.map(map.digest) {
            return Ok(shared);
        }
        let blob = BlobRef { digest: map.digest, bytes: map.bytes };
        let bytes = self.read(Collective::BroadcastMap, &format!("{} map", map.kind.name()), blob, remote).await?;
        let max_photons = self.memory_bytes / MIN_PHOTON_BYTES;
        let decoded = executor.run(move || decode_map(&bytes, map.kind, max_photons)).await??;
        Ok(Arc::new(decoded))
    }
    async fn bundle(&mut self, job: &Announced, remote: &Remote) -> Result<SceneBundle, TaskError> {
        const LIMIT: (u64, &str) = (MAX_BLOB_BYTES, "MAX_BLOB_BYTES");
        let (scene, kind) = (&job.scene, Collective::BroadcastScene);
        let mut externals = Vec::with_capacity(scene.externals.len());
        let root = self.fetch(kind, &scene.name, scene.root, LIMIT, remote).await?;
        for (uri, blob) in &scene.externals {
            let bytes = self.fetch(kind, uri, *blob, LIMIT, remote).await?;
            externals.push((uri.clone(), Arc::from(&bytes[..])));
        }
        Ok(SceneBundle { name: scene.name.clone(), root: Arc::from(&root[..]), externals })
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
}

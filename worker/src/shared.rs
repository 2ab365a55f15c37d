//! What a worker shares with a coordinator in the same process, so that it is not there twice. Between processes this
//! is empty, and everything comes over the wire.

use gatherlight_proto::Digest;
use gatherlight_proto::message::SceneManifest;
use gatherlight_render::film::SampleMap;
use gatherlight_render::integrator::Bootstrap;
use gatherlight_render::job::{PhotonMap, PreparedJob};
use gatherlight_render::settings::RenderSettings;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// One prepared scene with what it was made from.
type Scene = (SceneManifest, RenderSettings, Arc<PreparedJob>);

/// What was offered under each digest, with the number of offers: maps of two rounds may be equal.
type Offered<T> = Arc<Mutex<BTreeMap<Digest, (Arc<T>, usize)>>>;

/// Scenes, maps, bootstraps and sample maps that are in this process already; clones share them.
#[derive(Clone, Default)]
pub struct Shared {
    scenes: Arc<Mutex<Vec<Scene>>>,
    maps: Offered<PhotonMap>,
    bootstraps: Offered<Bootstrap>,
    sample_maps: Offered<SampleMap>,
}

impl Shared {
    /// Offers a scene, as prepared from these files with these settings.
    pub fn offer_scene(&self, manifest: SceneManifest, settings: RenderSettings, prepared: Arc<PreparedJob>) {
        lock(&self.scenes).push((manifest, settings, prepared));
    }
    /// The scene prepared from these files with these settings.
    pub fn scene(&self, manifest: &SceneManifest, settings: &RenderSettings) -> Option<Arc<PreparedJob>> {
        let scenes = lock(&self.scenes);
        scenes.iter().find(|(m, s, _)| m == manifest && s == settings).map(|(_, _, prepared)| prepared.clone())
    }
    /// Offers a map under the digest by which leases name it.
    pub fn offer_map(&self, digest: Digest, map: Arc<PhotonMap>) {
        lock(&self.maps).entry(digest).or_insert((map, 0)).1 += 1;
    }
    /// The map of this digest.
    pub fn map(&self, digest: Digest) -> Option<Arc<PhotonMap>> {
        lock(&self.maps).get(&digest).map(|(map, _)| map.clone())
    }
    /// Offers a bootstrap under the digest by which leases name it.
    pub fn offer_bootstrap(&self, digest: Digest, bootstrap: Arc<Bootstrap>) {
        lock(&self.bootstraps).entry(digest).or_insert((bootstrap, 0)).1 += 1;
    }
    /// The bootstrap of this digest.
    pub fn bootstrap(&self, digest: Digest) -> Option<Arc<Bootstrap>> {
        lock(&self.bootstraps).get(&digest).map(|(bootstrap, _)| bootstrap.clone())
    }
    /// Offers a sample map under the digest by which leases name it.
    pub fn offer_sample_map(&self, digest: Digest, map: Arc<SampleMap>) {
        lock(&self.sample_maps).entry(digest).or_insert((map, 0)).1 += 1;
    }
    /// The sample map of this digest.
    pub fn sample_map(&self, digest: Digest) -> Option<Arc<SampleMap>> {
        lock(&self.sample_maps).get(&digest).map(|(map, _)| map.clone())
    }
    /// Takes one offer back; what is not offered any more is dropped.
    pub fn withdraw(&self, digest: Digest) {
        withdraw(&mut lock(&self.maps), digest);
        withdraw(&mut lock(&self.bootstraps), digest);
        withdraw(&mut lock(&self.sample_maps), digest);
    }
    /// Number of maps, bootstraps and sample maps that are offered.
    pub fn offers(&self) -> usize {
        lock(&self.maps).len() + lock(&self.bootstraps).len() + lock(&self.sample_maps).len()
    }
}

fn withdraw<T>(offered: &mut BTreeMap<Digest, (Arc<T>, usize)>, digest: Digest) {
    if let Some((_, count)) = offered.get_mut(&digest) {
        *count -= 1;
        if *count == 0 {
            offered.remove(&digest);
        }
    }
}

impl std::fmt::Debug for Shared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Shared").finish_non_exhaustive()
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Nothing panics while it is held.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_offered_twice_is_there_until_it_is_withdrawn_twice() {
        let shared = Shared::default();
        let (digest, other) = (Digest([1; 32]), Digest([2; 32]));
        for _ in 0..2 {
            shared.offer_bootstrap(digest, Arc::new(Bootstrap::new(vec![1.0])));
        }
        shared.withdraw(other);
        shared.withdraw(digest);
        assert!(shared.bootstrap(digest).is_some() && shared.bootstrap(other).is_none());
        shared.withdraw(digest);
        shared.withdraw(digest);
        assert_eq!((shared.bootstrap(digest), shared.offers()), (None, 0));
    }
}

//! What a worker shares with a coordinator in the same process, so that it is not there twice. Between processes this
//! is empty, and everything comes over the wire.

use gatherlight_proto::Digest;
use gatherlight_proto::message::SceneManifest;
use gatherlight_render::job::{PhotonMap, PreparedJob};
use gatherlight_render::settings::RenderSettings;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// One prepared scene with what it was made from.
type Scene = (SceneManifest, RenderSettings, Arc<PreparedJob>);

/// Scenes and maps that are in this process already; clones share them.
#[derive(Clone, Default)]
pub struct Shared {
    scenes: Arc<Mutex<Vec<Scene>>>,
    maps: Arc<Mutex<BTreeMap<Digest, Arc<PhotonMap>>>>,
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
        lock(&self.maps).insert(digest, map);
    }
    /// The map of this digest.
    pub fn map(&self, digest: Digest) -> Option<Arc<PhotonMap>> {
        lock(&self.maps).get(&digest).cloned()
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

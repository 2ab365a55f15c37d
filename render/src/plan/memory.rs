//! Peak memory of a job's processes, predicted.
//!
//! Sums what the phases hold at once. The figures a photon are what the arrays of each step hold; the others are
//! measured. `tests/tests/memory.rs` holds the sum against whole processes.

use super::EmissionPlan;
use crate::film::ChannelSet;
use crate::photon::map::PhotonMap;
use crate::photon::precomputed::PrecomputedIrradiance;
use crate::scene::Scene;
use crate::settings::{Method, RenderSettings};

/// What a process holds besides scene, maps and film: code, threads, network buffers.
const PROCESS_BYTES: u64 = 11 << 20;
/// Peak per triangle while a scene is read and its acceleration structure built.
const SCENE_BYTES_PER_TRIANGLE: u64 = 340;
/// Per photon while a tree is built: the records that are sorted (16), the coordinates and the order read off them (16),
/// powers and normals (6); or, while the map is encoded, the map (22), its blocks and their concatenation.
const BUILD_BYTES_PER_PHOTON: u64 = 40;
/// Per photon of the map that is not being built: waiting for its own merge (18), or built and served (22).
const WAITING_BYTES_PER_PHOTON: u64 = 20;
/// Per photon on its way from a worker's emission into the merge: traced, joined, encoded, received, decoded. The allocator
/// keeps these arrays for the next lease, and hardly any of it serves the large arrays of the later steps. Measured with
/// 1 and 2 threads: 15 to 90, most with two maps of some million photons.
const TRAVELLING_BYTES_PER_PHOTON: u64 = 50;
/// Photons on their way at once, at most: two leases of the scheduler's largest size.
const TRAVELLING_PHOTONS: u64 = 1 << 20;
/// What a light vertex takes beyond a photon, in memory and encoded: direction, two shares and length.
const VERTEX_BYTES: u64 = DIRECTION_BYTES + 8 + 1;
/// A direction, in memory and encoded.
pub(super) const DIRECTION_BYTES: u64 = 4;
/// An encoded photon.
const ENCODED_BYTES_PER_PHOTON: u64 = 10;
/// The image, and what its encoding holds besides, in films.
const FILM_COPIES: f64 = 3.4;

/// Bytes that each kind of process takes at its peak.
pub(super) struct Memory {
    /// A worker of a cluster.
    pub(super) worker: u64,
    /// The coordinator of a cluster.
    pub(super) coordinator: u64,
    /// Coordinator and worker in one process.
    pub(super) single_process: u64,
    /// Maps that each worker receives, of one round.
    pub(super) broadcast: u64,
}

/// Predicts from the maps' emission passes.
pub(super) fn predict(scene: &Scene, settings: &RenderSettings, global: u64, caustic: u64) -> Memory {
    let photons = global + caustic;
    let gathers = settings.method == Method::Photon && settings.final_gather > 0 && global > 0;
    let cache = if gathers { PrecomputedIrradiance::memory_bytes_for(global, settings.k) } else { 0 };
    let vertices = settings.method == Method::Vcm;
    let more = if vertices { VERTEX_BYTES } else { 0 };
    let maps = PhotonMap::memory_bytes_for(photons as usize, vertices) + cache;
    let encoded = photons * (ENCODED_BYTES_PER_PHOTON + more);
    // Merged and permuted, a light vertex is there twice.
    let travelling = photons.min(TRAVELLING_PHOTONS) * (TRAVELLING_BYTES_PER_PHOTON + 2 * more);
    let building = photon_bytes(global, caustic) + photons * 2 * more;
    let base = process(scene);
    if settings.has_independent_rounds() {
        // Each worker computes whole rounds by itself, and only images travel.
        let round = base + building.max(maps) + film(settings);
        return Memory { worker: round, coordinator: base + film(settings), single_process: round, broadcast: 0 };
    }
    // A worker keeps the maps it reads as bytes, too, to pass them on; those of the next round arrive meanwhile.
    let kept = if settings.method.has_rounds() && settings.rounds > 1 { 2 * encoded } else { encoded };
    Memory {
        // Measured: what photons took on their way is not given back to the system before the maps come.
        worker: base + maps + kept + travelling,
        // Results wait for the journal as they were sent, too, and maps are kept to be broadcast.
        coordinator: base + 2 * travelling + building + kept + film(settings),
        single_process: base + travelling + building.max(maps) + film(settings),
        broadcast: encoded,
    }
}

/// The photons of two maps while they take most: one map is built while the photons of the other wait.
pub(super) fn photon_bytes(global: u64, caustic: u64) -> u64 {
    let (larger, smaller) = (global.max(caustic), global.min(caustic));
    larger.saturating_mul(BUILD_BYTES_PER_PHOTON).saturating_add(smaller.saturating_mul(WAITING_BYTES_PER_PHOTON))
}

/// Photons of one round that a map of all rounds' `emission` is expected to hold.
pub(super) fn stored_at_once(emission: Option<&EmissionPlan>, settings: &RenderSettings) -> u64 {
    let Some(e) = emission else { return 0 };
    if !settings.method.has_rounds() || e.paths == 0 {
        return e.expected_stored;
    }
    let paths = settings.share_of_round(e.paths, settings.rounds.saturating_sub(1));
    (u128::from(e.expected_stored) * u128::from(paths) / u128::from(e.paths)) as u64
}

/// Program and scene.
fn process(scene: &Scene) -> u64 {
    let triangles: u64 = scene.meshes.iter().map(|m| m.triangles.len() as u64).sum();
    PROCESS_BYTES + triangles * SCENE_BYTES_PER_TRIANGLE + scene.textures.memory_bytes() as u64
}

/// The image while it is encoded, or before that its sums over rounds.
fn film(settings: &RenderSettings) -> u64 {
    let channels = ChannelSet::new(&settings.layers).len() as u64;
    let pixels = u64::from(settings.width) * u64::from(settings.height);
    let encoding = (FILM_COPIES * (pixels * channels * 4) as f64) as u64;
    // The round in the making, and in f64 the sums of its channels, of its block's colour and of the squares of that.
    let summing = pixels * (4 * channels + 8 * channels + 8 * 3 * 2);
    if settings.image_rounds() > 1 { encoding.max(summing) } else { encoding }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photon::trace::Storage;

    #[test]
    fn a_method_with_rounds_holds_the_photons_of_one() {
        let e = EmissionPlan {
            paths: 1_000,
            pilot: 1_000,
            storage: Storage::All,
            expected_stored: 2_000,
            first_radius: 0.1,
        };
        let settings = RenderSettings { method: Method::Progressive, rounds: 8, ..RenderSettings::default() };
        assert_eq!(stored_at_once(Some(&e), &settings), 250);
        assert_eq!(stored_at_once(Some(&e), &RenderSettings { rounds: 8, ..RenderSettings::default() }), 2_000);
        assert_eq!(stored_at_once(None, &settings), 0);
    }
}

//! A cluster of the real programs, which may be killed and started again, and small jobs with some work in every phase.

use crate::processes::{Process, serve_at, worker};
use crate::{film_pixels_sha256, scene};
use gatherlight::client::{Client, connect};
use gatherlight::embedded;
use gatherlight_render::settings::{Method, RenderSettings};
use std::collections::BTreeMap;
use std::net::TcpListener;
use std::sync::{Mutex, PoisonError};
use tempfile::TempDir;

/// A coordinator that can be started again at the same address, with some workers.
pub struct RealCluster {
    /// Its store.
    pub store: TempDir,
    /// Where it listens.
    pub url: String,
    /// Its workers.
    pub workers: Vec<Process>,
    /// A client of it.
    pub client: Client,
    address: String,
    coordinator: Option<Process>,
}

/// An address of this machine that nobody listens on.
pub fn free_address() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    listener.local_addr().expect("has an address").to_string()
}

impl RealCluster {
    /// With so many workers of one thread each.
    ///
    /// # Panics
    /// When it does not start.
    pub async fn start(workers: usize) -> Self {
        let (store, address) = (tempfile::tempdir().expect("a directory"), free_address());
        let coordinator = serve_at(&address, store.path());
        let url = format!("http://{address}");
        let client = connect(&url, 5).await.unwrap_or_else(|e| panic!("{e}"));
        let workers = (0..workers).map(|i| worker(&url, &format!("worker-{i}"))).collect();
        RealCluster { store, address, url, workers, client, coordinator: Some(coordinator) }
    }
    /// Kills the coordinator with SIGKILL.
    ///
    /// # Panics
    /// When it does not run.
    pub fn kill(&mut self) {
        self.coordinator.take().expect("runs").kill();
    }
    /// The coordinator's process number.
    ///
    /// # Panics
    /// When it does not run.
    pub fn coordinator_id(&self) -> u32 {
        self.coordinator.as_ref().expect("runs").id()
    }
    /// Starts the coordinator again on the same store.
    pub fn start_again(&mut self) {
        self.coordinator = Some(serve_at(&self.address, self.store.path()));
    }
}

/// A second or so of work in each phase of each method.
pub fn settings(method: Method) -> RenderSettings {
    let small = RenderSettings { method, width: 96, height: 80, k: 40, ..RenderSettings::default() };
    let (photons, caustic_photons) = (500_000, 300_000);
    match method {
        Method::Progressive | Method::Vcm => {
            RenderSettings { rounds: 64, photons: 40_000, caustic_photons: 40_000, ..small }
        }
        Method::Mlt => RenderSettings { mutations: 400, chains: 64, bootstrap: 1_000_000, ..small },
        _ => RenderSettings { samples: 16, photons, caustic_photons, ..small },
    }
}

/// Digests of images that were rendered already, by settings.
static RENDERED: Mutex<BTreeMap<String, String>> = Mutex::new(BTreeMap::new());

/// Digest of the pixels that one process renders of the caustic ring.
///
/// # Panics
/// When it cannot be rendered.
pub fn right_pixels(settings: &RenderSettings) -> String {
    let mut rendered = RENDERED.lock().unwrap_or_else(PoisonError::into_inner);
    let render = || {
        let (bundle, settings) = (scene("caustic-ring.glb"), settings.clone());
        let render = move || embedded::render(&bundle, &settings, &embedded::Config::default(), |_| {});
        let result = std::thread::spawn(render).join().expect("did not panic").unwrap_or_else(|e| panic!("{e}"));
        film_pixels_sha256(&result.film)
    };
    rendered.entry(format!("{settings:?}")).or_insert_with(render).clone()
}

//! What an image needs, decided before any work: which passes, maps and fields, what is left out, and why.
//!
//! The plan is a pure function of scene and settings; the render follows it, and leaving something out changes no bit
//! of the image.

mod entries;
mod memory;

pub use crate::scene::description::{PlanEntry, Saving};

use crate::film::{LightImage, TileGrid};
use crate::integrator::progressive::{FirstRound, first_caustic_radius, first_global_radius};
use crate::integrator::vcm;
use crate::material::Material;
use crate::photon::aim::AimedEmission;
use crate::photon::map::PhotonMap;
use crate::photon::pack::decode_rgbe;
use crate::photon::trace::{Emission, Storage};
use crate::photon::{EmissionRange, MapKind, PhotonBatch};
use crate::scene::{Camera, Scene};
use crate::settings::{Layer, Method, RenderSettings};
use entries::{Entries, materials};

/// Photon paths traced to estimate how many photons a map will hold.
const PILOT_PATHS: u64 = 4096;
/// Photons that they should leave where a radius follows from them; where they leave fewer, there are [`LARGE_PILOT`] times as many paths.
const PILOT_PHOTONS: usize = 32;
const LARGE_PILOT: u64 = 8;

/// One emission pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EmissionPlan {
    /// Emitted paths.
    pub paths: u64,
    /// Paths of the pilot run.
    pub pilot: u64,
    /// Which hits are stored.
    pub storage: Storage,
    /// Expected number of stored photons, by a pilot run.
    pub expected_stored: u64,
    /// Gather radius of the first round, scene space; of methods with rounds only.
    pub first_radius: f32,
}

/// What will be done.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Everything decided, in the order of the passes.
    pub entries: Vec<PlanEntry>,
    /// The global map's emission; `None`: left out.
    pub global: Option<EmissionPlan>,
    /// The caustic map's emission; `None`: left out.
    pub caustic: Option<EmissionPlan>,
    /// Expected peak memory of a worker process, bytes.
    pub worker_bytes: u64,
    /// Expected peak memory of the coordinator process of a cluster, bytes.
    pub coordinator_bytes: u64,
    /// Expected peak memory of `render`, coordinator and workers in one process, bytes.
    pub single_process_bytes: u64,
    /// Expected bytes of maps that each worker receives.
    pub broadcast_bytes: u64,
}

impl Plan {
    /// Decides what `scene` needs for `settings`; `parts` says what of its file was read.
    pub fn new(
        scene: &Scene,
        camera: &Camera,
        settings: &RenderSettings,
        aim: Option<&AimedEmission>,
        parts: Vec<PlanEntry>,
    ) -> Self {
        let mut entries = Entries(parts);
        plan_scene(scene, &mut entries);
        let pixel = pixel_on_surfaces(scene, camera, settings);
        let vertices = plan_vertices(scene, camera, settings, pixel);
        if let Some(v) = &vertices {
            entries.add(
                "map of light vertices",
                true,
                describe(v, "where light paths meet surfaces that are not mirrors", settings),
            );
        }
        let global = plan_global(scene, settings);
        let caustic = plan_caustic(scene, settings, aim);
        let [global, caustic] = divided(global, caustic, settings).map(|p| p.map(|p| p.plan(pixel)));
        let global = report_map("global photon map", "light on diffuse surfaces", global, settings, &mut entries);
        let global = vertices.or(global);
        let what = "light focused by specular and glossy surfaces";
        let caustic = report_map("caustic photon map", what, caustic, settings, &mut entries);
        if caustic.is_some() || reads_photons(settings.method) {
            let focusing = materials(scene, "are specular or glossy", Material::has_specular_or_glossy);
            if let Some(entry) = entries.0.last_mut() {
                entry.evidence.push(focusing);
            }
        }
        if let (Some(_), Some(a)) = (&caustic, aim) {
            let n = a.targets().len();
            entries.add("aimed emission", true, format!("towards {n} bounding sphere{} of such surfaces", plural(n)));
        }
        let stored = |e: &Option<EmissionPlan>| memory::stored_at_once(e.as_ref(), settings);
        let photons = stored(&global) + stored(&caustic);
        if vertices.is_some() {
            entries.add("photon directions", true, "BSDFs and weights depend on where the light came from");
        } else if global.is_some() || caustic.is_some() {
            let bytes = photons * memory::DIRECTION_BYTES;
            let why = "diffuse lobes reflect the same whatever the direction";
            entries.add("photon directions", false, why).saves_bytes(bytes, bytes);
        } else {
            entries.add("merge and broadcast", false, "there is no map");
        }
        plan_gather(scene, settings, global.is_some(), &mut entries);
        let light_bytes = plan_light_image(settings, &mut entries);
        plan_layers(settings, &mut entries);
        let memory = memory::predict(scene, settings, stored(&global), stored(&caustic));
        Plan {
            entries: entries.0,
            global,
            caustic,
            // Workers add to one light image of their own, and the coordinator to the sum.
            worker_bytes: memory.worker + light_bytes,
            coordinator_bytes: memory.coordinator + light_bytes,
            single_process_bytes: memory.single_process + 2 * light_bytes,
            broadcast_bytes: memory.broadcast,
        }
    }
}

impl Plan {
    /// The least number of rounds with which the photons of one take at most `limit` bytes while their maps are merged and
    /// built, which is when they take most.
    pub fn rounds_within(&self, limit: u64) -> u64 {
        let stored = |e: &Option<EmissionPlan>| e.map_or(0, |e| e.expected_stored);
        let (global, caustic) = (stored(&self.global), stored(&self.caustic));
        let all = memory::photon_bytes(global, caustic);
        all.div_ceil(limit.max(1)).max(1)
    }
}

fn plural(n: usize) -> &'static str {
    if n == 1 { "" } else { "s" }
}

fn describe(e: &EmissionPlan, what: &str, settings: &RenderSettings) -> String {
    let up_to = if settings.is_open_ended() { "up to " } else { "" };
    format!("{what}: {up_to}{} paths emitted, about {} photons stored", e.paths, e.expected_stored)
}

/// Adds the entry of a map, or why there is none.
fn report_map(
    name: &str,
    what: &str,
    map: Result<EmissionPlan, LeftOut>,
    settings: &RenderSettings,
    entries: &mut Entries,
) -> Option<EmissionPlan> {
    match map {
        Ok(e) => {
            entries.add(name, true, describe(&e, what, settings)).because([format!(
                "{} photons of {} paths are expected, from the first {}",
                e.expected_stored, e.paths, e.pilot
            )]);
            Some(e)
        }
        Err(LeftOut { reason, paths }) => {
            let work = format!("{paths} photon paths");
            let work = if reads_photons(settings.method) && paths > 0 { work } else { String::new() };
            entries.add(name, false, reason).saves_work(work);
            None
        }
    }
}

/// Lights, and geometry that the camera does not see.
fn plan_scene(scene: &Scene, entries: &mut Entries) {
    let (area, all) = (scene.lights.area_count(), scene.lights.len());
    if all > 0 {
        let reason = format!("{area} emissive triangle{}, {} other", plural(area), all - area);
        entries.add("lights", true, reason).because([materials(scene, "emit light", Material::is_emissive)]);
    } else {
        entries.add("lights", false, "the scene has none");
    }
    // Rays leave surfaces by a rounding bound, which near a crease may be beyond the next wall; so not even a closed room
    // is proof that nothing outside is ever met. And the unit of lengths comes from the whole scene.
    let why = "what is out of view may block light or reflect it into view, and sets the scene's size";
    entries.add("geometry out of view", true, why);
}

/// Layers that nobody asked for.
fn plan_layers(settings: &RenderSettings, entries: &mut Entries) {
    let pixels = u64::from(settings.width) * u64::from(settings.height);
    for layer in Layer::ALL.iter().filter(|l| !settings.layers.contains(l)) {
        let bytes = 4 * layer.width() as u64 * pixels;
        entries.add(&format!("layer {}", layer.name()), false, "not asked for").saves_bytes(bytes, bytes);
    }
}

/// Why a map is not there, and the paths that are not emitted for it.
struct LeftOut {
    reason: String,
    paths: u64,
}

/// The light vertices of all rounds, where the method merges with them and there is light.
fn plan_vertices(scene: &Scene, camera: &Camera, settings: &RenderSettings, pixel: f32) -> Option<EmissionPlan> {
    if settings.method != Method::Vcm || scene.lights.is_empty() {
        return None;
    }
    let paths = settings.photons;
    let pilot = PILOT_PATHS.min(paths);
    // Where vertices are stored does not depend on the radius.
    let round = vcm::Round::new(scene, camera, settings, 1.0, 0);
    let (stored, chosen) = vcm::choose_first_radius(&round, EmissionRange { first: 0, end: pilot }, pixel);
    let expected_stored = (stored as u128 * u128::from(paths) / u128::from(pilot.max(1))) as u64;
    let first_radius = settings.max_radius.map_or(chosen, |r| scene.space.length(f64::from(r)));
    Some(EmissionPlan { paths, pilot, storage: Storage::All, expected_stored, first_radius })
}

fn plan_global<'a>(scene: &'a Scene, settings: &'a RenderSettings) -> Result<Pilot<'a>, LeftOut> {
    let paths = settings.photons;
    let out = |reason: String| LeftOut { reason, paths };
    common_reason(scene, settings).map_err(out)?;
    if paths == 0 {
        return Err(out("--photons is 0".into()));
    }
    let gathers = settings.method == Method::Photon && settings.final_gather > 0;
    let storage = if gathers || settings.direct_from_map { Storage::All } else { Storage::Indirect };
    let emission = Emission { scene, kind: MapKind::Global, storage, seed: settings.seed, round: 0, aim: None };
    Ok(Pilot::trace(emission, settings, paths))
}

fn plan_caustic<'a>(
    scene: &'a Scene,
    settings: &'a RenderSettings,
    aim: Option<&'a AimedEmission>,
) -> Result<Pilot<'a>, LeftOut> {
    let paths = settings.caustic_photons;
    let out = |reason: &str| LeftOut { reason: reason.into(), paths };
    common_reason(scene, settings).map_err(|reason| LeftOut { reason, paths })?;
    if !scene.has_specular_or_glossy() && !settings.keep_all {
        return Err(out("no surface is specular or glossy"));
    }
    if settings.direct_from_map {
        return Err(out("--direct-from-map: the global map holds focused light, too"));
    }
    if paths == 0 {
        return Err(out("--caustic-photons is 0"));
    }
    if aim.is_none() && !settings.keep_all {
        return Err(out("no light reaches a specular or glossy surface"));
    }
    let (kind, storage) = (MapKind::Caustic, Storage::Caustic);
    let emission = Emission { scene, kind, storage, seed: settings.seed, round: 0, aim };
    Ok(Pilot::trace(emission, settings, paths))
}

/// Whether `method` gathers from photon maps.
pub fn reads_photons(method: Method) -> bool {
    matches!(method, Method::Photon | Method::Progressive)
}

/// Rays across and down that look for the surfaces that are seen.
const PROBES: u32 = 16;

/// Width of a pixel on the surfaces that the camera sees, scene space: the median over a grid of rays; 0 where nothing is seen.
fn pixel_on_surfaces(scene: &Scene, camera: &Camera, settings: &RenderSettings) -> f32 {
    let place = |i: u32, size: u32| (i as f32 + 0.5) / PROBES as f32 * size as f32;
    let mut widths: Vec<f32> = (0..PROBES * PROBES)
        .filter_map(|i| {
            let ray = camera.ray(place(i % PROBES, settings.width), place(i / PROBES, settings.height));
            scene.intersect(&ray).map(|p| camera.pixel_footprint(camera.depth(p.position)))
        })
        .collect();
    widths.sort_unstable_by(f32::total_cmp);
    widths.get(widths.len() / 2).copied().unwrap_or(0.0)
}

fn common_reason(scene: &Scene, settings: &RenderSettings) -> Result<(), String> {
    if !reads_photons(settings.method) {
        return Err(format!("method {} reads no photons", settings.method.name()));
    }
    // Paths that no light starts, or no surface stores, leave an empty map.
    if settings.keep_all {
        return Ok(());
    }
    if scene.lights.is_empty() {
        return Err("there is no light".into());
    }
    if !scene.has_diffuse() {
        return Err("no surface is diffuse, so nothing would store or read photons".into());
    }
    Ok(())
}

/// A map that is wanted, and what the first paths of its emission leave: as many whatever the number of its paths, so that it does not
/// matter whether that was given or divided.
struct Pilot<'a> {
    settings: &'a RenderSettings,
    emission: Emission<'a>,
    /// Paths that the map is to have.
    paths: u64,
    photons: PhotonBatch,
}

impl<'a> Pilot<'a> {
    fn trace(emission: Emission<'a>, settings: &'a RenderSettings, paths: u64) -> Self {
        let first = |paths| emission.trace(EmissionRange { first: 0, end: paths });
        let mut photons = first(PILOT_PATHS);
        if finds_radius(settings) && photons.len() < PILOT_PHOTONS {
            photons = first(LARGE_PILOT * PILOT_PATHS);
        }
        Pilot { settings, emission, paths, photons }
    }
    /// Power that falls on its surfaces, weighted as it is seen.
    fn light(&self) -> f64 {
        let power = |&code| f64::from(decode_rgbe(code).luminance());
        self.photons.powers.iter().map(power).sum::<f64>() / self.photons.range.len() as f64
    }
    /// The map as it will be made, for `pixel`s of that width on the surfaces that are seen.
    fn plan(self, pixel: f32) -> EmissionPlan {
        let Pilot { settings, emission, paths, photons } = self;
        let (range, stored) = (photons.range, photons.len() as u64);
        let expected_stored = (u128::from(stored) * u128::from(paths) / u128::from(range.len())) as u64;
        let first_radius = if finds_radius(settings) {
            let round = FirstRound { paths: settings.share_of_round(paths, 0), pixel, kernel: settings.kernel };
            let map = PhotonMap::build(emission.kind, photons);
            match emission.kind {
                MapKind::Caustic => first_caustic_radius(&map, round),
                MapKind::Global => {
                    let all = Emission { storage: Storage::All, ..emission }.trace(range);
                    first_global_radius(&map, &PhotonMap::build(MapKind::Global, all), round)
                }
            }
        } else {
            settings.max_radius.map_or(0.0, |r| emission.scene.space.length(f64::from(r)))
        };
        EmissionPlan { paths, pilot: range.len(), storage: emission.storage, expected_stored, first_radius }
    }
}

/// Whether the first round's radius follows from a pilot.
fn finds_radius(settings: &RenderSettings) -> bool {
    settings.method == Method::Progressive && settings.max_radius.is_none()
}

/// Least share of the paths that a map gets, of two.
const LEAST_SHARE: f64 = 0.25;

/// Both maps with the paths that they have together divided between them, where the settings ask for that: as the roots of the light that
/// they hold, which makes the noise of both together least if that of a single photon goes with its power alone. A map in which the pilot
/// finds no light takes nothing from the other, as one that is left out.
fn divided<'a>(
    global: Result<Pilot<'a>, LeftOut>,
    caustic: Result<Pilot<'a>, LeftOut>,
    settings: &RenderSettings,
) -> [Result<Pilot<'a>, LeftOut>; 2] {
    match (global, caustic) {
        (Ok(global), Ok(caustic)) if settings.divide_photons => {
            let [a, b] = [&global, &caustic].map(|p| p.light().sqrt());
            if a * b <= 0.0 {
                return [Ok(global), Ok(caustic)];
            }
            let share = (a / (a + b)).clamp(LEAST_SHARE, 1.0 - LEAST_SHARE);
            // Of a round, so that all rounds are alike.
            let of_round = settings.share_of_round(global.paths, 0) + settings.share_of_round(caustic.paths, 0);
            // Each has one at least: without photons its light would be missing.
            let part = ((of_round as f64 * share) as u64).clamp(1, of_round - 1);
            let [first, second] = [part, of_round - part].map(|paths| paths * u64::from(settings.rounds));
            [Ok(Pilot { paths: first, ..global }), Ok(Pilot { paths: second, ..caustic })]
        }
        (global, caustic) => [global, caustic],
    }
}

/// Bytes of a whole light image, where the method has one.
fn plan_light_image(settings: &RenderSettings, entries: &mut Entries) -> u64 {
    let planes = settings.light_planes();
    if planes == 0 {
        entries.add("light image", false, format!("method {} splats nothing", settings.method.name()));
        return 0;
    }
    let grid = TileGrid { width: settings.width, height: settings.height };
    let bytes = u64::from(grid.len() * planes) * LightImage::block_bytes();
    let why = match settings.method {
        _ if settings.has_independent_rounds() => "whole rounds travel as images",
        Method::Mlt => "Markov chains land on any pixel",
        _ => "light paths that meet the lens land on any pixel",
    };
    entries.add("light image", true, format!("{why}: {} MiB, summed exactly", bytes.div_ceil(1 << 20)));
    bytes
}

fn plan_gather(scene: &Scene, settings: &RenderSettings, has_global: bool, entries: &mut Entries) {
    let (w, h, method) = (settings.width, settings.height, settings.method.name());
    let up_to = if settings.is_open_ended() { "up to " } else { "" };
    let (what, effort) = match settings.method {
        Method::Mlt => {
            ("Markov chains", format!("{up_to}{} chains, {} mutations a pixel", settings.chains, settings.mutations))
        }
        m if m.has_rounds() => ("gather pass", format!("{up_to}{} rounds, one sample each", settings.rounds)),
        _ if settings.adaptive => (
            "gather pass",
            format!("{up_to}{} samples each on average, more where the first show more error", settings.samples),
        ),
        _ => ("gather pass", format!("{up_to}{} samples each", settings.samples)),
    };
    entries.add(what, true, format!("{w} × {h} pixels, {effort}, method {method}"));
    if settings.method == Method::Whitted {
        let why = "method whitted follows light from lamps to one diffuse surface, mirrors and glass to the camera";
        entries.add("indirect light", false, why);
        entries.add("caustics", false, why);
    }
    if settings.method == Method::Photon {
        let kept = has_global && settings.final_gather > 0;
        let reason = match (has_global, settings.final_gather) {
            (false, _) => "there is no global map".to_string(),
            (true, 0) if settings.direct_from_map => "--direct-from-map: the global map shows all light".to_string(),
            (true, 0) => "--final-gather is 0: the global map is looked at directly".to_string(),
            (true, n) => format!("{n} rays for each diffuse camera vertex"),
        };
        entries.add("final gather", kept, reason);
        let why = if kept { "computed at some photons, where looked at" } else { "there is no final gather" };
        entries.add("precomputed irradiance", kept, why);
    }
    let masks = scene.has_alpha_masks;
    let why = match masks {
        true if settings.keep_all => "--keep-all",
        true => "some materials have holes",
        false => "no material has holes",
    };
    let evidence = materials(scene, "have holes", Material::has_alpha_mask);
    entries.add("alpha mask tests", masks, why).saves_work("a test at every hit").because([evidence]);
    let why = match scene.is_bare {
        true => "every surface is a bare Lambertian one of one colour",
        false if settings.keep_all => "--keep-all",
        false => "some surfaces have them",
    };
    let evidence = materials(scene, "are more than Lambertian, or textured", |m| !m.is_plain());
    let layers = entries.add("code for glass, layers, textures and normal maps", !scene.is_bare, why);
    layers.saves_work("a fourteenth of a path's instructions").because([evidence]);
    let absorbs = |m: &Material| m.absorption().is_some();
    let bodies = scene.materials.iter().any(absorbs);
    let why = if bodies { "some bodies absorb light" } else { "no body absorbs light" };
    let evidence = materials(scene, "absorb light", absorbs);
    entries.add("attenuation in bodies", bodies, why).saves_work("three exponentials an edge").because([evidence]);
}

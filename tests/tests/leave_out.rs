//! Leaving out what a scene does not need changes no bit of the image: with and without, here and on a cluster, whole and cut.

use gatherlight_render::import::SceneBundle;
use gatherlight_render::job::{self, PreparedJob};
use gatherlight_render::settings::{Layer, Method, RenderSettings};
use gatherlight_tests::cluster::{Coordinator, finished_exr, request, small_leases};
use gatherlight_tests::scenes::spare;
use gatherlight_tests::{film_pixels_sha256, film_sha256, pixel_sha256, single};
use gatherlight_worker::Faults;
use proptest::prelude::*;
use std::sync::Mutex;

/// Texels along each side of the images of the scenes.
const TEXELS: u32 = 24;

/// A few pixels of everything.
fn tiny(method: Method) -> RenderSettings {
    RenderSettings {
        width: 12,
        height: 10,
        samples: 2,
        photons: 1_000,
        caustic_photons: 1_000,
        k: 8,
        rounds: 2,
        chains: 4,
        mutations: 4,
        bootstrap: 200,
        ..RenderSettings::for_method(method)
    }
}

fn prepare(bundle: &SceneBundle, settings: &RenderSettings) -> PreparedJob {
    PreparedJob::prepare(bundle, settings).unwrap_or_else(|e| panic!("{}: {e}", bundle.name))
}

fn bytes(bundle: &SceneBundle) -> usize {
    bundle.root.len() + bundle.externals.iter().map(|(_, b)| b.len()).sum::<usize>()
}

/// Renders with everything, with what is needed, and from what a cluster gets of the file; the last two bundles' sizes.
fn assert_same_bits(bundle: &SceneBundle, settings: &RenderSettings) -> (usize, usize) {
    let all = prepare(bundle, &RenderSettings { keep_all: true, ..settings.clone() });
    let needed = prepare(bundle, settings);
    let cut = job::cut(bundle, settings).unwrap_or_else(|e| panic!("{e}"));
    let sent = prepare(&cut, settings);
    let name = format!("{} by {}", bundle.name, settings.method.name());
    let expected = film_sha256(&single::render(&all));
    assert_eq!(film_sha256(&single::render(&needed)), expected, "{name}");
    assert_eq!(film_sha256(&single::render(&sent)), expected, "{name}, cut");
    assert_eq!(sent.scene_digest(), needed.scene_digest(), "{name}: the digest is that of the whole");
    let said = |job: &PreparedJob| {
        job.plan().entries.iter().map(|e| (e.what.clone(), e.kept, e.reason.clone())).collect::<Vec<_>>()
    };
    assert_eq!(said(&sent), said(&needed), "{name}: the header says the same");
    assert!(all.scene().memory_bytes() >= needed.scene().memory_bytes(), "{name}");
    (bytes(bundle), bytes(&cut))
}

#[test]
fn scenes_have_the_same_bits_with_and_without() {
    for scene in spare::scenes(TEXELS) {
        for method in Method::ALL {
            let (whole, cut) = assert_same_bits(&scene.bundle, &tiny(method));
            let less = (cut as f64) < 0.95 * whole as f64;
            assert_eq!(less, scene.is_cut, "{}: {cut} of {whole} bytes are sent", scene.name);
        }
    }
}

/// What each scene is there for is what its plan leaves out, with a number.
#[test]
fn the_plan_says_what_is_left_out_and_what_that_saves() {
    let expected = [
        ("diffuse only", Method::Photon, "other vertex attributes"),
        ("diffuse only", Method::Photon, "caustic photon map"),
        ("mirrors only", Method::Photon, "global photon map"),
        ("mirrors only", Method::Photon, "other textures"),
        ("no light", Method::Photon, "global photon map"),
        ("no light", Method::Path, "other textures"),
        ("one of a hundred", Method::Path, "other textures"),
        ("one of a hundred", Method::Path, "other meshes"),
        ("unlit", Method::Path, "other textures"),
        ("unlit", Method::Photon, "global photon map"),
        ("cameras and animations", Method::Path, "animations"),
    ];
    let scenes = spare::scenes(TEXELS);
    for (name, method, what) in expected {
        let scene = scenes.iter().find(|s| s.name == name).unwrap_or_else(|| panic!("no scene {name}"));
        let job = prepare(&scene.bundle, &tiny(method));
        let entry = job.plan().entries.iter().find(|e| e.what == what).unwrap_or_else(|| panic!("{name}: no {what}"));
        let saves = &entry.saves;
        assert!(!entry.kept && !entry.reason.is_empty(), "{entry:?}");
        assert!(!entry.evidence.is_empty() || !saves.work.is_empty(), "{entry:?}");
        assert!(saves.wire_bytes > 0 || saves.memory_bytes > 0 || saves.work.contains("1000"), "{name}: {entry:?}");
    }
    // What is compiled for bare surfaces alone is asked of no others.
    for (name, is_bare) in [
        ("diffuse only", true),
        // Its textures are left out.
        ("no light", true),
        ("mirrors only", false),
        ("one of a hundred", false),
        ("one small caustic", false),
    ] {
        let scene = scenes.iter().find(|s| s.name == name).expect("the scene");
        assert_eq!(prepare(&scene.bundle, &tiny(Method::Path)).scene().is_bare, is_bare, "{name}");
        let all = RenderSettings { keep_all: true, ..tiny(Method::Path) };
        assert!(!prepare(&scene.bundle, &all).scene().is_bare, "{name}");
    }
    // Ninety-nine pictures of 24 × 24 texels.
    let hundred = scenes.iter().find(|s| s.name == "one of a hundred").expect("the scene");
    let job = prepare(&hundred.bundle, &tiny(Method::Path));
    let textures = job.plan().entries.iter().find(|e| e.what == "other textures").expect("an entry");
    assert_eq!(textures.saves.memory_bytes, 99 * 4 * u64::from(TEXELS * TEXELS));
    assert_eq!(textures.evidence.len(), 99);
    assert!(textures.evidence[0].contains("material \"panel 1\"") && textures.evidence[0].contains("nothing placed"));
}

/// Albedo and normals are seen without light.
#[test]
fn a_dark_scene_keeps_its_textures_for_layers_that_show_them() {
    let dark = spare::scenes(TEXELS).into_iter().find(|s| s.name == "no light").expect("the scene").bundle;
    let plain = prepare(&dark, &tiny(Method::Path));
    assert_eq!(plain.scene().textures.memory_bytes(), 0);
    let settings = RenderSettings { layers: vec![Layer::Albedo, Layer::Normal], ..tiny(Method::Path) };
    assert_same_bits(&dark, &settings);
    let film = single::render(&prepare(&dark, &settings));
    let albedo = film.pixels.iter().skip(4).step_by(film.channels.len());
    let distinct: std::collections::BTreeSet<u32> = albedo.map(|v| v.to_bits()).collect();
    assert!(distinct.len() > 10, "the texture is seen: {distinct:?}");
}

/// A cluster is sent less, renders the same and names the same scene.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_cluster_gets_what_it_needs() {
    let hundred = spare::scenes(TEXELS).into_iter().find(|s| s.name == "one of a hundred").expect("the scene").bundle;
    let store = tempfile::tempdir().expect("a directory");
    let coordinator = Coordinator::start(store.path(), small_leases()).await;
    let _worker = coordinator.worker("one", Faults::default());
    let client = coordinator.client().await;
    let mut images = Vec::new();
    for keep_all in [false, true] {
        let settings = RenderSettings { keep_all, ..tiny(Method::Photon) };
        let sent = Mutex::new(0);
        let upload = |_, total| *sent.lock().expect("the lock") = total;
        let id = client.submit(&request(&hundred, &settings), upload).await.unwrap_or_else(|e| panic!("{e}"));
        let exr = finished_exr(&client, id).await;
        let header = gatherlight_render::export::decode(&exr).unwrap_or_else(|e| panic!("{e}"));
        let digest = header.attributes.get("gatherlight:scene_digest").cloned();
        images.push((pixel_sha256(&exr), digest, sent.into_inner().expect("the lock")));
    }
    let [(pixels, digest, few), (all_pixels, all_digest, many)] = &images[..] else { panic!("two images") };
    assert_eq!((pixels, digest), (all_pixels, all_digest));
    assert!(digest.is_some() && *many as usize == hundred.root.len() && few * 3 < *many, "{few} of {many} bytes");
    let here = prepare(&hundred, &tiny(Method::Photon));
    let film = tokio::task::spawn_blocking(move || single::render(&here)).await.expect("did not panic");
    assert_eq!(*pixels, film_pixels_sha256(&film));
}

/// External files of which nothing is read are not asked for, and parts of others are not sent.
#[test]
fn external_files_are_cut_and_left_out() {
    let hundred = spare::scenes(TEXELS).into_iter().find(|s| s.name == "one of a hundred").expect("the scene").bundle;
    let external = spare::with_external_files(&hundred);
    let needed =
        gatherlight_render::import::external_uris(&external.name, &external.root).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(needed, ["geometry.bin", "picture0.png"]);
    let mut given = external.clone();
    given.externals.retain(|(uri, _)| needed.contains(uri));
    let settings = tiny(Method::Path);
    // All files are there for --keep-all; the digest is that of those which an image may need.
    assert_eq!(prepare(&external, &settings).scene_digest(), prepare(&given, &settings).scene_digest());
    let (whole, cut) = assert_same_bits(&external, &settings);
    assert!(cut * 4 < whole, "{cut} of {whole} bytes");
    let cut = job::cut(&given, &settings).unwrap_or_else(|e| panic!("{e}"));
    let files: Vec<(&str, usize)> = cut.externals.iter().map(|(uri, b)| (uri.as_str(), b.len())).collect();
    let before: Vec<usize> = given.externals.iter().map(|(_, b)| b.len()).collect();
    assert!(
        files[0].0 == "geometry.bin" && files[0].1 < before[0] && files[1] == ("picture0.png", before[1]),
        "{files:?}"
    );
}

/// A table that names other pieces than are there is an error, not another image.
#[test]
fn a_cut_scene_that_lacks_bytes_is_refused() {
    let hundred = spare::scenes(TEXELS).into_iter().find(|s| s.name == "one of a hundred").expect("the scene").bundle;
    let cut = job::cut(&hundred, &tiny(Method::Path)).unwrap_or_else(|e| panic!("{e}"));
    let all = RenderSettings { keep_all: true, ..tiny(Method::Path) };
    let error = PreparedJob::prepare(&cut, &all).err().expect("an error").to_string();
    assert!(error.contains("were cut out, but are needed"), "{error}");
    let mut refused = 0;
    for at in (0..cut.root.len()).step_by(29) {
        let mut root = cut.root.to_vec();
        root[at] ^= 0x40;
        let damaged = SceneBundle { root: root.into(), ..cut.clone() };
        // Never a panic; what the JSON or the arrays hold may make another valid scene.
        refused += usize::from(gatherlight_render::import::load(&damaged).is_err());
    }
    assert!(refused > 100, "{refused}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 420, ..ProptestConfig::default() })]

    /// Nothing that is visible or carries light is left out, by any method.
    #[test]
    fn random_scenes_have_the_same_bits(seed in any::<u64>(), method in 0..Method::ALL.len()) {
        let settings = RenderSettings { width: 8, height: 8, ..tiny(Method::ALL[method]) };
        assert_same_bits(&spare::random(seed), &settings);
    }
}

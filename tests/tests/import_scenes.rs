//! The scenes under `scenes/`: written by their generator, readable without a warning, and read as the `gltf` crate
//! (which shares no code with the importer) reads them.

use gatherlight_render::import::{SceneBundle, external_uris, load, relative_path};
use gatherlight_render::scene::description::SceneDescription;
use glam::{DAffine3, DMat4, Vec3};
use std::path::{Path, PathBuf};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes")
}

fn read(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Every scene file, sorted.
fn scene_files() -> Vec<PathBuf> {
    let is_scene = |path: &PathBuf| path.extension().is_some_and(|e| e == "glb" || e == "gltf");
    let list = |folder: &Path| std::fs::read_dir(folder).expect("a folder").map(|e| e.expect("an entry").path());
    let mut files: Vec<PathBuf> = list(&folder()).chain(list(&folder().join("gltf"))).filter(is_scene).collect();
    files.sort();
    files
}

/// Loads a scene with its external files, as a client packs them.
fn bundle(path: &Path) -> SceneBundle {
    let name = path.file_name().expect("a name").to_string_lossy().into_owned();
    let root = read(path);
    let uris = external_uris(&name, &root).unwrap_or_else(|e| panic!("{e}"));
    let beside = |uri: &String| path.with_file_name(relative_path(uri).expect("a path"));
    let externals = uris.iter().map(|uri| (uri.clone(), read(&beside(uri)).into())).collect();
    SceneBundle { name, root: root.into(), externals }
}

fn scene(path: &Path) -> SceneDescription {
    load(&bundle(path)).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn committed_scenes_are_what_their_generator_writes() {
    for (name, bytes) in gatherlight_tests::scenes::generated() {
        let path = folder().join(name);
        let same = read(&path) == bytes;
        assert!(same, "{name} differs: cargo run -p gatherlight-tests --example make_scenes -- scenes");
    }
}

#[test]
fn every_scene_loads_without_a_warning_and_can_be_seen() {
    let files = scene_files();
    assert_eq!(files.len(), 14, "{files:?}");
    let mut total = 0;
    for path in files {
        let scene = scene(&path);
        let name = path.display();
        assert_eq!(scene.warnings, Vec::<String>::new(), "{name}");
        assert!(!scene.cameras.is_empty(), "{name} has no camera");
        let glows = scene.meshes.iter().any(|m| !scene.materials[m.material as usize].emission.is_black());
        assert!(glows || !scene.lights.is_empty(), "{name} is dark");
        total += read(&path).len();
    }
    assert!(total < 6 << 20, "the scenes take {total} bytes");
}

#[test]
fn the_generated_scenes_have_what_they_are_for() {
    let load = |name: &str| scene(&folder().join(name));
    let instances = load("instances.glb");
    let mirrored = instances.instances.iter().filter(|i| i.to_world.matrix3.determinant() < 0.0).count();
    // A tower is 12 levels of 8 nodes with 2 primitives; there is one mirrored and one not, a floor and a lamp.
    assert_eq!((instances.instances.len(), mirrored, instances.meshes.len()), (2 * 12 * 8 * 2 + 2, 12 * 8 * 2, 4));
    let textured = load("textured.glb");
    assert_eq!((textured.textures.len(), textured.images.len()), (8, 5));
    assert!(textured.materials.iter().any(|m| m.normal_texture.is_some()));
    assert!(textured.materials.iter().any(|m| m.metallic_roughness_texture.is_some()));
    assert!(textured.materials.iter().any(|m| m.emissive_texture.is_some()));
    assert!(textured.materials.iter().any(|m| m.alpha_cutoff.is_some() && m.double_sided));
    assert!(textured.meshes.iter().any(|m| m.colors.is_some()) && textured.meshes.iter().any(|m| m.tangents.is_some()));
    assert_eq!(load("lights.glb").lights.len(), 3);
    let names: Vec<String> = load("orthographic.glb").cameras.into_iter().map(|c| c.name).collect();
    assert_eq!(names, ["isometric", "perspective"]);
    let glass = load("lamp-through-glass.glb");
    assert!(glass.materials.iter().any(|m| m.volume && m.transmission == 1.0 && m.ior == 1.5));
    let boxed = load("gltf/box.gltf");
    assert_eq!((boxed.images[0].width, boxed.images[0].height), (64, 64));
}

/// Triangles in world space, in order, with their shading normals, as the `gltf` crate reads them.
fn by_the_crate(path: &Path) -> Vec<[Vec3; 6]> {
    let gltf::Gltf { document, blob } = gltf::Gltf::from_slice_without_validation(&read(path)).expect("glTF");
    let bytes = |buffer: gltf::Buffer| match buffer.source() {
        gltf::buffer::Source::Bin => blob.clone().expect("a binary chunk"),
        gltf::buffer::Source::Uri(uri) => read(&path.with_file_name(uri)),
    };
    let buffers: Vec<Vec<u8>> = document.buffers().map(bytes).collect();
    let mut out = Vec::new();
    let scene = document.default_scene().expect("a scene");
    let mut stack: Vec<(gltf::Node, DMat4)> = scene.nodes().map(|n| (n, DMat4::IDENTITY)).collect();
    stack.reverse();
    while let Some((node, parent)) = stack.pop() {
        let to_world = parent * glam::Mat4::from_cols_array_2d(&node.transform().matrix()).as_dmat4();
        for primitive in node.mesh().into_iter().flat_map(|m| m.primitives().collect::<Vec<_>>()) {
            let reader = primitive.reader(|b| buffers.get(b.index()).map(Vec::as_slice));
            let positions: Vec<[f32; 3]> = reader.read_positions().expect("positions").collect();
            let normals: Option<Vec<[f32; 3]>> = reader.read_normals().map(Iterator::collect);
            let corners: Vec<u32> = reader.read_indices().expect("indices").into_u32().collect();
            for triangle in corners.chunks(3) {
                let at = |c: usize| {
                    to_world.transform_point3(Vec3::from(positions[triangle[c] as usize]).as_dvec3()).as_vec3()
                };
                let normal = |c: usize| normals.as_ref().map_or(Vec3::ZERO, |n| n[triangle[c] as usize].into());
                out.push([at(0), at(1), at(2), normal(0), normal(1), normal(2)]);
            }
        }
        let children: Vec<_> = node.children().map(|c| (c, to_world)).collect();
        stack.extend(children.into_iter().rev());
    }
    out
}

#[test]
fn the_gltf_crate_reads_the_same_triangles() {
    for path in scene_files() {
        let scene = scene(&path);
        let mut ours = Vec::new();
        for instance in &scene.instances {
            let mesh = &scene.meshes[instance.mesh];
            let to_world: DAffine3 = instance.to_world;
            for triangle in &mesh.triangles {
                let at =
                    |c: usize| to_world.transform_point3(mesh.positions[triangle[c] as usize].as_dvec3()).as_vec3();
                let normal = |c: usize| mesh.normals.as_ref().map_or(Vec3::ZERO, |n| n[triangle[c] as usize]);
                ours.push([at(0), at(1), at(2), normal(0), normal(1), normal(2)]);
            }
        }
        let theirs = by_the_crate(&path);
        assert_eq!(ours.len(), theirs.len(), "{}", path.display());
        // The crate rounds node matrices to single precision (24 levels deep at most: 24 · 2⁻²⁴ of the coordinates,
        // which stay below 8), and leaves normals as they are in the file, of unit length but for rounding.
        let tolerance = 24.0 * 8.0 * f32::EPSILON;
        for (a, b) in ours.iter().zip(&theirs) {
            let far = a.iter().zip(b).map(|(p, q)| (*p - *q).abs().max_element()).fold(0.0, f32::max);
            assert!(far <= tolerance, "{}: {a:?} and {b:?}", path.display());
        }
    }
}

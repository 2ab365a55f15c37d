use crate::import::{SceneBundle, load};
use crate::scene::description::{Projection, SceneDescription};
use std::path::Path;

fn scene(name: &str) -> SceneDescription {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes").join(name);
    let root = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    load(&SceneBundle { name: name.into(), root: root.into(), externals: Vec::new() }).unwrap_or_else(|e| panic!("{e}"))
}

fn triangles(scene: &SceneDescription) -> usize {
    scene.instances.iter().map(|i| scene.meshes[i.mesh].triangles.len()).sum()
}

#[test]
fn the_caustic_box_has_its_two_spheres_and_its_camera() {
    let scene = scene("cornell-caustic.glb");
    assert_eq!(scene.warnings, Vec::<String>::new());
    assert_eq!(scene.instances.len(), 8);
    assert_eq!(triangles(&scene), 6 * 2 + 2 * 81_920);
    let glass = scene.materials.iter().find(|m| m.transmission > 0.0).expect("a glass");
    assert!(glass.volume && glass.roughness == 0.0 && glass.ior == 1.5, "{glass:?}");
    assert!(scene.materials.iter().any(|m| m.emission.r > 0.0));
    let [camera] = &scene.cameras[..] else { panic!("{} cameras", scene.cameras.len()) };
    assert_eq!(camera.name, "camera");
    assert_eq!(camera.to_world.translation.to_array(), [0.0, 0.5, 2.05]);
    assert!(matches!(camera.projection, Projection::Perspective { .. }));
}

#[test]
fn the_other_two_references_load_without_a_warning() {
    let diffuse = scene("cornell-diffuse.glb");
    assert_eq!((diffuse.warnings.len(), diffuse.instances.len(), triangles(&diffuse)), (0, 16, 32));
    let ring = scene("caustic-ring.glb");
    assert_eq!((ring.warnings.len(), ring.instances.len(), triangles(&ring)), (0, 3, 4096 + 4));
}

//! glTF 2.0 bytes → [`SceneDescription`].
//!
//! The order of work: container ([`glb`]), JSON with places ([`json`], [`document`]), extensions, node placements,
//! which materials and textures these need, buffers, accessors, meshes, images, cameras, lights. What no placed mesh
//! uses is checked for its structure but neither decoded nor passed on.

mod accessor;
mod buffer;
mod camera;
mod document;
mod extensions;
mod flatten;
mod glb;
mod image;
mod json;
mod light;
pub mod limits;
mod material;
mod mesh;
mod nodes;
mod shading;
mod tangents;
mod texture;
mod topology;
mod uri;
mod vertices;

pub use extensions::SUPPORTED as SUPPORTED_EXTENSIONS;
pub use uri::relative_path;

use crate::scene::description::{InstanceDescription, SceneDescription};
use document::{Document, Warnings};
use json::{Item, Result};
use material::Materials;
use mesh::{Budget, MeshReader};
use nodes::Placement;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;

/// A scene file with every external file it names, as bytes: what a client packs and a cluster passes on.
#[derive(Clone, Debug, Default)]
pub struct SceneBundle {
    /// The .glb or .gltf file's name (without directory).
    pub name: String,
    /// The file itself.
    pub root: Arc<[u8]>,
    /// External buffers and images by the URI the file uses, in file order.
    pub externals: Vec<(String, Arc<[u8]>)>,
}

/// URIs of the external files that a render of the .glb or .gltf needs: buffers, then images of used materials, in
/// file order without duplicates (data URIs left out). [`relative_path`] tells the path that a URI names.
///
/// # Errors
/// When the file is not glTF 2.0, or its structure is damaged.
pub fn external_uris(name: &str, root: &[u8]) -> Result<Vec<String>> {
    let container = glb::split(name, root)?;
    let json = json::parse(name, container.json)?;
    let doc = Document::new(name, &json)?;
    let warnings = &mut Warnings::default();
    let structure = Structure::read(&doc, warnings)?;
    let mut uris: Vec<String> = Vec::new();
    let buffers = (0..doc.count("buffers")).map(|i| ("buffers", i));
    let mut images = structure.materials.textures.images;
    images.sort_unstable();
    for (section, index) in buffers.chain(images.into_iter().map(|i| ("images", i))) {
        let uri = doc.item(section, index)?.opt("uri", Item::text)?;
        if let Some(uri) = uri.filter(|u| !uri::is_data(u) && !uris.iter().any(|known| known == u)) {
            uris.push(uri.to_owned());
        }
    }
    Ok(uris)
}

/// Reads a scene.
///
/// # Errors
/// Names the place in the file and what is wrong with it. Never panics, whatever the bytes.
pub fn load(bundle: &SceneBundle) -> Result<SceneDescription> {
    let container = glb::split(&bundle.name, &bundle.root)?;
    let json = json::parse(&bundle.name, container.json)?;
    let doc = Document::new(&bundle.name, &json)?;
    let mut warnings = Warnings::default();
    if container.trailing > 0 {
        warnings.add(format!("{} bytes after the end of the .glb are ignored", container.trailing));
    }
    let Structure { placements, meshes, materials } = Structure::read(&doc, &mut warnings)?;
    let views = buffer::check_views(&doc)?;
    let layouts = accessor::Layout::check_all(&doc, &views)?;
    let buffers = buffer::Buffers::resolve(&doc, container.binary, &bundle.externals)?;
    let bytes = bundle.externals.iter().fold(bundle.root.len() as u64, |sum, (_, b)| sum + b.len() as u64);

    let mut scene = SceneDescription::default();
    let mut reader = MeshReader {
        doc: &doc,
        layouts: &layouts,
        buffers: &buffers,
        materials: &materials,
        budget: Budget::new(bytes),
        warnings: &mut warnings,
    };
    let mut ranges = BTreeMap::new();
    for mesh in meshes {
        let first = scene.meshes.len();
        scene.meshes.extend(reader.read(mesh)?);
        ranges.insert(mesh, first..scene.meshes.len());
    }
    place_meshes(&doc, &placements, &ranges, &mut scene, &mut warnings)?;
    scene.images =
        image::read_all(&doc, &materials.textures.images, &views, &buffers, &bundle.externals, &mut warnings)?;
    scene.textures = materials.textures.list;
    scene.materials = materials.list;
    scene.cameras = camera::read_all(&doc, &placements, &mut warnings)?;
    scene.lights = light::read_all(&doc, &placements, &mut warnings)?;
    scene.warnings = warnings.finish();
    Ok(scene)
}

/// One instance for each placement of each primitive.
fn place_meshes(
    doc: &Document,
    placements: &[Placement],
    ranges: &BTreeMap<usize, Range<usize>>,
    scene: &mut SceneDescription,
    warnings: &mut Warnings,
) -> Result<()> {
    for &Placement { node, to_world } in placements {
        let Some(mesh) = doc.reference(&doc.item("nodes", node)?, "mesh", "meshes")? else { continue };
        let name = doc.name("nodes", node).to_owned();
        let flat = flatten::is_flat(&to_world);
        if flat {
            let label = doc.label("node", "nodes", node);
            warnings.add(format!(
                "{label} is squashed flat by a scale of zero; its mesh is shown as a sheet with flat normals"
            ));
        }
        for mesh in ranges.get(&mesh).cloned().into_iter().flatten() {
            let (mesh, to_world) =
                match scene.meshes.get(mesh).filter(|_| flat).map(|m| flatten::flattened(m, &to_world)) {
                    None => (mesh, to_world),
                    Some(None) => continue,
                    Some(Some((sheet, translation))) => {
                        scene.meshes.push(sheet);
                        (scene.meshes.len() - 1, translation)
                    }
                };
            scene.instances.push(InstanceDescription { mesh, to_world, name: name.clone() });
        }
    }
    Ok(())
}

/// What can be known without the buffers.
struct Structure {
    placements: Vec<Placement>,
    meshes: BTreeSet<usize>,
    materials: Materials,
}

impl Structure {
    fn read(doc: &Document, warnings: &mut Warnings) -> Result<Self> {
        extensions::check(doc, warnings)?;
        let placements = nodes::place(doc, warnings)?;
        let mut meshes = BTreeSet::new();
        for placement in &placements {
            let node = doc.item("nodes", placement.node)?;
            let Some(mesh) = doc.reference(&node, "mesh", "meshes")? else { continue };
            meshes.insert(mesh);
            if node.get("skin")?.is_some() {
                let label = doc.label("node", "nodes", placement.node);
                warnings.add(format!("{label}: its skin is left out; the mesh is shown in its rest pose"));
            }
        }
        if doc.count("animations") > 0 {
            warnings.add("animations are left out; nodes stand where their own transforms put them");
        }
        let used = mesh::used_materials(doc, &meshes)?;
        let materials = Materials::read(doc, &used, warnings)?;
        Ok(Structure { placements, meshes, materials })
    }
}

#[cfg(test)]
mod tests;

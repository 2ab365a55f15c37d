//! glTF 2.0 bytes → [`SceneDescription`].
//!
//! The order of work: container ([`glb`]), JSON with places ([`json`], [`document`]), extensions, node placements,
//! which materials and textures these need, which of the latter can change the image ([`unread`]), which bytes of which
//! files that takes ([`needs`]), buffers, meshes, images, cameras, lights. What is not needed is checked for its structure
//! but neither decoded nor passed on, and not sent to a cluster ([`cut()`]).

mod accessor;
mod buffer;
mod camera;
mod cut;
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
mod needs;
mod nodes;
mod parts;
mod shading;
mod tangents;
mod texture;
mod topology;
mod unread;
mod uri;
mod vertices;

pub use cut::{cut, original_digest};
pub use extensions::SUPPORTED as SUPPORTED_EXTENSIONS;
pub use uri::relative_path;

use crate::scene::description::{InstanceDescription, LightDescription, SceneDescription};
use buffer::Files;
use document::{Document, Warnings};
use json::Result;
use material::Materials;
use mesh::{Budget, MeshReader};
use needs::Needs;
use nodes::Placement;
use parts::Inventory;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;
use unread::Unread;

/// A scene file with every external file it names, as bytes: what a client packs and a cluster passes on.
#[derive(Clone, Debug, Default)]
pub struct SceneBundle {
    /// The .glb or .gltf file's name (without directory).
    pub name: String,
    /// The file itself, or what [`cut()`] leaves of it.
    pub root: Arc<[u8]>,
    /// External buffers and images by the URI the file uses, in file order.
    pub externals: Vec<(String, Arc<[u8]>)>,
}

/// What of a scene is loaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wanted {
    /// Everything that can be read, also what no image could show.
    pub everything: bool,
    /// The image has layers of what surfaces are like, which are seen without light: albedo and normals.
    pub surface_layers: bool,
    /// Images are decoded.
    pub images: bool,
}

impl Default for Wanted {
    /// What any image may need.
    fn default() -> Self {
        Wanted { everything: false, surface_layers: true, images: true }
    }
}

/// URIs of the external files that a render of the .glb or .gltf may need: buffers that placed meshes read, then images
/// of the materials they wear, in file order without duplicates (data URIs left out). [`relative_path`] tells the path
/// that a URI names.
///
/// # Errors
/// When the file is not glTF 2.0, or its structure is damaged.
pub fn external_uris(name: &str, root: &[u8]) -> Result<Vec<String>> {
    external_uris_for(name, root, Wanted::default())
}

/// As [`external_uris`], of what is `wanted`.
///
/// # Errors
/// As [`external_uris`].
pub fn external_uris_for(name: &str, root: &[u8], wanted: Wanted) -> Result<Vec<String>> {
    let container = glb::split(name, root)?;
    parsed(name, container.json, wanted, |doc, needs| needs.external_uris(doc)).map(|(_, uris)| uris)
}

/// Reads the JSON of the file `name` and finds out what an image needs; `read` takes what else it wants to know.
fn parsed<T>(
    name: &str,
    json: &[u8],
    wanted: Wanted,
    read: impl FnOnce(&Document, &Needs) -> Result<T>,
) -> Result<(Needs, T)> {
    let json = json::parse(name, json)?;
    let doc = Document::new(name, &json)?;
    let structure = Structure::read(&doc, wanted, &mut Warnings::default())?;
    let views = buffer::check_views(&doc)?;
    let layouts = accessor::Layout::check_all(&doc, &views)?;
    let needs = Needs::of(&doc, &structure, &views, &layouts, wanted)?;
    let read = read(&doc, &needs)?;
    Ok((needs, read))
}

/// Reads a scene, as far as any image may need it.
///
/// # Errors
/// Names the place in the file and what is wrong with it. Never panics, whatever the bytes.
pub fn load(bundle: &SceneBundle) -> Result<SceneDescription> {
    load_for(bundle, Wanted::default())
}

/// Reads of a scene what is `wanted`.
///
/// # Errors
/// As [`load`].
pub fn load_for(bundle: &SceneBundle, wanted: Wanted) -> Result<SceneDescription> {
    let container = glb::split(&bundle.name, &bundle.root)?;
    let cut = container.table.map(|table| cut::Cut::decode(&bundle.name, table)).transpose()?;
    let json = json::parse(&bundle.name, container.json)?;
    let doc = Document::new(&bundle.name, &json)?;
    let mut warnings = Warnings::default();
    if container.trailing > 0 {
        warnings.add(format!("{} bytes after the end of the .glb are ignored", container.trailing));
    }
    let structure = Structure::read(&doc, wanted, &mut warnings)?;
    let views = buffer::check_views(&doc)?;
    let layouts = accessor::Layout::check_all(&doc, &views)?;
    let needs = Needs::of(&doc, &structure, &views, &layouts, wanted)?;
    let files = Files { binary: container.binary, externals: &bundle.externals, cut: cut.as_ref() };
    let buffers = buffer::Buffers::resolve(&doc, files, &needs)?;

    let mut scene = SceneDescription::default();
    let inventory =
        Inventory { doc: &doc, structure: &structure, views: &views, layouts: &layouts, needs: &needs, files, wanted };
    scene.parts = inventory.entries()?;
    // What is not read does not count, so that a cut scene may unfold as far as the whole.
    let read: u64 = (0..doc.count("buffers")).map(|b| needs.bytes_of(b)).sum();
    let mut reader = MeshReader {
        doc: &doc,
        layouts: &layouts,
        buffers: &buffers,
        materials: &structure.materials,
        wanted,
        budget: Budget::new((container.json.len() as u64).saturating_add(read)),
        warnings: &mut warnings,
    };
    let Structure { placements, meshes, materials, lights, .. } = &structure;
    let mut ranges = BTreeMap::new();
    for &mesh in meshes {
        let first = scene.meshes.len();
        scene.meshes.extend(reader.read(mesh)?);
        ranges.insert(mesh, first..scene.meshes.len());
    }
    place_meshes(&doc, placements, &ranges, &mut scene, &mut warnings)?;
    if wanted.images {
        let images = &materials.textures.images;
        scene.images = image::read_all(&doc, images, &views, &buffers, &bundle.externals, &mut warnings)?;
    }
    scene.textures = materials.textures.list.clone();
    scene.materials = materials.list.clone();
    scene.cameras = camera::read_all(&doc, placements, &mut warnings)?;
    scene.lights = lights.clone();
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
    /// Meshes that are read.
    meshes: BTreeSet<usize>,
    /// Materials that are read; `None`: the default one.
    used: BTreeSet<Option<usize>>,
    materials: Materials,
    /// Textures of these that are left out.
    unread: Vec<Unread>,
    lights: Vec<LightDescription>,
}

impl Structure {
    fn read(doc: &Document, wanted: Wanted, warnings: &mut Warnings) -> Result<Self> {
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
        let mut used = mesh::used_materials(doc, &meshes)?;
        let lights = light::read_all(doc, &placements, warnings)?;
        let placed = Materials::read(doc, &used, warnings)?;
        let dark = lights.iter().all(|l| l.intensity.is_black()) && placed.list.iter().all(|m| m.emission.is_black());
        let mut materials = placed;
        if wanted.everything {
            meshes = (0..doc.count("meshes")).collect();
            used.extend((0..doc.count("materials")).map(Some));
            materials = Materials::read(doc, &used, warnings)?;
        }
        let unread = unread::leave_out(&mut materials, dark, wanted);
        Ok(Structure { placements, meshes, used, materials, unread, lights })
    }
}

#[cfg(test)]
mod tests;

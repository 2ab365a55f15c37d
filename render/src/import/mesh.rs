//! glTF primitives → [`Mesh`].

use super::Wanted;
use super::accessor::{Layout, Reader};
use super::buffer::Buffers;
use super::document::{Document, Warnings};
use super::json::{Item, Result};
use super::limits::{BASE_ELEMENTS, ELEMENTS_PER_BYTE};
use super::material::Materials;
use super::shading::{repair_normals, unit_tangents};
use super::tangents;
use super::topology::Topology;
use super::vertices::Vertices;
use crate::geometry::Mesh;
use glam::{Vec2, Vec3, Vec4};
use std::collections::BTreeSet;

/// Materials that the primitives of `meshes` wear; `None` stands for the default material.
///
/// # Errors
/// When a primitive is damaged.
pub(super) fn used_materials(doc: &Document, meshes: &BTreeSet<usize>) -> Result<BTreeSet<Option<usize>>> {
    let mut used = BTreeSet::new();
    for &mesh in meshes {
        for primitive in doc.item("meshes", mesh)?.require("primitives")?.elements()? {
            if Topology::read(&primitive)?.is_some() {
                used.insert(doc.reference(&primitive, "material", "materials")?);
            }
        }
    }
    Ok(used)
}

/// Triangles and vertices that the file may still unfold to.
pub(super) struct Budget {
    limit: u64,
    triangles: u64,
    vertices: u64,
}

impl Budget {
    /// The budget of a file that, with its externals, has `bytes` bytes.
    pub(super) fn new(bytes: u64) -> Self {
        Budget {
            limit: BASE_ELEMENTS.saturating_add(bytes.saturating_mul(ELEMENTS_PER_BYTE)),
            triangles: 0,
            vertices: 0,
        }
    }
    fn take(&mut self, item: &Item, triangles: usize, vertices: usize) -> Result<()> {
        self.triangles = self.triangles.saturating_add(triangles as u64);
        self.vertices = self.vertices.saturating_add(vertices as u64);
        let remedy = "the file names the same data over and over; place one mesh by several nodes instead";
        if self.triangles > self.limit {
            return Err(item.limit("the number of triangles so far", self.triangles, self.limit, remedy));
        }
        if self.vertices > self.limit {
            return Err(item.limit("the number of vertices so far", self.vertices, self.limit, remedy));
        }
        Ok(())
    }
}

/// Reads meshes.
pub(super) struct MeshReader<'r, 'a> {
    /// The file.
    pub(super) doc: &'r Document<'a>,
    /// Its accessors.
    pub(super) layouts: &'r [Layout],
    /// Their bytes.
    pub(super) buffers: &'r Buffers<'r>,
    /// Materials, which say what attributes are needed.
    pub(super) materials: &'r Materials,
    /// What the image asks for.
    pub(super) wanted: Wanted,
    /// What may still be read.
    pub(super) budget: Budget,
    /// Where to say what is lost.
    pub(super) warnings: &'r mut Warnings,
}

impl<'r, 'a> MeshReader<'r, 'a> {
    /// The primitives of a mesh that make triangles.
    ///
    /// # Errors
    /// Names the primitive and the member that is damaged.
    pub(super) fn read(&mut self, mesh: usize) -> Result<Vec<Mesh>> {
        let item = self.doc.item("meshes", mesh)?;
        let label = self.doc.label("mesh", "meshes", mesh);
        let mut out = Vec::new();
        for primitive in item.require("primitives")?.elements()? {
            match Topology::read(&primitive)? {
                None => {
                    self.warnings.add(format!("{label}: points and lines are left out; only triangles are rendered"))
                }
                Some(topology) => out.extend(self.primitive(&primitive, topology, &label)?),
            }
            if primitive.get("targets")?.is_some() {
                self.warnings.add(format!("{label}: morph targets are left out; the base shape is shown"));
            }
        }
        Ok(out)
    }

    fn primitive(&mut self, item: &Item<'a>, topology: Topology, label: &str) -> Result<Option<Mesh>> {
        let attributes = item.require("attributes")?;
        let Some(positions) = self.attribute(&attributes, "POSITION", &[3], None)? else {
            self.warnings.add(format!("{label}: a primitive without positions is left out"));
            return Ok(None);
        };
        let count = positions.count;
        let mut triangles = self.triangles(item, topology, count, label)?;
        let corners = triangles.len();
        triangles.retain(|[a, b, c]| a != b && b != c && c != a);
        let vertices = Vertices::used(&mut triangles, count);
        self.budget.take(item, 0, vertices.len())?;
        let position_reader = positions.open(self.buffers)?;
        let positions: Vec<Vec3> = vec3s(&position_reader, &vertices)?;
        triangles.retain(|t| has_area(t.map(|v| positions.get(v as usize).copied().unwrap_or_default())));
        if triangles.len() < corners {
            self.warnings.add(format!(
                "{label}: {} of {corners} triangles have no area and are left out",
                corners - triangles.len()
            ));
        }
        if triangles.is_empty() {
            return Ok(None);
        }
        let material = self.materials.index(self.doc.reference(item, "material", "materials")?);
        let mut mesh = Mesh { positions, triangles, material: material as u32, ..Default::default() };
        self.surface(&attributes, &vertices, count, &mut mesh, label)?;
        Ok(Some(mesh))
    }

    /// The layout of attribute `name`, with a number of lanes from `lanes` and `count` elements.
    fn attribute(
        &self,
        attributes: &Item<'a>,
        name: &str,
        lanes: &[usize],
        count: Option<usize>,
    ) -> Result<Option<&'r Layout>> {
        let Some(reference) = attributes.get(name)? else { return Ok(None) };
        let index = self.doc.index(&reference, "accessors")?;
        let layouts: &'r [Layout] = self.layouts;
        let layout = layouts.get(index).ok_or_else(|| reference.error("the accessor does not exist"))?;
        if !lanes.contains(&layout.lanes) {
            let wanted: Vec<String> = lanes.iter().map(|n| format!("VEC{n}")).collect();
            return Err(reference.error(format!(
                "{name} must be {}, but accessors[{index}] has {} numbers an element",
                wanted.join(" or "),
                layout.lanes
            )));
        }
        if let Some(count) = count.filter(|n| *n != layout.count) {
            return Err(reference.error(format!(
                "accessors[{index}] has {} elements, but POSITION has {count}; all attributes need as many",
                layout.count
            )));
        }
        Ok(Some(layout))
    }

    /// Triangles of vertex indices < `vertex_count`.
    fn triangles(
        &mut self,
        item: &Item<'a>,
        topology: Topology,
        vertex_count: usize,
        label: &str,
    ) -> Result<Vec<[u32; 3]>> {
        let indices = match item.get("indices")? {
            None => None,
            Some(reference) => {
                let index = self.doc.index(&reference, "accessors")?;
                let layouts: &'r [Layout] = self.layouts;
                let layout = layouts.get(index).ok_or_else(|| reference.error("the accessor does not exist"))?;
                if !layout.is_index() {
                    return Err(reference.error(format!(
                        "accessors[{index}] does not hold indices: it must be SCALAR of 5121, 5123 or 5125, not normalized"
                    )));
                }
                Some(layout)
            }
        };
        let corners = indices.map_or(vertex_count, |layout| layout.count);
        let count = topology.triangle_count(corners);
        self.budget.take(item, count, 0)?;
        if topology == Topology::Triangles && corners % 3 != 0 {
            self.warnings
                .add(format!("{label}: {corners} indices make no whole number of triangles; the last are left out"));
        }
        let Some(layout) = indices else {
            return Ok((0..count).map(|t| topology.corners(t).map(|c| c as u32)).collect());
        };
        let reader = layout.open(self.buffers)?;
        let mut triangles = Vec::with_capacity(count);
        for t in 0..count {
            let triangle = topology.corners(t).map(|corner| reader.index(corner));
            if let Some(over) = triangle.into_iter().find(|v| *v as usize >= vertex_count) {
                return Err(crate::error::SceneError::invalid(
                    layout.place(),
                    format!("triangle {t} names vertex {over}, but {} has {vertex_count} vertices", item.path()),
                ));
            }
            triangles.push(triangle);
        }
        Ok(triangles)
    }

    /// Normals, colours, texture coordinates and tangents, as far as the material needs them.
    fn surface(
        &mut self,
        attributes: &Item<'a>,
        vertices: &Vertices,
        count: usize,
        mesh: &mut Mesh,
        label: &str,
    ) -> Result<()> {
        if let Some(layout) = self.attribute(attributes, "NORMAL", &[3], Some(count))? {
            let mut normals = vec3s(&layout.open(self.buffers)?, vertices)?;
            let repaired = repair_normals(&mut normals, &mesh.positions, &mesh.triangles);
            if repaired > 0 {
                self.warnings.add(format!(
                    "{label}: {repaired} normals have length zero and are made from the faces around them"
                ));
            }
            mesh.normals = Some(normals);
        }
        if let Some(layout) = self.attribute(attributes, "COLOR_0", &[3, 4], Some(count))? {
            let mut colors = layout.open(self.buffers)?.vectors::<4>(vertices.iter(), 1.0)?;
            let lanes = || colors.iter().flatten();
            if lanes().any(|v| !(0.0..=1.0).contains(v)) {
                self.warnings.add(format!("{label}: vertex colours outside 0 to 1 are clamped"));
                colors.iter_mut().flatten().for_each(|v| *v = v.clamp(0.0, 1.0));
            }
            mesh.colors = Some(colors);
        }
        let materials = self.materials;
        let sources = materials.uv_sources.get(mesh.material as usize).into_iter().flatten().enumerate();
        for (slot, source) in sources.filter(|(_, source)| source.read) {
            let name = format!("TEXCOORD_{}", source.set);
            let Some(layout) = self.attribute(attributes, &name, &[2], Some(count))? else {
                self.warnings.add(format!(
                    "{label} has no {name}, which its material's textures need; their first texel is used"
                ));
                continue;
            };
            let raw = layout.open(self.buffers)?.vectors::<2>(vertices.iter(), 0.0)?;
            let uvs: Vec<Vec2> = raw.into_iter().map(|uv| Vec2::from(source.apply(uv))).collect();
            if !uvs.iter().all(|uv| uv.is_finite()) {
                return Err(attributes.error(format!("{name} transformed by KHR_texture_transform is not finite")));
            }
            if let Some(place) = mesh.uvs.get_mut(slot) {
                *place = Some(uvs);
            }
        }
        if self.wanted.everything {
            self.spare_coordinates(attributes, vertices, count, mesh)?;
        }
        self.tangents(attributes, vertices, count, mesh)
    }

    /// Texture coordinates that no texture reads, into the sets that are free.
    fn spare_coordinates(
        &mut self,
        attributes: &Item<'a>,
        vertices: &Vertices,
        count: usize,
        mesh: &mut Mesh,
    ) -> Result<()> {
        // A set that a texture claims stays as it is, also where the mesh lacks it.
        let claimed = self.materials.uv_sources.get(mesh.material as usize).map_or(0, Vec::len);
        for (name, set) in ["TEXCOORD_0", "TEXCOORD_1"].into_iter().zip(0..).skip(claimed) {
            if mesh.uvs.get(set).is_some_and(Option::is_none)
                && let Some(layout) = self.attribute(attributes, name, &[2], Some(count))?
            {
                let raw = layout.open(self.buffers)?.vectors::<2>(vertices.iter(), 0.0)?;
                mesh.uvs[set] = Some(raw.into_iter().map(Vec2::from).collect());
            }
        }
        Ok(())
    }

    /// Tangents for normal maps: the file's own, or made from the texture coordinates.
    fn tangents(&mut self, attributes: &Item<'a>, vertices: &Vertices, count: usize, mesh: &mut Mesh) -> Result<()> {
        let material = self.materials.list.get(mesh.material as usize);
        let normal_map = material.and_then(|m| m.normal_texture);
        if normal_map.is_none() && !self.wanted.everything {
            return Ok(());
        }
        let given = self.attribute(attributes, "TANGENT", &[4], Some(count))?;
        match (given, &mesh.normals) {
            // Without normals, given tangents are to be ignored (glTF §3.7.2.1).
            (Some(layout), Some(normals)) => {
                let raw = layout.open(self.buffers)?.vectors::<4>(vertices.iter(), 1.0)?;
                mesh.tangents = Some(unit_tangents(raw.into_iter().map(Vec4::from), normals));
            }
            _ => {
                if let Some(map) = normal_map {
                    tangents::generate(mesh, map.uv_set);
                }
            }
        }
        Ok(())
    }
}

fn vec3s(reader: &Reader, vertices: &Vertices) -> Result<Vec<Vec3>> {
    Ok(reader.vectors::<3>(vertices.iter(), 0.0)?.into_iter().map(Vec3::from).collect())
}

/// False for triangles whose corners lie on one line, exactly.
fn has_area(corners: [Vec3; 3]) -> bool {
    let [a, b, c] = corners.map(|p| p.as_dvec3());
    let n = (b - a).cross(c - a);
    n.x != 0.0 || n.y != 0.0 || n.z != 0.0
}

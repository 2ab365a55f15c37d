//! Shapes as vertex arrays.

use gatherlight_render::math::ops;
use glam::Vec3;

/// A triangle mesh; arrays that are empty are left out of the file.
#[derive(Clone, Default)]
pub(crate) struct Shape {
    pub(crate) positions: Vec<[f32; 3]>,
    pub(crate) normals: Vec<[f32; 3]>,
    pub(crate) uvs: Vec<[f32; 2]>,
    pub(crate) colors: Vec<[f32; 4]>,
    pub(crate) triangles: Vec<[u32; 3]>,
}

impl Shape {
    /// A flat quadrilateral, counter-clockwise seen from its front, the image upright on it (first corner lower left).
    pub(crate) fn quad(corners: [[f32; 3]; 4]) -> Self {
        Shape {
            positions: corners.to_vec(),
            uvs: vec![[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Default::default()
        }
    }

    /// The six sides of an axis-aligned box, facing outward.
    pub(crate) fn cuboid(low: [f32; 3], high: [f32; 3]) -> Self {
        let mut shape = Shape::default();
        for side in Side::ALL {
            shape.join(&Shape::side(side, low, high));
        }
        shape
    }

    /// One side of an axis-aligned box, facing outward.
    pub(crate) fn side(side: Side, [x0, y0, z0]: [f32; 3], [x1, y1, z1]: [f32; 3]) -> Self {
        Shape::quad(match side {
            Side::Left => [[x0, y0, z0], [x0, y0, z1], [x0, y1, z1], [x0, y1, z0]],
            Side::Right => [[x1, y0, z1], [x1, y0, z0], [x1, y1, z0], [x1, y1, z1]],
            Side::Bottom => [[x0, y0, z0], [x1, y0, z0], [x1, y0, z1], [x0, y0, z1]],
            Side::Top => [[x0, y1, z1], [x1, y1, z1], [x1, y1, z0], [x0, y1, z0]],
            Side::Back => [[x1, y0, z0], [x0, y0, z0], [x0, y1, z0], [x1, y1, z0]],
            Side::Front => [[x0, y0, z1], [x1, y0, z1], [x1, y1, z1], [x0, y1, z1]],
        })
    }

    /// A flat board of `half` extents along `across`, along normal × across, and along `normal`, the way its top faces;
    /// `across` is perpendicular to `normal`, both of unit length.
    pub(crate) fn board(center: Vec3, across: Vec3, normal: Vec3, half: Vec3) -> Self {
        let along = normal.cross(across);
        let mut board = Shape::cuboid((-half).to_array(), half.to_array()).plain();
        for p in &mut board.positions {
            // x across, y up, z along: right-handed as along = normal × across says.
            *p = (center + across * p[0] + normal * p[1] - along * p[2]).to_array();
        }
        board
    }

    /// A ring about +y: every flank of the cross-section, from `[radius, height]` to `[radius, height]` anticlockwise
    /// in (radius, height), turned around in `segments` steps, smooth along the turn and sharp between flanks.
    pub(crate) fn ring(flanks: &[[[f32; 2]; 2]], segments: u32) -> Self {
        let mut ring = Shape::default();
        for &[[r0, h0], [r1, h1]] in flanks {
            // The normal of an anticlockwise outline, (Δh, −Δr), points out of the body.
            let length = glam::Vec2::new(r1 - r0, h1 - h0).length();
            let (out, up) = ((h1 - h0) / length, (r0 - r1) / length);
            let first = ring.positions.len() as u32;
            for i in 0..segments {
                let angle = 2.0 * ops::PI * i as f32 / segments as f32;
                let (sin, cos) = (ops::sin(angle), ops::cos(angle));
                for [r, h] in [[r0, h0], [r1, h1]] {
                    ring.positions.push([r * cos, h, r * sin]);
                    ring.normals.push([out * cos, up, out * sin]);
                }
                let (a, b) = (first + 2 * i, first + 2 * ((i + 1) % segments));
                ring.triangles.extend([[a, a + 1, b], [b, a + 1, b + 1]]);
            }
        }
        ring
    }

    /// A sheet over the square [−half, half]² of x and z, `cells` × `cells` quadrilaterals, facing up: `height` gives y and
    /// its slopes along x and z at a point.
    pub(crate) fn sheet(half: f32, cells: u32, height: impl Fn(f32, f32) -> [f32; 3]) -> Self {
        let mut sheet = Shape::default();
        let at = |i: u32| half * (2.0 * i as f32 / cells as f32 - 1.0);
        for j in 0..=cells {
            for i in 0..=cells {
                let [y, dx, dz] = height(at(i), at(j));
                sheet.positions.push([at(i), y, at(j)]);
                sheet.normals.push(Vec3::new(-dx, 1.0, -dz).normalize().to_array());
            }
        }
        for j in 0..cells {
            for i in 0..cells {
                let a = j * (cells + 1) + i;
                let b = a + cells + 1;
                sheet.triangles.extend([[a, b, a + 1], [a + 1, b, b + 1]]);
            }
        }
        sheet
    }

    /// A sphere of 20 · 4ⁿ triangles with smooth normals.
    pub(crate) fn sphere(center: [f32; 3], radius: f32, divisions: u32) -> Self {
        // Corners of an icosahedron: (0, ±1, ±φ) and its turns, φ the golden ratio.
        let phi = (1.0 + 5.0f32.sqrt()) / 2.0;
        let mut points: Vec<Vec3> = Vec::new();
        for (a, b) in [(-1.0, phi), (1.0, phi), (-1.0, -phi), (1.0, -phi)] {
            points.extend([Vec3::new(a, b, 0.0), Vec3::new(0.0, a, b), Vec3::new(b, 0.0, a)].map(Vec3::normalize));
        }
        let mut triangles = hull(&points);
        for _ in 0..divisions {
            let mut middles = std::collections::BTreeMap::new();
            let mut middle = |a: u32, b: u32, points: &mut Vec<Vec3>| {
                *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    points.push(((points[a as usize] + points[b as usize]) * 0.5).normalize());
                    points.len() as u32 - 1
                })
            };
            let mut finer = Vec::new();
            for [a, b, c] in triangles {
                let (ab, bc, ca) = (middle(a, b, &mut points), middle(b, c, &mut points), middle(c, a, &mut points));
                finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
            }
            triangles = finer;
        }
        let normals: Vec<[f32; 3]> = points.iter().map(|p| p.to_array()).collect();
        let positions = points.iter().map(|p| (Vec3::from(center) + *p * radius).to_array()).collect();
        Shape { positions, normals, triangles, ..Default::default() }
    }

    /// Adds another shape with the same arrays.
    pub(crate) fn join(&mut self, other: &Shape) {
        let first = self.positions.len() as u32;
        self.positions.extend(&other.positions);
        self.normals.extend(&other.normals);
        self.uvs.extend(&other.uvs);
        self.colors.extend(&other.colors);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + first)));
    }

    /// The same shape, facing the other way.
    pub(crate) fn turned(mut self) -> Self {
        self.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        self.normals.iter_mut().flatten().for_each(|n| *n = -*n);
        self
    }

    /// Without texture coordinates, for materials that have no textures.
    pub(crate) fn plain(mut self) -> Self {
        self.uvs.clear();
        self
    }

    /// Texture coordinates stretched from the origin.
    pub(crate) fn repeated(mut self, times: f32) -> Self {
        self.uvs.iter_mut().flatten().for_each(|c| *c *= times);
        self
    }
}

/// Sides of a box.
#[derive(Clone, Copy)]
pub(crate) enum Side {
    Left,
    Right,
    Bottom,
    Top,
    Back,
    Front,
}

impl Side {
    pub(crate) const ALL: [Side; 6] = [Side::Left, Side::Right, Side::Bottom, Side::Top, Side::Back, Side::Front];
}

/// Faces of the convex hull of an icosahedron's corners: the triples at edge length, facing outward.
fn hull(points: &[Vec3]) -> Vec<[u32; 3]> {
    // Edges of the icosahedron in the unit sphere are 1.05 long, the next distance is 1.70.
    let near = |a: usize, b: usize| points[a].distance(points[b]) < 1.4;
    let mut faces = Vec::new();
    for a in 0..points.len() {
        for b in a + 1..points.len() {
            for c in b + 1..points.len() {
                if near(a, b) && near(b, c) && near(c, a) {
                    let outward = (points[b] - points[a]).cross(points[c] - points[a]).dot(points[a]) > 0.0;
                    faces.push(if outward { [a, b, c] } else { [a, c, b] }.map(|v| v as u32));
                }
            }
        }
    }
    faces
}

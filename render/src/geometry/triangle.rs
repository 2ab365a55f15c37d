//! The watertight ray–triangle test of Woop, Benthin and Wald (2013), four triangles at a time.
//!
//! A ray that meets an edge or a vertex shared by triangles meets at least one of them. Distances near zero, where
//! rounding could move a hit to the wrong side of the ray's origin, are decided in double precision: a ray that starts
//! in front of a triangle's plane and leads away from it never meets that triangle, and hits at any distance count.

use super::simd::Lanes;
use glam::{DVec3, Vec3};

/// Triangles in a block.
pub(super) const BLOCK: usize = 4;

/// Half the distance from 1 to the next float: the bound on one operation's relative error.
const EPSILON: f32 = 1.0 / 16_777_216.0;

/// The bound on the relative error of `n` operations (pbrt 4th ed., §6.8.1).
const fn gamma(n: u32) -> f32 {
    n as f32 * EPSILON / (1.0 - n as f32 * EPSILON)
}

/// Up to four triangles by coordinate, and who they are.
#[derive(Clone, Debug)]
#[repr(C, align(16))]
pub(super) struct Block {
    /// `vertices[vertex][axis][triangle]`; not a number where there is no triangle.
    pub vertices: [[[f32; BLOCK]; 3]; 3],
    /// Instance of each triangle.
    pub instance: [u32; BLOCK],
    /// Index of each triangle in its mesh.
    pub triangle: [u32; BLOCK],
}

impl Block {
    /// A block without triangles.
    pub(super) const EMPTY: Block =
        Block { vertices: [[[f32::NAN; BLOCK]; 3]; 3], instance: [0; BLOCK], triangle: [0; BLOCK] };

    /// Puts a triangle into a lane.
    pub(super) fn set(&mut self, lane: usize, positions: [Vec3; 3], instance: u32, triangle: u32) {
        for (vertex, position) in positions.into_iter().enumerate() {
            for axis in 0..3 {
                self.vertices[vertex][axis][lane] = position[axis];
            }
        }
        self.instance[lane] = instance;
        self.triangle[lane] = triangle;
    }

    /// The corners of the triangle in a lane.
    #[inline]
    fn corners(&self, lane: usize) -> [Vec3; 3] {
        self.vertices.map(|v| Vec3::new(v[0][lane], v[1][lane], v[2][lane]))
    }
}

/// A ray in the coordinates of the test: axis z is the one along which it is longest, and it is sheared onto it.
#[derive(Clone, Copy, Debug)]
pub(super) struct ShearedRay {
    origin: Vec3,
    direction: Vec3,
    axes: [usize; 3],
    shear: Vec3,
}

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crossing {
    pub t: f32,
    pub b1: f32,
    pub b2: f32,
}

/// Triangles of a block that a ray may meet.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidates {
    /// Bit i: lane i is a candidate.
    pub lanes: u32,
    /// Those of which an edge function vanishes.
    edges: u32,
    t: [f32; BLOCK],
    b1: [f32; BLOCK],
    b2: [f32; BLOCK],
    /// Bound on the error of t.
    delta: [f32; BLOCK],
}

impl Candidates {
    const NONE: Candidates =
        Candidates { lanes: 0, edges: 0, t: [0.0; BLOCK], b1: [0.0; BLOCK], b2: [0.0; BLOCK], delta: [0.0; BLOCK] };
}

impl ShearedRay {
    /// The direction is finite and not zero; it need not be of unit length.
    #[inline(always)]
    pub(super) fn new(origin: Vec3, direction: Vec3) -> Self {
        let d = direction.abs();
        let z = if d.x >= d.y && d.x >= d.z {
            0
        } else if d.y >= d.z {
            1
        } else {
            2
        };
        let (mut x, mut y) = ([1, 2, 0][z], [2, 0, 1][z]);
        let dz = direction[z];
        if dz < 0.0 {
            std::mem::swap(&mut x, &mut y);
        }
        let shear = Vec3::new(direction[x] / dz, direction[y] / dz, 1.0 / dz);
        ShearedRay { origin, direction, axes: [x, y, z], shear }
    }

    /// Tests all triangles of a block. May leave out those that are met at t > `t_max`.
    #[inline(always)]
    pub(super) fn meet<L: Lanes<Row = [f32; BLOCK]>>(&self, token: L::Token, block: &Block, t_max: f32) -> Candidates {
        let [kx, ky, kz] = self.axes;
        // Spares nine bounds checks.
        if kx.max(ky).max(kz) > 2 {
            return Candidates::NONE;
        }
        let splat = |value| L::splat(token, value);
        let (ox, oy, oz) = (splat(self.origin[kx]), splat(self.origin[ky]), splat(self.origin[kz]));
        let (sx, sy, sz) = (splat(self.shear.x), splat(self.shear.y), splat(self.shear.z));
        let [a, b, c] = &block.vertices;
        // Written out: a closure is not compiled for the kernel's vectors unless it is inlined.
        let (az, bz, cz) =
            (L::load(token, &a[kz]).sub(oz), L::load(token, &b[kz]).sub(oz), L::load(token, &c[kz]).sub(oz));
        let (ax, bx, cx) = (
            L::load(token, &a[kx]).sub(ox).sub(sx.mul(az)),
            L::load(token, &b[kx]).sub(ox).sub(sx.mul(bz)),
            L::load(token, &c[kx]).sub(ox).sub(sx.mul(cz)),
        );
        let (ay, by, cy) = (
            L::load(token, &a[ky]).sub(oy).sub(sy.mul(az)),
            L::load(token, &b[ky]).sub(oy).sub(sy.mul(bz)),
            L::load(token, &c[ky]).sub(oy).sub(sy.mul(cz)),
        );
        let u = cx.mul(by).sub(cy.mul(bx));
        let v = ax.mul(cy).sub(ay.mul(cx));
        let w = bx.mul(ay).sub(by.mul(ax));
        let zero = splat(0.0);
        let inside = L::or(zero.le(u.min(v).min(w)), u.max(v).max(w).le(zero));
        let on_edge = L::or(L::or(u.eq(zero), v.eq(zero)), w.eq(zero));
        if L::bits(L::or(inside, on_edge)) == 0 {
            return Candidates::NONE;
        }
        let det = u.add(v).add(w);
        let (az, bz, cz) = (az.mul(sz), bz.mul(sz), cz.mul(sz));
        let t = u.mul(az).add(v.mul(bz)).add(w.mul(cz)).div(det);
        let largest = |a: L, b: L, c: L| a.abs().max(b.abs()).max(c.abs());
        let (x, y, z, e) = (largest(ax, bx, cx), largest(ay, by, cy), largest(az, bz, cz), largest(u, v, w));
        // The bound on t's error of pbrt 4th ed., §6.8.7.
        let delta_z = splat(gamma(3)).mul(z);
        let delta_x = splat(gamma(5)).mul(x.add(z));
        let delta_y = splat(gamma(5)).mul(y.add(z));
        let delta_e = splat(2.0).mul(splat(gamma(2)).mul(x).mul(y).add(delta_y.mul(x)).add(delta_x.mul(y)));
        let sum = splat(gamma(3)).mul(e).mul(z).add(delta_e.mul(z)).add(delta_z.mul(e));
        let delta = splat(3.0).mul(sum).div(det.abs());
        let in_range = L::and(L::or(t.le(splat(t_max)), t.le(delta)), zero.sub(delta).le(t));
        let edges = L::bits(on_edge);
        let lanes = L::bits(L::and(inside, in_range)) | edges;
        if lanes == 0 {
            return Candidates::NONE;
        }
        let (b1, b2) = (v.div(det).store(), w.div(det).store());
        Candidates { lanes, edges, t: t.store(), b1, b2, delta: delta.store() }
    }

    /// Whether and where the ray really meets a candidate, at t > 0.
    #[inline(always)]
    pub(super) fn resolve(&self, candidates: &Candidates, block: &Block, lane: usize) -> Option<Crossing> {
        let (t, delta) = (candidates.t[lane], candidates.delta[lane]);
        let crossing = Crossing { t, b1: candidates.b1[lane], b2: candidates.b2[lane] };
        if candidates.edges >> lane & 1 != 0 {
            self.meet_edge(block.corners(lane))
        } else if t > delta {
            Some(crossing)
        } else {
            self.meet_near(block.corners(lane), crossing, delta)
        }
    }

    /// A crossing whose distance is not above the bound on its error: whether it is positive is decided in double
    /// precision from the triangle's plane.
    #[cold]
    #[inline(never)]
    fn meet_near(&self, corners: [Vec3; 3], crossing: Crossing, delta: f32) -> Option<Crossing> {
        let [a, b, c] = corners.map(|p| p.as_dvec3());
        let normal = (b - a).cross(c - a);
        let t = normal.dot(a - self.origin.as_dvec3()) / normal.dot(self.direction.as_dvec3());
        // The plane's distance may be far off where the ray grazes it; the crossing's is within `delta`.
        let t = (t as f32).min(2.0 * delta);
        (t > 0.0).then_some(Crossing { t, ..crossing })
    }

    /// The test where an edge function vanishes in single precision: repeated in double, where the products of floats
    /// are exact, so that the triangles that share the edge agree about its side.
    #[cold]
    #[inline(never)]
    fn meet_edge(&self, corners: [Vec3; 3]) -> Option<Crossing> {
        let [kx, ky, kz] = self.axes;
        let sheared = corners.map(|p| {
            let z = p[kz] - self.origin[kz];
            let x = p[kx] - self.origin[kx] - self.shear.x * z;
            let y = p[ky] - self.origin[ky] - self.shear.y * z;
            Vec3::new(x, y, z * self.shear.z)
        });
        let [a, b, c] = sheared.map(|p| p.as_dvec3());
        let edges = DVec3::new(c.x * b.y - c.y * b.x, a.x * c.y - a.y * c.x, b.x * a.y - b.y * a.x);
        let det = edges.x + edges.y + edges.z;
        let one_sided = edges.min_element() >= 0.0 || edges.max_element() <= 0.0;
        if !one_sided || det == 0.0 || !det.is_finite() {
            return None;
        }
        let t = (edges.x * a.z + edges.y * b.z + edges.z * c.z) / det;
        let crossing = Crossing { t: t as f32, b1: (edges.y / det) as f32, b2: (edges.z / det) as f32 };
        // A generous bound: the error of any coordinate, over the slope of the triangle along the ray.
        let size = sheared.iter().fold(0.0f32, |m, p| m.max(p.abs().max_element()));
        let delta = gamma(64) * size * (1.0 + (size as f64 * size as f64 / det.abs()) as f32);
        if crossing.t > delta { Some(crossing) } else { self.meet_near(corners, crossing, delta) }
    }
}

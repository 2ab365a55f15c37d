//! Sub-paths of the bidirectional methods: their vertices, and what multiple importance sampling must know at each.
//!
//! A full path is made by any of the strategies (s, t): s vertices from a light, t from the camera, one connection. The
//! weight of a strategy with the power heuristic, β = 2, is 1/Σ (pᵢ/p)² over all strategies i of the same path. Each
//! sub-path carries its share of that sum in [`Quantities`], updated a vertex at a time from ratios of neighbouring pdfs
//! (Georgiev 2012, "Implementing Vertex Connection and Merging", eqs. 31–45): nothing is multiplied out along the path,
//! and in f64 the squares of all ratios that f32 pdfs can make stay in range.
//!
//! What the weights leave out on purpose, the same way for every strategy of a path, so that they still sum to 1:
//! - Russian roulette: only pdfs of directions count, not the probability of going on;
//! - the probability of choosing a Dirac lobe, which counts 1 in both directions.

use super::direct::light_at;
use crate::geometry::{Ray, SurfacePoint};
use crate::light::{EmissionSample, Light};
use crate::material::{Bsdf, Lobes, Scatter, TransportMode};
use crate::math::{Numbers, Rgb, roulette};
use crate::scene::segment::Interior;
use crate::scene::{Camera, Scene};
use glam::Vec3;

/// A ratio of pdfs as the power heuristic counts it.
#[inline]
pub fn power(ratio: f64) -> f64 {
    ratio * ratio
}

/// How vertex merging counts among the strategies: η = n·π·r², the expected number of light paths that land within the
/// radius r of a point, where n is the number of light paths that are merged with (Georgiev 2012, eq. 20).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Merging {
    /// η^β: weight of a merge relative to the connection at the same vertex; 0 without merging.
    pub vm: f64,
    /// η^−β; 0 without connections.
    pub vc: f64,
}

impl Merging {
    /// Connections only.
    pub const NONE: Merging = Merging { vm: 0.0, vc: 0.0 };
    /// Connections and merges with `paths` light paths within `radius` scene units.
    pub fn new(paths: f64, radius: f32) -> Merging {
        let r = f64::from(radius);
        let eta = paths * std::f64::consts::PI * r * r;
        Merging { vm: power(eta), vc: power(1.0 / eta) }
    }
}

/// The part of a sub-path in the weights of the full paths it becomes part of.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quantities {
    /// dVCM: what connecting and merging share.
    pub vcm: f64,
    /// dVC: strategies that connect.
    pub vc: f64,
    /// dVM: strategies that merge.
    pub vm: f64,
}

impl Quantities {
    /// After a segment of `distance` that meets a surface at geometric cosine `cos` (ibid. eqs. 31–33).
    #[inline]
    pub fn arrived(self, distance: f32, cos: f32) -> Quantities {
        let per_cos = power(1.0 / f64::from(cos));
        let d = f64::from(distance);
        Quantities { vcm: self.vcm * power(d * d) * per_cos, vc: self.vc * per_cos, vm: self.vm * per_cos }
    }

    /// After scattering by non-Dirac lobes at geometric cosine `cos`, where `forward` is the pdf (per solid angle) of the
    /// direction taken and `reverse` that of the direction back (ibid. eqs. 34–36).
    #[inline]
    pub fn scattered(self, cos: f32, forward: f32, reverse: f32, merging: Merging) -> Quantities {
        let ratio = power(f64::from(cos) / f64::from(forward));
        let reverse = power(f64::from(reverse));
        Quantities {
            vcm: power(1.0 / f64::from(forward)),
            vc: ratio * (self.vc * reverse + self.vcm + merging.vm),
            vm: ratio * (self.vm * reverse + self.vcm * merging.vc + 1.0),
        }
    }

    /// After scattering by a Dirac lobe, at which nothing can connect or merge (ibid. eqs. 37–39).
    #[inline]
    pub fn reflected(self, cos: f32) -> Quantities {
        let ratio = power(f64::from(cos));
        Quantities { vcm: 0.0, vc: self.vc * ratio, vm: self.vm * ratio }
    }
}

/// Where a sub-path starts.
#[derive(Clone, Copy, Debug)]
pub enum Origin<'a> {
    /// The camera; `light_paths` is the number of light paths for each camera sample of a pixel.
    Camera {
        /// The camera.
        camera: &'a Camera,
        /// Light paths traced per camera sample.
        light_paths: f64,
    },
    /// A light, chosen with probability `pmf`.
    Light {
        /// The light.
        light: &'a Light,
        /// Probability of choosing it.
        pmf: f32,
    },
}

/// The first segment of a sub-path.
#[derive(Clone, Copy, Debug)]
pub struct Start<'a> {
    /// Where it starts.
    pub origin: Origin<'a>,
    /// The first ray.
    pub ray: Ray,
    /// Radiance or power it carries, over its pdf.
    pub throughput: Rgb,
}

impl<'a> Start<'a> {
    /// A camera sub-path along `ray`.
    #[inline]
    pub fn camera(camera: &'a Camera, light_paths: f64, ray: Ray) -> Self {
        Start { origin: Origin::Camera { camera, light_paths }, ray, throughput: Rgb::WHITE }
    }

    /// A light sub-path: chooses a light by its power, a point and a direction. Takes five numbers.
    #[inline]
    pub fn light(scene: &'a Scene, numbers: &mut impl Numbers) -> Option<Self> {
        let (u_light, u_position, u_direction) = (numbers.next_1d(), numbers.next_2d(), numbers.next_2d());
        let (index, pmf) = scene.lights.selector().sample(u_light)?;
        let light = scene.lights.get(index)?;
        let EmissionSample { origin, direction, power, .. } =
            light.sample_le(&scene.light_context(), u_position, u_direction)?;
        Some(Start {
            origin: Origin::Light { light, pmf },
            ray: Ray::new(origin, direction),
            throughput: power * (1.0 / pmf),
        })
    }

    /// The quantities at the first surface, `point`, which the first ray meets at `distance` (ibid. eqs. 31–33, and for the
    /// lights' own densities 43–45).
    #[inline]
    pub fn arrived(&self, point: &SurfacePoint, distance: f32, merging: Merging) -> Quantities {
        let flight = self.ray.direction;
        let cos = f64::from(flight.dot(point.ng).abs());
        match self.origin {
            Origin::Camera { camera, light_paths } => {
                let vcm = power(light_paths / (camera.density(flight, distance) * cos));
                Quantities { vcm, vc: 0.0, vm: 0.0 }
            }
            Origin::Light { light, pmf } => {
                let density = light.landing_density(flight, distance) * cos;
                if light.is_dirac() {
                    return Quantities { vcm: power(1.0 / density), vc: 0.0, vm: 0.0 };
                }
                let pdf = f64::from(light.pdf_li(point.position, -flight, distance));
                let vc = power(1.0 / (density * f64::from(pmf)));
                Quantities { vcm: power(pdf / density), vc, vm: vc * merging.vc }
            }
        }
    }
}

/// A surface that a sub-path met.
#[derive(Clone, Copy, Debug)]
pub struct Vertex {
    /// The surface.
    pub point: SurfacePoint,
    /// How it scatters.
    pub bsdf: Bsdf,
    /// Unit direction back along the sub-path.
    pub wo: Vec3,
    /// Where the segment that arrived left.
    pub from: Vec3,
    /// Length of that segment.
    pub distance: f32,
    /// What arrives, over its pdf: power of light sub-paths, importance of camera sub-paths.
    pub throughput: Rgb,
    /// The body of the segment that arrived.
    pub interior: Interior,
    /// Edges from the start of the sub-path, ≥ 1.
    pub length: u32,
    /// Its share in the weights.
    pub quantities: Quantities,
}

impl Vertex {
    /// Whether other vertices can be connected to it: it has a lobe that is not Dirac.
    #[inline]
    pub fn is_connectible(&self) -> bool {
        self.bsdf.lobes().intersects(Lobes::NON_DIRAC)
    }
    /// The light that the vertex lies on, and the probability of choosing it.
    #[inline]
    pub fn light<'a>(&self, scene: &'a Scene) -> Option<(&'a Light, f32)> {
        light_at(scene, &self.point)
    }
}

/// A random walk from surface to surface.
#[derive(Clone, Copy)]
pub struct Walk<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// What travels along it.
    pub mode: TransportMode,
    /// How merging counts.
    pub merging: Merging,
    /// Most surfaces met.
    pub max_length: u32,
    /// Whether Russian roulette ends it.
    pub roulette: bool,
}

impl Walk<'_> {
    /// Walks on from `start` and hands every vertex to `visit`, with the source of numbers. Takes four numbers a vertex
    /// besides those that `visit` takes. Returns the number of rays traced.
    pub fn run<N: Numbers>(&self, start: &Start, numbers: &mut N, mut visit: impl FnMut(&Vertex, &mut N)) -> u32 {
        let scene = self.scene;
        let full = start.throughput.max_component().max(f32::MIN_POSITIVE);
        let (mut ray, mut from, mut throughput) = (start.ray, start.ray.origin, start.throughput);
        let mut interior = Interior::default();
        let mut quantities = Quantities::default();
        for length in 1..=self.max_length {
            if throughput.is_black() {
                return length - 1;
            }
            let Some((point, distance)) = scene.intersect_with_distance(&ray) else { return length };
            let wo = -ray.direction;
            let bsdf = scene.bsdf(&point);
            let cos = bsdf.cos_geometric(wo);
            if cos == 0.0 {
                return length;
            }
            throughput *= interior.transmittance_to(scene, &point, wo, distance);
            quantities = if length == 1 {
                start.arrived(&point, distance, self.merging)
            } else {
                quantities.arrived(distance, cos)
            };
            visit(&Vertex { point, bsdf, wo, from, distance, throughput, interior, length, quantities }, numbers);
            if length == self.max_length {
                return length;
            }
            let (u, u_roulette) = (numbers.next_3d(), numbers.next_1d());
            let Some(s) = bsdf.sample(wo, u, Lobes::ALL, self.mode) else { return length };
            throughput *= s.weight;
            if self.mode == TransportMode::Importance {
                throughput *= bsdf.importance_correction(wo, s.wi);
            }
            if self.roulette {
                let survival = roulette::camera_survival(throughput.max_component() / full, length - 1);
                if u_roulette >= survival {
                    return length;
                }
                throughput *= 1.0 / survival;
            }
            let cos = bsdf.cos_geometric(s.wi);
            quantities = if s.is_specular() {
                quantities.reflected(cos)
            } else {
                let reverse = bsdf.pdf(s.wi, wo, Lobes::ALL, self.mode.reversed());
                quantities.scattered(cos, s.pdf, reverse, self.merging)
            };
            if s.transmitted {
                interior = interior.crossed(scene, &point, s.wi);
            }
            (ray, from) = (Ray::new(point.spawn(s.wi), s.wi), point.position);
        }
        self.max_length
    }
}

//! Bidirectional path tracing: every strategy (s, t), combined by multiple importance sampling (Lafortune and Willems
//! 1993; Veach and Guibas 1994; Veach 1997, §10).
//!
//! Each camera sample has a light sub-path of its own, made anew where it is needed from its index. What its vertices
//! show to the camera (t = 1) lands on the light image.

use super::connect::{Connection, Connector, Contribution};
use super::path::first_hit;
use super::sample::Sample;
use super::tile::SampleId;
use super::vertex::{Start, Vertex, Walk};
use crate::film::LightImage;
use crate::geometry::Ray;
use crate::material::TransportMode;
use crate::math::sobol::Sampler;
use crate::math::{Purpose, Stream};
use crate::scene::{Camera, Scene};
use crate::settings::{Layer, RenderSettings, Strategy};

/// Connections that would add less than this share of what a sample has already are subject to roulette. Larger saves few
/// rays more and adds noise (measured: 0.1 gives the least variance · time on diffuse, glossy and specular rooms).
const ROULETTE_SHARE: f32 = 0.1;

/// The strategies of bidirectional path tracing, with the light sub-path of the sample at hand.
pub struct Bdpt<'a> {
    connector: Connector<'a>,
    seed: u64,
    samples: u32,
    max_depth: u32,
    width: u32,
    /// Whether what each strategy gives is wanted by itself. Connections are then not subject to roulette, which goes by
    /// weights.
    strategies: bool,
    light_path: Vec<Vertex>,
}

impl<'a> Bdpt<'a> {
    /// For the samples of a tile; `connector` says how merging counts beside these strategies, and how many light paths there
    /// are.
    pub fn new(connector: Connector<'a>, settings: &RenderSettings) -> Self {
        Bdpt {
            connector,
            seed: settings.seed,
            samples: settings.samples,
            max_depth: settings.max_depth.unwrap_or(u32::MAX),
            width: settings.width,
            strategies: settings.layers.contains(&Layer::Strategies),
            light_path: Vec::new(),
        }
    }
    /// Bidirectional path tracing alone, with a light path for each camera sample.
    pub fn alone(scene: &'a Scene, camera: &'a Camera, settings: &RenderSettings) -> Self {
        Bdpt::new(Connector::new(scene, camera), settings)
    }
    pub(super) fn connector(&self) -> &Connector<'a> {
        &self.connector
    }
    pub(super) fn max_depth(&self) -> u32 {
        self.max_depth
    }

    /// Radiance along `ray` by all strategies with t ≥ 2; those with t = 1 are added to `light`.
    pub fn trace(&mut self, id: SampleId, ray: Ray, sampler: &mut Sampler, light: &mut LightImage) -> Sample {
        let mut sample = Sample::default();
        let index = id.pixel * u64::from(self.samples) + u64::from(id.sample);
        light.add_rays(self.trace_light_path(Sampler::new(self.seed, Purpose::LightPath, 0, 0, index)));
        self.look_at_light_path(light);
        self.trace_camera_path(id, ray, sampler, &mut sample, light, |_, _, _| ());
        sample
    }

    /// Adds to `sample` what the camera path along `ray` finds by strategies with t ≥ 2, and what `visit` adds at each vertex.
    pub(super) fn trace_camera_path(
        &self,
        id: SampleId,
        ray: Ray,
        sampler: &mut Sampler,
        sample: &mut Sample,
        light: &mut LightImage,
        mut visit: impl FnMut(&Self, &Vertex, &mut Sample),
    ) {
        let mut random = Stream::new(self.seed, Purpose::Connection, id.sample, id.pixel);
        let (x, y) = ((id.pixel % u64::from(self.width)) as u32, (id.pixel / u64::from(self.width)) as u32);
        let mut found = |s: u32, v: &Vertex, c: Contribution, sample: &mut Sample| {
            sample.direct += c.weighted();
            self.record(s, v.length + 1, c, (x, y), light);
        };
        let walk = self.walk(TransportMode::Radiance, self.max_depth);
        let start = Start::camera(self.connector.camera, self.connector.light_paths, ray);
        sample.rays += walk.run(&start, sampler, |v, sampler| {
            self.gather(v, sampler, &mut random, sample, &mut found);
            visit(self, v, sample);
        });
    }

    fn walk(&self, mode: TransportMode, max_length: u32) -> Walk<'a> {
        Walk { scene: self.connector.scene, mode, merging: self.connector.merging, max_length, roulette: true }
    }

    /// Makes the light sub-path of `sampler`; returns the rays traced.
    pub(super) fn trace_light_path(&mut self, mut sampler: Sampler) -> u64 {
        self.light_path.clear();
        let Some(start) = Start::light(self.connector.scene, &mut sampler) else { return 0 };
        // Its last vertex still needs an edge to the camera.
        let walk = self.walk(TransportMode::Importance, self.max_depth.saturating_sub(1));
        let path = &mut self.light_path;
        let rays = walk.run(&start, &mut sampler, |v, _| {
            if v.is_connectible() {
                path.push(*v);
            }
        });
        u64::from(rays)
    }

    /// t = 1.
    pub(super) fn look_at_light_path(&self, light: &mut LightImage) {
        for v in &self.light_path {
            let Some((p, connection)) = self.connector.lens(v) else { continue };
            light.add_rays(1);
            if let Some(c) = self.unblocked(&connection) {
                let pixel = (p.x as u32, p.y as u32);
                light.splat(0, pixel.0, pixel.1, c.weighted());
                self.record(v.length + 1, 1, c, pixel, light);
            }
        }
    }

    /// Adds what strategy (s, t) found to its layers, where they are wanted.
    #[inline]
    fn record(&self, s: u32, t: u32, c: Contribution, (x, y): (u32, u32), light: &mut LightImage) {
        if !self.strategies {
            return;
        }
        if let Some(strategy) = Strategy::new(s, t) {
            let [weighted, unweighted] = strategy.planes();
            light.splat(weighted, x, y, c.weighted());
            light.splat(unweighted, x, y, c.value);
        }
    }

    /// Everything that ends at or connects to the camera vertex `v`: `found` is told s, `v` and what it gives.
    fn gather(
        &self,
        v: &Vertex,
        sampler: &mut Sampler,
        random: &mut Stream,
        sample: &mut Sample,
        found: &mut impl FnMut(u32, &Vertex, Contribution, &mut Sample),
    ) {
        if v.length == 1 {
            sample.first = Some(first_hit(&v.point, &v.bsdf, v.wo));
        }
        if let Some(c) = self.connector.emission(v) {
            found(0, v, c, sample);
        }
        if v.length >= self.max_depth {
            return;
        }
        if let Some(c) = self.connector.next_event(v, sampler).and_then(|c| self.test(&c, sample)) {
            found(1, v, c, sample);
        }
        if !v.is_connectible() {
            return;
        }
        for l in &self.light_path {
            // Connected, the path has one edge more than its parts.
            if u64::from(v.length) + u64::from(l.length) < u64::from(self.max_depth) {
                let connection = self.connector.connect(v, l);
                let kept = |c| if self.strategies { Some(c) } else { roulette(c, sample, random) };
                if let Some(c) = connection.and_then(kept).and_then(|c| self.test(&c, sample)) {
                    found(l.length + 1, v, c, sample);
                }
            }
        }
    }

    /// Traces the ray of a connection for `sample`.
    fn test(&self, connection: &Connection, sample: &mut Sample) -> Option<Contribution> {
        sample.rays += 1;
        self.unblocked(connection)
    }

    fn unblocked(&self, connection: &Connection) -> Option<Contribution> {
        (!self.connector.scene.occluded(&connection.shadow)).then_some(connection.contribution)
    }
}

/// Russian roulette before the shadow ray of a connection, by what it could add to what the sample has already: rays that
/// could not change the sample much are mostly not traced. No bias: those that are traced count for the others.
fn roulette(mut connection: Connection, sample: &Sample, random: &mut Stream) -> Option<Connection> {
    let worth = ROULETTE_SHARE * sample.direct.max_component();
    let gain = connection.contribution.weighted().max_component();
    let survival = gain / worth;
    // Also where it is not a number.
    if survival >= 1.0 || survival.is_nan() {
        return Some(connection);
    }
    if random.next_f32() >= survival {
        return None;
    }
    connection.contribution.value *= 1.0 / survival;
    Some(connection)
}

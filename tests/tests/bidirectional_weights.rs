//! The weights of all strategies that make one path sum to 1: for sampled paths, the recursive weights against the ratio of
//! every strategy's pdf, multiplied out in f64 over the whole path.

use gatherlight_render::geometry::Ray;
use gatherlight_render::integrator::connect::{Connector, Contribution};
use gatherlight_render::integrator::direct::LightDirection;
use gatherlight_render::integrator::vertex::{Merging, Origin, Start, Vertex, Walk};
use gatherlight_render::light::Light;
use gatherlight_render::material::{Lobes, Scatter, TransportMode};
use gatherlight_render::math::Purpose;
use gatherlight_render::math::sobol::Sampler;
use gatherlight_render::scene::{Camera, Scene, builder};
use gatherlight_render::settings::CameraChoice;
use gatherlight_tests::transport;
use glam::Vec3;

/// Most edges of a path.
const LONGEST: usize = 5;
/// Light paths for each camera sample: not 1, so that the factor is seen to be where it belongs.
const LIGHT_PATHS: f64 = 0.5;

/// A vertex of a full path between light and camera.
#[derive(Clone, Copy)]
struct Node<'a> {
    at: &'a Vertex,
    /// Unit direction and distance to the neighbour on the light's side, and on the camera's side.
    light_side: (Vec3, f32),
    camera_side: (Vec3, f32),
    /// Scattered by a Dirac lobe.
    dirac: bool,
}

/// A full path: surfaces from the light's side to the camera's, and the light.
struct FullPath<'a> {
    nodes: Vec<Node<'a>>,
    light: &'a Light,
    pmf: f64,
    /// |cos| at the light's surface; 1 for punctual lights.
    cos_light: f64,
}

impl FullPath<'_> {
    /// pdf per area of `to`, reached along `direction` from a neighbour at `distance`.
    fn to_area(pdf: f64, to: &Vertex, direction: Vec3, distance: f32) -> f64 {
        pdf * f64::from(direction.dot(to.point.ng).abs()) / f64::from(distance).powi(2)
    }

    /// pdf per solid angle of scattering at `n` away from the light (importance) or towards it (radiance).
    fn scattering(n: &Node, mode: TransportMode) -> f64 {
        let (from, to) = match mode {
            TransportMode::Importance => (n.light_side.0, n.camera_side.0),
            TransportMode::Radiance => (n.camera_side.0, n.light_side.0),
        };
        if n.dirac { 1.0 } else { f64::from(n.at.bsdf.pdf(from, to, Lobes::ALL, mode)) }
    }

    /// pdf of every strategy s = 0 … m + 1 for the m surfaces, then of merging at each surface, as a density over the areas of
    /// all vertices.
    fn pdfs(&self, camera: &Camera, techniques: &Techniques) -> Vec<f64> {
        let n = &self.nodes;
        let m = n.len();
        let (first, last) = (&n[0], &n[m - 1]);
        // From the light: the density of each surface, given those before; that of the light's point with the first.
        let (flight, distance) = (-first.light_side.0, first.light_side.1);
        let landing = self.light.landing_density(flight, distance) * f64::from(flight.dot(first.at.point.ng).abs());
        let d2 = f64::from(distance).powi(2);
        // Area lights: landing_density = pdf_position · pdf_direction / cos_light, and a solid angle has d² per area.
        let is_area = !self.light.is_dirac();
        let start = self.pmf * landing * if is_area { self.cos_light / d2 } else { 1.0 };
        let mut from_light = vec![start];
        for j in 1..m {
            let pdf = Self::scattering(&n[j - 1], TransportMode::Importance);
            let (direction, distance) = n[j].light_side;
            from_light.push(Self::to_area(pdf, n[j].at, direction, distance));
        }
        // From the camera.
        let (direction, distance) = last.camera_side;
        let seen = camera.density(-direction, distance) * f64::from(direction.dot(last.at.point.ng).abs());
        let mut from_camera = vec![0.0; m];
        from_camera[m - 1] = seen;
        for j in 0..m - 1 {
            let pdf = Self::scattering(&n[j + 1], TransportMode::Radiance);
            let (direction, distance) = n[j].camera_side;
            from_camera[j] = Self::to_area(pdf, n[j].at, direction, distance);
        }
        let product = |p: &[f64]| p.iter().product::<f64>();
        let connects = |j: usize| if n[j].dirac { 0.0 } else { 1.0 };
        let hit = if is_area { Self::scattering(first, TransportMode::Radiance) * self.cos_light / d2 } else { 0.0 };
        let direct = if is_area {
            let pdf =
                f64::from(self.light.pdf_li(first.at.point.position, first.light_side.0, distance_to_light(first)));
            self.pmf * pdf * self.cos_light / d2
        } else {
            self.pmf
        };
        let mut pdfs = vec![product(&from_camera) * hit, product(&from_camera) * direct * connects(0)];
        for s in 2..=m {
            let ends = connects(s - 2) * connects(s - 1);
            pdfs.push(product(&from_light[..s - 1]) * product(&from_camera[s - 1..]) * ends);
        }
        pdfs.push(product(&from_light) * LIGHT_PATHS * connects(m - 1));
        if !techniques.connections {
            pdfs.fill(0.0);
        }
        for j in 0..m {
            pdfs.push(product(&from_light[..=j]) * product(&from_camera[j..]) * techniques.eta * connects(j));
        }
        pdfs
    }

    /// The weight of strategy `s` by the power heuristic.
    fn weight(&self, camera: &Camera, techniques: &Techniques, s: usize) -> f64 {
        let pdfs = self.pdfs(camera, techniques);
        let sum: f64 = pdfs.iter().map(|p| (p / pdfs[s]).powi(2)).sum();
        1.0 / sum
    }
}

/// Which strategies there are.
struct Techniques {
    connections: bool,
    /// Expected number of light paths that land within the merge radius of a point, per density; 0 without merging.
    eta: f64,
}

impl Techniques {
    fn merging(&self) -> Merging {
        let square = |v: f64| v * v;
        match self {
            Techniques { eta: 0.0, .. } => Merging::NONE,
            Techniques { connections: false, eta } => Merging { vm: square(*eta), vc: 0.0 },
            // As the renderer makes it: 700 paths within the radius that gives this η.
            Techniques { connections: true, eta } => {
                Merging::new(700.0, (eta / (700.0 * std::f64::consts::PI)).sqrt() as f32)
            }
        }
    }
}

fn distance_to_light(n: &Node) -> f32 {
    n.light_side.1
}

/// Joins a light sub-path (from the light) and a camera sub-path (from the camera) at their ends; `end` is what the last
/// camera vertex sees on the light's side where there is no light vertex.
fn join<'a>(
    light: &'a [Vertex],
    camera: &'a [Vertex],
    end: Option<(Vec3, f32)>,
    dirac: &[Vec<bool>; 2],
) -> Vec<Node<'a>> {
    let span = |from: &Vertex, to: &Vertex| {
        let d = to.point.position - from.point.position;
        (d.normalize(), d.length())
    };
    let mut nodes: Vec<Node> = light
        .iter()
        .enumerate()
        .map(|(i, v)| {
            let camera_side = match light.get(i + 1) {
                Some(next) => (-next.wo, next.distance),
                None => camera.last().map_or((Vec3::ZERO, 0.0), |c| span(v, c)),
            };
            let dirac = i + 1 < light.len() && dirac[0][i];
            Node { at: v, light_side: (v.wo, v.distance), camera_side, dirac }
        })
        .collect();
    for (i, v) in camera.iter().enumerate().rev() {
        let light_side = match camera.get(i + 1) {
            Some(next) => (-next.wo, next.distance),
            None => end.unwrap_or_else(|| light.last().map_or((Vec3::ZERO, 0.0), |l| span(v, l))),
        };
        let scatters = i + 1 < camera.len() || end.is_some();
        let dirac = scatters && dirac[1].get(i) == Some(&true);
        nodes.push(Node { at: v, light_side, camera_side: (v.wo, v.distance), dirac });
    }
    nodes
}

/// Vertices of a walk, and whether each scattered by a Dirac lobe (read off the quantities of the next).
fn walk(
    scene: &Scene,
    mode: TransportMode,
    merging: Merging,
    start: &Start,
    sampler: &mut Sampler,
) -> (Vec<Vertex>, Vec<bool>) {
    let mut vertices: Vec<Vertex> = Vec::new();
    let max_length = LONGEST as u32;
    Walk { scene, mode, merging, max_length, roulette: true }.run(start, sampler, |v, _| vertices.push(*v));
    let dirac = (1..vertices.len()).map(|i| vertices[i].quantities.vcm == 0.0).collect();
    (vertices, dirac)
}

struct Check {
    techniques: Techniques,
    /// Paths seen by number of edges and strategy: s, then by the surface that merges.
    seen: [[u32; 2 * LONGEST + 2]; LONGEST + 2],
    worst: f64,
    name: &'static str,
}

impl Check {
    fn compare(&mut self, path: &FullPath, camera: &Camera, s: usize, c: Contribution) {
        let edges = path.nodes.len() + 1;
        let merges = s > edges;
        if edges > LONGEST || c.value.is_black() || !(merges || self.techniques.connections) {
            return;
        }
        let expected = path.weight(camera, &self.techniques, s);
        let error = (f64::from(c.weight) - expected).abs();
        self.worst = self.worst.max(error);
        self.seen[edges][s] += 1;
        assert!(
            error <= 1e-5,
            "{}: strategy s = {s} of a path of {edges} edges weighs {}, by all pdfs {expected} ({:?})",
            self.name,
            c.weight,
            path.pdfs(camera, &self.techniques)
        );
    }
}

impl Check {
    /// Merging the camera vertex `c` with the light vertex `l` at the same place.
    fn merge(&mut self, path: &FullPath, camera: &Camera, connector: &Connector, c: &Vertex, l: &Vertex) {
        let shares = [l.quantities.vcm.sqrt(), l.quantities.vm.sqrt()];
        if self.techniques.eta > 0.0
            && let Some(merged) = connector.merge(c, l.wo, l.throughput, shares)
        {
            self.compare(path, camera, path.nodes.len() + 1 + l.length as usize, merged);
        }
    }
}

/// The camera vertex that the camera sub-path ending in `c` would make by walking on to the light vertex `l`.
fn walked_on(c: &Vertex, l: &Vertex, merging: Merging) -> Option<Vertex> {
    let d = l.point.position - c.point.position;
    let (wi, distance) = (d.normalize(), d.length());
    let (f, forward) = c.bsdf.eval_pdf(c.wo, wi, TransportMode::Radiance);
    let (_, reverse) = c.bsdf.eval_pdf(wi, c.wo, TransportMode::Importance);
    let scattered = c.quantities.scattered(c.bsdf.cos_geometric(wi), forward, reverse, merging);
    let quantities = scattered.arrived(distance, l.bsdf.cos_geometric(wi));
    let (throughput, from, length) = (c.throughput * f, c.point.position, c.length + 1);
    (forward > 0.0).then_some(Vertex { wo: -wi, from, distance, throughput, quantities, length, ..*l })
}

fn cos_of(light: &Light, flight: Vec3) -> f64 {
    match light {
        Light::Area(a) => f64::from(flight.dot(a.normal).abs()),
        _ => 1.0,
    }
}

/// s = 1 and s = 0 at every vertex of camera sub-path `i`.
fn check_camera_ends(check: &mut Check, connector: &Connector, camera_path: &[Vertex], dirac: &[Vec<bool>; 2], i: u64) {
    let (scene, camera) = (connector.scene, connector.camera);
    for b in 1..=camera_path.len() {
        let (e, v) = (&camera_path[..b], &camera_path[b - 1]);
        // s = 1.
        let mut numbers = Sampler::new(3, Purpose::Test, b as u32, i, 0);
        let seen = LightDirection::sample(scene, &v.point, &mut numbers.clone());
        if let (Some(c), Some(l)) = (connector.next_event(v, &mut numbers), seen) {
            let (light, pmf) = (&scene.lights.as_slice()[l.light], f64::from(l.pmf));
            let nodes = join(&[], e, Some((l.wi, l.distance)), &[Vec::new(), dirac[1][..b - 1].to_vec()]);
            let path = FullPath { nodes, light, pmf, cos_light: cos_of(light, l.wi) };
            check.compare(&path, camera, 1, c.contribution);
        }
        // s = 0.
        if let (Some(c), Some((light, pmf)), true) = (connector.emission(v), v.light(scene), b > 1) {
            let nodes = join(&[], &e[..b - 1], Some((-v.wo, v.distance)), dirac);
            let (pmf, cos_light) = (f64::from(pmf), cos_of(light, v.wo));
            check.compare(&FullPath { nodes, light, pmf, cos_light }, camera, 0, c);
        }
    }
}

fn check_room(name: &'static str, scene: &Scene, camera: &Camera, techniques: Techniques, count: u64) -> Check {
    let merging = techniques.merging();
    let connector = Connector { scene, camera, merging, light_paths: LIGHT_PATHS };
    let mut check = Check { techniques, seen: Default::default(), worst: 0.0, name };
    for i in 0..count {
        let mut sampler = Sampler::new(3, Purpose::LightPath, 0, i, 0);
        let Some(start) = Start::light(scene, &mut sampler) else { continue };
        let Origin::Light { light, pmf } = start.origin else { unreachable!("a light path starts at a light") };
        let (light_path, light_dirac) = walk(scene, TransportMode::Importance, merging, &start, &mut sampler);
        let mut sampler = Sampler::new(3, Purpose::Camera, 0, i, 0);
        let [x, y] = sampler.next_2d();
        let view = Start::camera(camera, LIGHT_PATHS, camera.ray(x * 24.0, y * 24.0));
        let (camera_path, camera_dirac) = walk(scene, TransportMode::Radiance, merging, &view, &mut sampler);
        let dirac = [light_dirac, camera_dirac];
        let pmf = f64::from(pmf);
        // s ≥ 2 and t ≥ 2, and t = 1.
        for a in 1..=light_path.len() {
            let l = &light_path[..a];
            let cos_light = cos_of(light, start.ray.direction);
            if let Some((p, c)) = connector.lens(&l[a - 1]) {
                let mut nodes = join(l, &[], None, &dirac);
                nodes[a - 1].camera_side = (p.direction, p.distance);
                let path = FullPath { nodes, light, pmf, cos_light };
                check.compare(&path, camera, a + 1, c.contribution);
                let ray = Ray::new(l[a - 1].point.position, -p.direction);
                let seen = Start::camera(camera, LIGHT_PATHS, ray).arrived(&l[a - 1].point, p.distance, merging);
                let merged = Vertex { wo: p.direction, length: 1, quantities: seen, ..l[a - 1] };
                check.merge(&path, camera, &connector, &merged, &l[a - 1]);
            }
            for b in 1..=camera_path.len() {
                let e = &camera_path[..b];
                if !l[a - 1].is_connectible() || !e[b - 1].is_connectible() {
                    continue;
                }
                if let Some(c) = connector.connect(&e[b - 1], &l[a - 1]) {
                    let nodes = join(l, e, None, &dirac);
                    let path = FullPath { nodes, light, pmf, cos_light };
                    check.compare(&path, camera, a + 1, c.contribution);
                    if let Some(merged) = walked_on(&e[b - 1], &l[a - 1], merging) {
                        check.merge(&path, camera, &connector, &merged, &l[a - 1]);
                    }
                }
            }
        }
        check_camera_ends(&mut check, &connector, &camera_path, &dirac, i);
    }
    check
}

/// η from where merging hardly counts to where it is nearly all there is.
#[test]
fn recursive_weights_are_those_of_all_pdfs() {
    for (name, mut description) in transport::rooms() {
        let cameras = std::mem::take(&mut description.cameras);
        let bounds = builder::world_bounds(&description);
        let scene = builder::build(description).unwrap_or_else(|e| panic!("{name}: {e}"));
        let (camera, _) = builder::choose_camera(&cameras, bounds, &scene.space, &CameraChoice::First, 24, 24)
            .unwrap_or_else(|e| panic!("{name}: {e}"));
        let lit_by_area = scene.lights.area_count() > 0;
        for (connections, eta) in [(true, 0.0), (true, 1e-3), (true, 0.3), (true, 1e3), (false, 0.3)] {
            let techniques = Techniques { connections, eta };
            let check = check_room(name, &scene, &camera, techniques, 2000);
            println!("{name}, η = {eta}: worst {:.1e}, paths by edges and strategy: {:?}", check.worst, check.seen);
            for edges in 2..=LONGEST {
                let seen = check.seen[edges];
                let (by_connection, by_merging) = (0..=edges, edges + 1..=2 * edges - 1);
                if connections {
                    for s in by_connection.skip(usize::from(!lit_by_area)) {
                        assert!(seen[s] > 0, "{name}: no path of {edges} edges by s = {s}");
                    }
                }
                for j in by_merging {
                    assert!(eta == 0.0 || seen[j] > 0, "{name}: no path of {edges} edges by merging at {j}");
                }
            }
        }
    }
}

//! Metropolis light transport over bidirectional paths in primary sample space (Veach and Guibas 1997; Kelemen et al. 2002),
//! with the strategy as one of the sample's numbers (Hachisuka et al. 2014, "Multiplexed Metropolis Light Transport").
//!
//! A path is a function of numbers in [0, 1): the first chooses its length, the second its strategy (s, t), the rest make
//! the two sub-paths and their connection. A Markov chain walks over these numbers: large steps draw all of them anew, small
//! steps move each a little. Independent paths, those of the bootstrap and the large steps, fix the image's brightness, and the chains
//! start at some bootstrap paths, chosen in proportion to their luminance, which leaves no start-up bias (Veach 1997, §11.3.1).

use super::Bootstrap;
use super::connect::{Connection, Connector, Contribution};
use super::vertex::{Start, Vertex, Walk};
use crate::film::light_image::Mutations;
use crate::film::{Brightness, LightImage};
use crate::material::TransportMode;
use crate::math::primary::{Lane, PrimarySpace, Step};
use crate::math::sobol::Sampler;
use crate::math::{Numbers, Purpose, Rgb, Stream};
use crate::photon::EmissionRange;
use crate::scene::{Camera, Scene};
use crate::settings::RenderSettings;
use rayon::prelude::*;

/// Path lengths (in edges) up to this are equally likely; longer ones come from the tail.
const COMMON_LENGTHS: u32 = 8;
/// Share of the paths whose length comes from the tail, P(length ≥ k) = 1/k.
const TAIL: f64 = 0.2;

/// The integrator.
pub struct Mlt<'a> {
    scene: &'a Scene,
    connector: Connector<'a>,
    settings: &'a RenderSettings,
}

/// One path: where it lands on the film and what it carries.
#[derive(Clone, Copy, Debug, Default)]
struct Path {
    x: f32,
    y: f32,
    /// Radiance over the pdf of everything but the film's position; weighted by MIS.
    value: Rgb,
    rays: u32,
}

impl Path {
    /// The target function of the chains: positive wherever the value is.
    fn luminance(&self) -> f64 {
        let [r, g, b] = self.value.to_array().map(f64::from);
        (r + g + b) / 3.0
    }
}

/// A state of a chain, and how often it has counted since it was reached.
struct State {
    path: Path,
    weight: f64,
}

impl<'a> Mlt<'a> {
    /// For one job.
    pub fn new(scene: &'a Scene, camera: &'a Camera, settings: &'a RenderSettings) -> Self {
        Mlt { scene, connector: Connector::new(scene, camera), settings }
    }

    /// Luminances of bootstrap paths `range`, in order.
    pub fn bootstrap(&self, range: EmissionRange) -> Vec<f32> {
        let count = range.len() as usize;
        let path = |i: usize| self.path(&mut self.start(range.first + i as u64));
        (0..count).into_par_iter().map(|i| path(i).luminance() as f32).collect()
    }

    /// Runs chains `range` and adds what they visit to `light`: sums of radiance over luminance, one for each mutation.
    pub fn run(&self, bootstrap: &Bootstrap, range: EmissionRange, light: &mut LightImage) {
        let empty = LightImage::new(light.grid(), light.planes(), light.unit());
        let parts = range.len().min(rayon::current_num_threads() as u64) as u32;
        let part = |p: u32| {
            let mut own = empty.clone();
            let at = |p: u32| range.first + range.len() * u64::from(p) / u64::from(parts);
            (at(p)..at(p + 1)).for_each(|chain| self.chain(bootstrap, chain, &mut own));
            own
        };
        let images: Vec<LightImage> = (0..parts).into_par_iter().with_max_len(1).map(part).collect();
        for image in &images {
            // They were made alike.
            let _ = light.add(image);
        }
    }

    /// Number of mutations of all chains together.
    pub fn mutations(settings: &RenderSettings) -> u64 {
        u64::from(settings.mutations) * u64::from(settings.width) * u64::from(settings.height)
    }

    /// The factor that turns the sums of `chains` chains into an image of the bootstrap's brightness: pixels · b / mutations, where
    /// b is the mean luminance of independent paths (Veach 1997, eq. 11.7).
    pub fn scale(settings: &RenderSettings, bootstrap: &Bootstrap, chains: u32) -> f64 {
        let pixels = f64::from(settings.width) * f64::from(settings.height);
        let share = f64::from(chains) / f64::from(settings.chains);
        // The chains' share of all mutations, even where that is less than one each: the sum over all rounds is what counts.
        pixels * bootstrap.mean() / (Self::mutations(settings) as f64 * share)
    }

    /// The brightness of the image over that of the bootstrap. The large steps that the chains proposed are such paths as the
    /// bootstrap's are: with them the brightness gets better as long as the chains run.
    pub fn brightness(bootstrap: &Bootstrap, mutations: &Mutations) -> Brightness {
        let (first, steps) = (bootstrap.weights().len() as f64, mutations.large as f64);
        let mean = bootstrap.mean();
        if mean <= 0.0 {
            return Brightness::default();
        }
        let squares = bootstrap.relative_squares();
        let count = (first + steps).max(1.0);
        let factor = (first + mutations.large_sum()) / count;
        let variance = ((squares + mutations.large_squares()) / count - factor * factor).max(0.0) / count;
        let relative_variance = if factor > 0.0 { variance / (factor * factor) } else { 0.0 };
        Brightness { factor, relative_variance }
    }

    /// The numbers of bootstrap path `index`. The first number is stratified over all of them, so that neighbours have like
    /// lengths and a systematic choice among them gives every length its share.
    fn start(&self, index: u64) -> PrimarySpace {
        let mut stream = Stream::new(self.settings.seed, Purpose::Bootstrap, 0, index);
        let first = (index as f64 + f64::from(stream.next_f32())) / self.settings.bootstrap as f64;
        PrimarySpace::new(stream, first as f32)
    }

    fn chain(&self, bootstrap: &Bootstrap, chain: u64, light: &mut LightImage) {
        let settings = self.settings;
        let mut random = Stream::new(settings.seed, Purpose::Chain, 0, chain);
        // Systematic resampling: one chain in each of as many equal shares of the bootstrap's luminance. Where a limit is to end the job,
        // stratified for any number of the first chains; the second number fills the digits that the first does not have.
        let fine = f64::from(random.next_f32());
        let u = if settings.is_open_ended() {
            let share = Sampler::new(settings.seed, Purpose::Chain, 0, u64::MAX, chain).next_1d();
            f64::from(share) + fine / f64::from(1 << 24)
        } else {
            (chain as f64 + fine) / f64::from(settings.chains)
        };
        let Some(start) = bootstrap.sample(u) else { return };
        let mut space = self.start(start);
        let brightness = bootstrap.mean();
        let mut state = State { path: self.path(&mut space), weight: 0.0 };
        light.add_rays(u64::from(state.path.rays));
        space.accept();
        space.continue_with(random);
        let total = u128::from(Self::mutations(settings));
        let upto = |c: u64| (total * u128::from(c) / u128::from(settings.chains)) as u64;
        for _ in upto(chain)..upto(chain + 1) {
            self.mutate(&mut space, &mut state, brightness, light);
        }
        state.splat(light);
    }

    /// One mutation, accepted with probability min(1, luminance / current luminance). Both states count, each with the
    /// probability of being the next (Veach 1997, §11.3.3).
    fn mutate(&self, space: &mut PrimarySpace, state: &mut State, brightness: f64, light: &mut LightImage) {
        let step = space.propose(self.settings.large_step);
        let path = self.path(space);
        light.add_rays(u64::from(path.rays));
        let (proposed, current) = (path.luminance(), state.path.luminance());
        let finite = proposed.is_finite();
        light.add_non_finite(u64::from(!finite));
        let acceptance = if finite && proposed > 0.0 { (proposed / current).min(1.0) } else { 0.0 };
        state.weight += 1.0 - acceptance;
        let accepted = f64::from(space.random().next_f32()) < acceptance;
        light.count_mutation(step == Step::Large, accepted, if finite { proposed / brightness } else { 0.0 });
        if accepted {
            state.splat(light);
            *state = State { path, weight: acceptance };
            space.accept();
        } else {
            State { path, weight: acceptance }.splat(light);
            space.reject();
        }
    }

    /// The path of a point of the primary sample space: one strategy of one length, divided by the probability of both.
    fn path(&self, space: &mut PrimarySpace) -> Path {
        space.open(Lane::Connection);
        let [u_length, u_strategy] = space.next_2d();
        let (length, pmf) = choose_length(u_length, self.settings.max_depth);
        // Paths of one edge have one strategy; nothing else meets a light that the camera sees.
        let strategies = if length == 1 { 1 } else { length + 1 };
        let s = ((u_strategy * strategies as f32) as u32).min(strategies - 1);
        let t = length + 1 - s;
        let mut path = if t == 1 { self.path_of_light(space, s) } else { self.path_of_camera(space, s, t) };
        path.value *= (f64::from(strategies) / pmf) as f32;
        path
    }

    /// t = 1: the light sub-path's end seen by the camera.
    fn path_of_light(&self, space: &mut PrimarySpace, s: u32) -> Path {
        let (end, rays) = self.light_vertex(space, s);
        let mut path = Path { rays, ..Path::default() };
        if let Some((place, connection)) = end.and_then(|v| self.connector.lens(&v)) {
            path.rays += 1;
            (path.x, path.y) = (place.x, place.y);
            path.value = self.unblocked(&connection);
        }
        path
    }

    /// t ≥ 2: the camera sub-path's end on a light (s = 0), lit by one (s = 1), or joined to a light sub-path (s ≥ 2).
    fn path_of_camera(&self, space: &mut PrimarySpace, s: u32, t: u32) -> Path {
        let (width, height) = (self.settings.width as f32, self.settings.height as f32);
        space.open(Lane::Camera);
        let [u, v] = space.next_2d();
        let mut path =
            Path { x: (u * width).min(width.next_down()), y: (v * height).min(height.next_down()), ..Path::default() };
        let start = Start::camera(self.connector.camera, 1.0, self.connector.camera.ray(path.x, path.y));
        let (end, rays) = self.end_of(TransportMode::Radiance, &start, t - 1, space);
        path.rays = rays;
        let Some(end) = end else { return path };
        let connection = match s {
            0 => {
                path.value = self.connector.emission(&end).as_ref().map_or(Rgb::BLACK, Contribution::weighted);
                return path;
            }
            1 => {
                space.open(Lane::NextEvent);
                self.connector.next_event(&end, space)
            }
            _ => {
                let (light, rays) = self.light_vertex(space, s);
                path.rays += rays;
                light.filter(|_| end.is_connectible()).and_then(|l| self.connector.connect(&end, &l))
            }
        };
        if let Some(connection) = connection {
            path.rays += 1;
            path.value = self.unblocked(&connection);
        }
        path
    }

    /// Vertex s of a light sub-path (the first is the light itself), where it gets that far and can be connected.
    fn light_vertex(&self, space: &mut PrimarySpace, s: u32) -> (Option<Vertex>, u32) {
        space.open(Lane::Light);
        let Some(start) = Start::light(self.scene, space) else { return (None, 0) };
        let (end, rays) = self.end_of(TransportMode::Importance, &start, s - 1, space);
        (end.filter(Vertex::is_connectible), rays)
    }

    /// The `length`-th surface (≥ 1) of a walk from `start`, and the rays traced.
    fn end_of(
        &self,
        mode: TransportMode,
        start: &Start,
        length: u32,
        space: &mut PrimarySpace,
    ) -> (Option<Vertex>, u32) {
        let merging = self.connector.merging;
        let walk = Walk { scene: self.scene, mode, merging, max_length: length, roulette: false };
        let mut end = None;
        let rays = walk.run(start, space, |v, _| {
            if v.length == length {
                end = Some(*v);
            }
        });
        (end, rays)
    }

    fn unblocked(&self, connection: &Connection) -> Rgb {
        if self.scene.occluded(&connection.shadow) { Rgb::BLACK } else { connection.contribution.weighted() }
    }
}

impl State {
    /// Adds radiance over luminance, as often as the state counted.
    fn splat(&self, light: &mut LightImage) {
        let luminance = self.path.luminance();
        if self.weight > 0.0 && luminance > 0.0 {
            let value = self.path.value.to_array().map(|v| (f64::from(v) / luminance * self.weight) as f32);
            light.splat(0, self.path.x as u32, self.path.y as u32, value.into());
        }
    }
}

/// A path length in edges and its probability: usually one of 1 … 8, sometimes any, so that every length has its chance.
fn choose_length(u: f32, max_depth: Option<u32>) -> (u32, f64) {
    let common = max_depth.map_or(COMMON_LENGTHS, |d| d.min(COMMON_LENGTHS));
    let tail = if common < COMMON_LENGTHS || max_depth == Some(COMMON_LENGTHS) { 0.0 } else { TAIL };
    // P(length ≥ k) = 1/k, cut off at the largest length.
    let reach = 1.0 - max_depth.map_or(0.0, |d| 1.0 / (f64::from(d) + 1.0));
    let u = f64::from(u);
    let length = if u < 1.0 - tail {
        (1 + (u / (1.0 - tail) * f64::from(common)) as u32).min(common)
    } else {
        let v = (u - (1.0 - tail)) / tail * reach;
        ((1.0 / (1.0 - v)) as u32).clamp(1, max_depth.unwrap_or(u32::MAX))
    };
    let k = f64::from(length);
    let by_tail = if tail > 0.0 { tail / (k * (k + 1.0) * reach) } else { 0.0 };
    let by_common = if length <= common { (1.0 - tail) / f64::from(common) } else { 0.0 };
    (length, by_tail + by_common)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_come_as_often_as_their_probability_says() {
        for max_depth in [None, Some(1), Some(3), Some(8), Some(9), Some(40)] {
            let n = 1 << 20;
            let mut count = [0u32; 64];
            let mut pmf = [0.0f64; 64];
            for i in 0..n {
                let (length, p) = choose_length((i as f32 + 0.5) / n as f32, max_depth);
                assert!(max_depth.is_none_or(|d| length <= d));
                if (length as usize) < 64 {
                    count[length as usize] += 1;
                    pmf[length as usize] = p;
                }
            }
            for (k, (&c, &p)) in count.iter().zip(&pmf).enumerate() {
                // A regular grid of n points: each interval is off by two points at most.
                assert!((f64::from(c) - p * f64::from(n)).abs() <= 4.0, "{max_depth:?}: {k}: {c} {}", p * f64::from(n));
            }
            let total: f64 = pmf.iter().sum();
            let rest = if max_depth.is_none() { TAIL / 64.0 } else { 0.0 };
            assert!((total + rest - 1.0).abs() < 1e-9, "{max_depth:?} {total}");
        }
    }
}

//! The photon map against kiddo's `ImmutableKdTree`, per core: build, k-nearest and fixed-radius searches at 10⁷ surface
//! photons with a dense caustic, queries in image order; and what the renderer makes of them.
//!
//! First a table of ratios, both sides measured in turns by CPU time; then criterion's figures.
//! `GATHERLIGHT_BENCH_PHOTONS` sets another number of photons.

use criterion::{BenchmarkId, Criterion, SamplingMode, Throughput};
use gatherlight_render::math::{Purpose, Rgb, Stream, ops};
use gatherlight_render::photon::estimate::{Gather, choose_max_radius, irradiance_into, nearest_compatible};
use gatherlight_render::photon::grid::HashGrid;
use gatherlight_render::photon::kdtree::KdTree;
use gatherlight_render::photon::kernel::Kernel;
use gatherlight_render::photon::pack::{encode_normal, encode_rgbe};
use gatherlight_render::photon::query::{NeighbourBuffer, PhotonSearch};
use gatherlight_render::photon::{EmissionRange, MapKind, PhotonBatch, PhotonMap};
use glam::Vec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use std::hint::black_box;
use std::num::NonZero;
use std::time::{Duration, Instant};

const PHOTONS: usize = 10_000_000;
const NEIGHBOURS: [usize; 4] = [1, 50, 200, 500];
/// Photons wanted within the fixed radius, on average over the queries.
const WITHIN: usize = 144;
/// Pixels along a side of the image whose first hits are the queries.
const IMAGE_SIDE: usize = 256;
const TILE_SIDE: usize = 16;
/// Turns of each side in the table of ratios; the fastest counts.
const TURNS: usize = 3;

type Kiddo = ImmutableKdTree<f32, 3>;
type Point = [f32; 3];

/// A room, walls [−1, 1]³ without the front, and on its floor a caustic with three photons in ten, densest at its centre.
fn photons(count: usize) -> Vec<(Point, Vec3)> {
    let mut s = Stream::new(1, Purpose::Test, 0, 0);
    (0..count)
        .map(|_| {
            let [u, v] = s.next_2d();
            if s.next_f32() < 0.3 {
                let (radius, angle) = (0.3 * u * u, 2.0 * ops::PI * v);
                return ([0.2 + radius * ops::cos(angle), -1.0, 0.3 + radius * ops::sin(angle)], Vec3::Y);
            }
            let (u, v) = (2.0 * u - 1.0, 2.0 * v - 1.0);
            match s.next_u64() % 5 {
                0 => ([u, -1.0, v], Vec3::Y),
                1 => ([u, 1.0, v], -Vec3::Y),
                2 => ([-1.0, u, v], Vec3::X),
                3 => ([1.0, u, v], -Vec3::X),
                _ => ([u, v, 1.0], -Vec3::Z),
            }
        })
        .collect()
}

/// First hits of the pixels of an image of the room, tile by tile.
fn queries() -> Vec<(Point, Vec3)> {
    let mut s = Stream::new(2, Purpose::Test, 0, 0);
    let tiles = IMAGE_SIDE / TILE_SIDE;
    let mut hits = Vec::with_capacity(IMAGE_SIDE * IMAGE_SIDE);
    for i in 0..IMAGE_SIDE * IMAGE_SIDE {
        let (tile, pixel) = (i / (TILE_SIDE * TILE_SIDE), i % (TILE_SIDE * TILE_SIDE));
        let x = tile % tiles * TILE_SIDE + pixel % TILE_SIDE;
        let y = tile / tiles * TILE_SIDE + pixel / TILE_SIDE;
        let [u, v] = s.next_2d();
        let at = |p: usize, u: f32| (p as f32 + u) / IMAGE_SIDE as f32 * 2.0 - 1.0;
        let direction = Vec3::new(0.7 * at(x, u), -0.7 * at(y, v), 1.0);
        let origin = Vec3::new(0.0, 0.0, -1.4);
        let distance = (Vec3::ONE.copysign(direction) - origin) / direction;
        let t = distance.min_element();
        let normal = if t == distance.x {
            -Vec3::X.copysign(direction)
        } else if t == distance.y {
            -Vec3::Y.copysign(direction)
        } else {
            -Vec3::Z
        };
        hits.push(((origin + t * direction).to_array(), normal));
    }
    hits
}

struct Data {
    points: Vec<Point>,
    normals: Vec<Vec3>,
    queries: Vec<(Point, Vec3)>,
    tree: KdTree,
    kiddo: Kiddo,
    radius_squared: f32,
}

impl Data {
    fn new(count: usize) -> Self {
        let (points, normals): (Vec<_>, Vec<_>) = photons(count).into_iter().unzip();
        let queries = queries();
        let (tree, _) = KdTree::build(points.clone());
        let kiddo = Kiddo::new_from_slice(&points).expect("finite points");
        // The mean square radius of WITHIN neighbours.
        let mut buffer = NeighbourBuffer::new();
        let radii = queries.iter().step_by(64).map(|(q, _)| {
            tree.k_nearest(*q, WITHIN, f32::INFINITY, |_| true, &mut buffer);
            buffer.farthest().map_or(0.0, |n| n.distance_squared)
        });
        let radius_squared = radii.sum::<f32>() / queries.iter().step_by(64).count() as f32;
        Data { points, normals, queries, tree, kiddo, radius_squared }
    }

    /// Some of the queries, fewer for large k: whole tiles from the middle of the image on.
    fn some(&self, k: usize) -> &[(Point, Vec3)] {
        let count = (2_000_000 / (k + 20)).min(self.queries.len() / 2);
        &self.queries[self.queries.len() / 2..][..count]
    }
}

/// The farthest of the k nearest, summed over the queries.
fn our_nearest(data: &Data, k: usize, buffer: &mut NeighbourBuffer) -> f64 {
    let farthest = |q: Point, buffer: &mut NeighbourBuffer| {
        if k == 1 {
            return data.tree.nearest(q, f32::INFINITY, |_| true);
        }
        data.tree.k_nearest(q, k, f32::INFINITY, |_| true, buffer);
        buffer.farthest()
    };
    data.some(k).iter().map(|(q, _)| farthest(*q, buffer).map_or(0.0, |n| f64::from(n.distance_squared))).sum()
}

fn kiddo_nearest(data: &Data, k: usize) -> f64 {
    let Some(count) = NonZero::new(k) else { return 0.0 };
    let farthest = |q: &Point| {
        if k == 1 {
            return data.kiddo.query(q).nearest_one::<SquaredEuclidean<f32>>().execute().distance;
        }
        let found = data.kiddo.query(q).nearest_n::<SquaredEuclidean<f32>>(count).unsorted().execute();
        found.iter().map(|n| n.distance).fold(0.0, f32::max)
    };
    data.some(k).iter().map(|(q, _)| f64::from(farthest(q))).sum()
}

fn our_within(data: &Data, search: &impl PhotonSearch) -> u64 {
    let mut found = 0;
    for (q, _) in data.some(WITHIN) {
        search.for_each_within(*q, data.radius_squared, |_| found += 1);
    }
    found
}

fn kiddo_within(data: &Data) -> u64 {
    let within = |q| data.kiddo.query(q).within::<SquaredEuclidean<f32>>(data.radius_squared).unsorted().execute();
    data.some(WITHIN).iter().map(|(q, _)| within(q).len() as u64).sum()
}

/// CPU time of this thread where the system tells it (Linux), else the time of day.
fn now() -> Duration {
    static START: std::sync::LazyLock<Instant> = std::sync::LazyLock::new(Instant::now);
    let ran = || std::fs::read_to_string("/proc/thread-self/schedstat").ok()?.split_whitespace().next()?.parse().ok();
    ran().map_or_else(|| START.elapsed(), Duration::from_nanos)
}

fn timed<R>(work: impl FnOnce() -> R) -> (f64, R) {
    let start = now();
    let result = black_box(work());
    ((now() - start).as_secs_f64(), result)
}

/// Runs both sides in turns and prints their best rates and the ratio; both results must agree.
fn compare<R: PartialEq + std::fmt::Debug>(name: &str, work: usize, ours: impl Fn() -> R, kiddos: impl Fn() -> R) {
    let (mut best, mut best_kiddo) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..TURNS {
        let (a, ours) = timed(&ours);
        let (b, theirs) = timed(&kiddos);
        assert_eq!(ours, theirs, "{name}: the two sides found different photons");
        (best, best_kiddo) = (best.min(a), best_kiddo.min(b));
    }
    let rate = |seconds: f64| work as f64 / seconds * 1e-3;
    println!("{name:24} {:10.1} k/s   kiddo {:10.1} k/s   {:5.2} ×", rate(best), rate(best_kiddo), best_kiddo / best);
}

fn ratios(data: &Data) {
    println!("{} photons, one thread", data.points.len());
    let size = data.points.len();
    let kiddo = || Kiddo::new_from_slice(&data.points).map_or(0, |t| t.size());
    compare("build", size, || KdTree::build(data.points.clone()).0.len(), kiddo);
    for k in NEIGHBOURS {
        // The sums agree but for the last bits: kiddo adds the squares in another order.
        let round = |sum: f64| (sum * 1e4).round();
        let ours = || round(our_nearest(data, k, &mut NeighbourBuffer::new()));
        compare(&format!("k = {k}"), data.some(k).len(), ours, || round(kiddo_nearest(data, k)));
    }
    let rough = |found: u64| found / 1000;
    let count = data.some(WITHIN).len();
    compare("within, tree", count, || rough(our_within(data, &data.tree)), || rough(kiddo_within(data)));
    let (grid, _) = HashGrid::build(&data.points, data.radius_squared.sqrt());
    compare("within, hash grid", count, || rough(our_within(data, &grid)), || rough(kiddo_within(data)));
    println!("mean found within: {:.1}", our_within(data, &data.tree) as f64 / count as f64);
}

/// Photons of the data as a map, each of power 1.
fn map_of(data: &Data) -> PhotonMap {
    let count = data.points.len();
    let batch = PhotonBatch {
        range: EmissionRange { first: 0, end: count as u64 },
        positions: data.points.clone(),
        powers: vec![encode_rgbe(Rgb::WHITE); count],
        normals: data.normals.iter().map(|&n| encode_normal(n)).collect(),
        vertices: None,
        non_finite: 0,
    };
    PhotonMap::build(MapKind::Global, batch)
}

fn searches(c: &mut Criterion, data: &Data) {
    let mut group = c.benchmark_group("photon_map/k_nearest");
    group.sampling_mode(SamplingMode::Flat).sample_size(10).measurement_time(Duration::from_secs(3));
    for k in NEIGHBOURS {
        group.throughput(Throughput::Elements(data.some(k).len() as u64));
        let mut buffer = NeighbourBuffer::new();
        group.bench_function(BenchmarkId::new("ours", k), |b| b.iter(|| our_nearest(data, k, &mut buffer)));
        group.bench_function(BenchmarkId::new("kiddo", k), |b| b.iter(|| kiddo_nearest(data, k)));
    }
    group.throughput(Throughput::Elements(data.some(WITHIN).len() as u64));
    group.bench_function("within/ours", |b| b.iter(|| our_within(data, &data.tree)));
    group.bench_function("within/kiddo", |b| b.iter(|| kiddo_within(data)));
    group.finish();
}

/// Irradiance at some of the queries.
fn irradiances(data: &Data, map: &PhotonMap, gather: &Gather) -> f32 {
    let mut buffer = NeighbourBuffer::new();
    let at = |&(q, n): &(Point, Vec3)| irradiance_into(map, Vec3::from(q), n, gather, &mut buffer);
    data.some(gather.k as usize).iter().map(at).map(|e| e.irradiance.g).sum()
}

fn default_gather(map: &PhotonMap, k: u32) -> Gather {
    let radius = choose_max_radius(map, k);
    Gather { k, max_radius_squared: radius * radius, kernel: Kernel::Constant }
}

/// CPU time of what the renderer asks for, beside the bare searches.
fn estimate_rates(data: &Data, map: &PhotonMap) {
    for k in [50, 200] {
        let gather = default_gather(map, k);
        let best = (0..TURNS).map(|_| timed(|| irradiances(data, map, &gather)).0).fold(f64::INFINITY, f64::min);
        println!("irradiance, k = {k:<8} {:10.1} k/s", data.some(k as usize).len() as f64 / best * 1e-3);
    }
}

fn estimates(c: &mut Criterion, data: &Data, map: &PhotonMap) {
    let mut group = c.benchmark_group("photon_map/estimate");
    group.sampling_mode(SamplingMode::Flat).sample_size(10).measurement_time(Duration::from_secs(3));
    for k in [50, 200] {
        let gather = default_gather(map, k);
        group.throughput(Throughput::Elements(data.some(k as usize).len() as u64));
        group.bench_function(BenchmarkId::new("irradiance", k), |b| b.iter(|| irradiances(data, map, &gather)));
    }
    let queries = data.some(1);
    group.throughput(Throughput::Elements(queries.len() as u64));
    group.bench_function("nearest_compatible", |b| {
        b.iter(|| {
            queries
                .iter()
                .filter_map(|&(q, n)| nearest_compatible(map.tree(), map.packed_normals(), Vec3::from(q), n, 0.01))
                .count()
        })
    });
    group.finish();
}

fn builds(c: &mut Criterion, data: &Data) {
    let mut group = c.benchmark_group("photon_map/build");
    group.sampling_mode(SamplingMode::Flat).sample_size(10).measurement_time(Duration::from_secs(10));
    group.throughput(Throughput::Elements(data.points.len() as u64));
    group.bench_function("ours", |b| b.iter(|| KdTree::build(data.points.clone())));
    group.bench_function("kiddo", |b| b.iter(|| Kiddo::new_from_slice(&data.points).expect("finite points")));
    group.bench_function("hash grid", |b| b.iter(|| HashGrid::build(&data.points, data.radius_squared.sqrt())));
    group.finish();
}

fn main() {
    // One thread for both sides: kiddo builds on rayon's pool too.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global();
    pool.expect("the first use of the pool");
    let count = std::env::var("GATHERLIGHT_BENCH_PHOTONS").ok().and_then(|v| v.parse().ok()).unwrap_or(PHOTONS);
    let data = Data::new(count);
    let map = map_of(&data);
    ratios(&data);
    estimate_rates(&data, &map);
    let mut criterion = Criterion::default().configure_from_args();
    searches(&mut criterion, &data);
    estimates(&mut criterion, &data, &map);
    builds(&mut criterion, &data);
    criterion.final_summary();
}

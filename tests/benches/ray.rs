//! Rays per second: camera, bounce and shadow rays in a room of half a million triangles and among spheres, and the
//! time to build.
//!
//! With `GATHERLIGHT_RAYS=DIR` in the environment it writes `DIR/SCENE.rays` instead, times each set of rays a few times
//! on one thread, and prints `scene set Mray/s hits`, for comparison with `tests/peers/embree_rays.cpp`.

#![allow(missing_docs)] // criterion_group! makes a public function.

#[path = "ray/scenes.rs"]
mod scenes;

use criterion::{BatchSize, Criterion, Throughput, criterion_group};
use gatherlight_render::geometry::{Accelerator, Instance, Mesh, Ray, SurfacePoint};
use gatherlight_render::math::frame::Frame;
use gatherlight_render::math::rng::{Purpose, Stream};
use gatherlight_render::math::warp;
use glam::Vec3;
use std::hint::black_box;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// Camera rays per side of the image.
const SIDE: u32 = 512;

/// Rays of one kind.
struct RaySet {
    name: &'static str,
    shadow: bool,
    rays: Vec<Ray>,
}

/// A mesh with its structure and rays.
struct Subject {
    name: &'static str,
    mesh: Arc<Mesh>,
    accelerator: Accelerator,
    sets: Vec<RaySet>,
}

fn build(mesh: &Arc<Mesh>) -> Accelerator {
    let instance = Instance { mesh: 0, transform: None, first_emitter: None };
    Accelerator::build(std::slice::from_ref(mesh), &[instance])
}

impl Subject {
    fn new(name: &'static str, mesh: Mesh, eye: Vec3, target: Vec3, light: [Vec3; 2]) -> Self {
        let mesh = Arc::new(mesh);
        let accelerator = build(&mesh);
        let frame = Frame::from_normal((target - eye).normalize());
        let pixel = |i: u32| (i as f32 + 0.5) / SIDE as f32 * 2.0 - 1.0;
        let pixels = (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y)));
        let camera: Vec<Ray> = pixels
            .map(|(x, y)| Ray::new(eye, frame.to_scene(Vec3::new(pixel(x), pixel(y), 1.2).normalize())))
            .collect();
        let mut sets = vec![RaySet { name: "camera", shadow: false, rays: camera }];
        let mut rays = sets[0].rays.clone();
        for (depth, name) in ["bounce", "second bounce"].into_iter().enumerate() {
            let (bounces, shadows) = scatter(&mesh, &accelerator, &rays, light, depth as u32);
            if depth == 0 {
                sets.push(RaySet { name: "shadow", shadow: true, rays: shadows });
            }
            sets.push(RaySet { name, shadow: false, rays: bounces.clone() });
            rays = bounces;
        }
        Subject { name, mesh, accelerator, sets }
    }

    fn all() -> Vec<Self> {
        let (eye, target) = (Vec3::new(-1.2, 0.1, -0.9), Vec3::new(0.6, -0.3, 0.4));
        let light = [Vec3::new(-0.4, 0.55, -0.4), Vec3::new(0.4, 0.55, 0.4)];
        let open_light = [Vec3::new(-0.25, 0.97, -0.25), Vec3::new(0.25, 0.97, 0.25)];
        vec![
            Subject::new("interior", scenes::interior(), eye, target, light),
            Subject::new(
                "spheres",
                scenes::spheres(),
                Vec3::new(0.0, 0.0, -0.95),
                Vec3::new(0.0, -0.3, 0.0),
                open_light,
            ),
        ]
    }
}

/// Cosine-distributed rays from where `rays` hit, and rays from there to points of a horizontal light.
fn scatter(mesh: &Mesh, scene: &Accelerator, rays: &[Ray], light: [Vec3; 2], round: u32) -> (Vec<Ray>, Vec<Ray>) {
    let instance = Instance { mesh: 0, transform: None, first_emitter: None };
    let (mut bounces, mut shadows) = (Vec::new(), Vec::new());
    for (i, ray) in rays.iter().enumerate() {
        let s = &mut Stream::new(5, Purpose::Test, round, i as u64);
        let Some(hit) = scene.closest_hit(ray) else { continue };
        let surface = SurfacePoint::from_hit(mesh, &instance, &hit);
        let normal = if surface.ng.dot(ray.direction) > 0.0 { -surface.ng } else { surface.ng };
        let direction = Frame::from_normal(normal).to_scene(warp::cosine_hemisphere(s.next_2d())).normalize();
        bounces.push(Ray::new(surface.spawn(direction), direction));
        let [u, v] = s.next_2d();
        let to_light = light[0] + (light[1] - light[0]) * Vec3::new(u, 0.0, v) - surface.position;
        let direction = to_light.normalize();
        shadows.push(Ray::segment(surface.spawn(direction), direction, to_light.length() * 0.999));
    }
    (bounces, shadows)
}

/// Traces a set and counts the hits.
fn trace(scene: &Accelerator, set: &RaySet) -> usize {
    if set.shadow {
        set.rays.iter().filter(|ray| scene.occluded(black_box(ray))).count()
    } else {
        set.rays.iter().filter(|ray| scene.closest_hit(black_box(ray)).is_some()).count()
    }
}

fn bench(c: &mut Criterion) {
    for subject in Subject::all() {
        let mut group = c.benchmark_group(subject.name);
        group.sample_size(10);
        for set in &subject.sets {
            group.throughput(Throughput::Elements(set.rays.len() as u64));
            group.bench_function(set.name, |b| b.iter(|| trace(&subject.accelerator, set)));
        }
        group.throughput(Throughput::Elements(subject.mesh.triangles.len() as u64));
        group.bench_function("build", |b| {
            b.iter_batched(|| subject.mesh.clone(), |mesh| build(&mesh), BatchSize::LargeInput)
        });
        group.finish();
    }
}

/// Writes the triangles and rays: count, 9 floats each; then for each set a name of 16 bytes, whether they are shadow
/// rays, their count, and origin, direction, t_max of each. Little-endian; counts are u64.
fn write_rays(subject: &Subject, directory: &Path) -> std::io::Result<()> {
    let path = directory.join(format!("{}.rays", subject.name));
    let mut out = std::io::BufWriter::new(std::fs::File::create(path)?);
    let mut write = |bytes: &[u8]| out.write_all(bytes);
    write(&(subject.mesh.triangles.len() as u64).to_le_bytes())?;
    for triangle in &subject.mesh.triangles {
        for x in triangle.iter().flat_map(|&v| subject.mesh.positions[v as usize].to_array()) {
            write(&x.to_le_bytes())?;
        }
    }
    write(&(subject.sets.len() as u64).to_le_bytes())?;
    for set in &subject.sets {
        let mut name = [0; 16];
        name[..set.name.len()].copy_from_slice(set.name.as_bytes());
        write(&name)?;
        write(&u64::from(set.shadow).to_le_bytes())?;
        write(&(set.rays.len() as u64).to_le_bytes())?;
        for ray in &set.rays {
            for x in ray.origin.to_array().into_iter().chain(ray.direction.to_array()).chain([ray.t_max]) {
                write(&x.to_le_bytes())?;
            }
        }
    }
    out.flush()
}

/// CPU seconds of this process, where the system tells, so that other work on the machine does not count; else seconds.
fn cpu_seconds(since: Instant) -> f64 {
    let nanoseconds = |task: std::fs::DirEntry| -> Option<f64> {
        let text = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
        text.split(' ').next()?.parse().ok()
    };
    let tasks = std::fs::read_dir("/proc/self/task");
    let sum: f64 = tasks.into_iter().flatten().flatten().filter_map(nanoseconds).sum();
    if sum > 0.0 { sum * 1e-9 } else { since.elapsed().as_secs_f64() }
}

/// The best of a few runs, in millions of rays a second, printed with the hits.
fn time_sets(subject: &Subject) {
    let triangles = subject.mesh.triangles.len();
    let epoch = Instant::now();
    let started = cpu_seconds(epoch);
    let scene = build(&subject.mesh);
    let seconds = cpu_seconds(epoch) - started;
    let (rate, bytes) = (triangles as f64 / seconds * 1e-6, scene.memory_bytes() as f64 / triangles as f64);
    println!("{} build {rate:.3} {triangles} {bytes:.1}", subject.name);
    for set in &subject.sets {
        let mut best = f64::INFINITY;
        let mut hits = 0;
        for _ in 0..7 {
            let started = cpu_seconds(epoch);
            hits = trace(&subject.accelerator, set);
            best = best.min(cpu_seconds(epoch) - started);
        }
        let rate = set.rays.len() as f64 / best * 1e-6;
        println!("{} {} {rate:.3} {hits}", subject.name, set.name.replace(' ', "_"));
    }
}

criterion_group!(benches, bench);

fn main() {
    if let Some(directory) = std::env::var_os("GATHERLIGHT_RAYS") {
        for subject in Subject::all() {
            write_rays(&subject, Path::new(&directory)).expect("a writable directory");
            time_sets(&subject);
        }
        return;
    }
    benches();
    Criterion::default().configure_from_args().final_summary();
}

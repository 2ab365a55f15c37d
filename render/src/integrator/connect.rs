//! Connections of sub-paths, each with its weight among all strategies that make the same path (Veach 1997, §10;
//! Georgiev 2012, "Implementing Vertex Connection and Merging", §4).

use super::direct::LightDirection;
use super::vertex::{Merging, Vertex, power};
use crate::geometry::Ray;
use crate::material::{Scatter, TransportMode};
use crate::math::{Numbers, Rgb};
use crate::scene::camera::Projection;
use crate::scene::{Camera, Scene};
use glam::Vec3;

/// What one strategy gives for one path.
#[derive(Clone, Copy, Debug)]
pub struct Contribution {
    /// Radiance (of the pixel sample) if this were the only strategy: contribution over pdf.
    pub value: Rgb,
    /// Weight of the strategy among all that make this path, in [0, 1].
    pub weight: f32,
}

impl Contribution {
    /// What the strategy adds to the image.
    #[inline]
    pub fn weighted(&self) -> Rgb {
        self.value * self.weight
    }
}

/// A contribution that counts if nothing blocks the ray between its sub-paths.
#[derive(Clone, Copy, Debug)]
pub struct Connection {
    /// What it gives.
    pub contribution: Contribution,
    /// The ray to test.
    pub shadow: Ray,
}

/// Makes full paths from the vertices of sub-paths.
#[derive(Clone, Copy)]
pub struct Connector<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// The camera.
    pub camera: &'a Camera,
    /// How merging counts.
    pub merging: Merging,
    /// Light paths traced for each camera sample of a pixel.
    pub light_paths: f64,
}

/// One end of a connection: a vertex seen along `wi`, away from it.
struct End {
    /// BSDF and cosine; for light vertices with the adjoint correction.
    value: Rgb,
    /// pdf per solid angle of going on along `wi`.
    forward: f32,
    /// pdf per solid angle with which a path that comes along `wi` goes back along the sub-path.
    reverse: f32,
}

impl End {
    #[inline]
    fn new(v: &Vertex, wi: Vec3, mode: TransportMode) -> Option<End> {
        let (f, forward) = v.bsdf.eval_pdf(v.wo, wi, mode);
        if f.is_black() {
            return None;
        }
        let correction = match mode {
            TransportMode::Radiance => 1.0,
            TransportMode::Importance => v.bsdf.importance_correction(v.wo, wi),
        };
        let value = f * (v.bsdf.cos(wi) * correction) * v.throughput;
        let (_, reverse) = v.bsdf.eval_pdf(wi, v.wo, mode.reversed());
        Some(End { value, forward, reverse })
    }

    /// Σ (pᵢ/p)² over the strategies that move the connection along this sub-path, over that of moving it onto `v` by
    /// sampling from the other side.
    #[inline]
    fn rest(&self, v: &Vertex, merging: Merging) -> f64 {
        merging.vm + v.quantities.vcm + v.quantities.vc * power(f64::from(self.reverse))
    }
}

impl<'a> Connector<'a> {
    /// Connections only, with one light path for each camera sample.
    pub fn new(scene: &'a Scene, camera: &'a Camera) -> Self {
        Connector { scene, camera, merging: Merging::NONE, light_paths: 1.0 }
    }

    /// s = 0: the camera vertex `v` lies on a light (ibid. eqs. 43 and 47).
    #[inline]
    pub fn emission(&self, v: &Vertex) -> Option<Contribution> {
        let radiance = self.scene.emission(&v.point, v.wo);
        if radiance.is_black() {
            return None;
        }
        let value = v.throughput * radiance;
        // Nothing else makes a path of one edge.
        if v.length == 1 {
            return Some(Contribution { value, weight: 1.0 });
        }
        let others = v.light(self.scene).map_or(0.0, |(light, pmf)| {
            let (pmf, cos) = (f64::from(pmf), f64::from(v.bsdf.cos_geometric(v.wo)));
            let d = f64::from(v.distance);
            let direct = if v.quantities.vcm > 0.0 {
                pmf * f64::from(light.pdf_li(v.from, -v.wo, v.distance)) * cos / (d * d)
            } else {
                0.0
            };
            let emission = pmf * light.landing_density(v.wo, v.distance) * cos;
            power(direct) * v.quantities.vcm + power(emission) * v.quantities.vc
        });
        Some(Contribution { value, weight: weight(others) })
    }

    /// s = 1: next-event estimation from the camera vertex `v` (ibid. eqs. 44 and 48). Always takes three numbers.
    #[inline]
    pub fn next_event(&self, v: &Vertex, numbers: &mut impl Numbers) -> Option<Connection> {
        let scene = self.scene;
        let l = LightDirection::sample(scene, &v.point, numbers)?;
        if !v.is_connectible() {
            return None;
        }
        let end = End::new(v, l.wi, TransportMode::Radiance)?;
        let body = v.interior.leaving(scene, &v.point, v.wo, l.wi);
        let value = end.value * l.weighted_radiance * body.transmittance(scene, l.distance);
        let light = scene.lights.get(l.light)?;
        let landing = light.landing_density(-l.wi, l.distance) * f64::from(v.bsdf.cos_geometric(l.wi));
        let (by_bsdf, pdf_li) = if light.is_dirac() {
            (0.0, 1.0)
        } else {
            (power(f64::from(end.forward) / f64::from(l.pdf)), f64::from(l.pdf) / f64::from(l.pmf))
        };
        let by_light = power(landing / pdf_li) * end.rest(v, self.merging);
        Some(Connection { contribution: Contribution { value, weight: weight(by_bsdf + by_light) }, shadow: l.shadow })
    }

    /// t = 1: the light vertex `v` seen by the camera, and where on the film (ibid. eqs. 46 and 49).
    #[inline]
    pub fn lens(&self, v: &Vertex) -> Option<(Projection, Connection)> {
        let scene = self.scene;
        if !v.is_connectible() {
            return None;
        }
        let p = self.camera.project(v.point.position)?;
        let end = End::new(v, p.direction, TransportMode::Importance)?;
        let body = v.interior.leaving(scene, &v.point, v.wo, p.direction);
        let scale = (p.density / self.light_paths) as f32;
        let value = end.value * scale * body.transmittance(scene, p.distance);
        let seen = p.density * f64::from(v.bsdf.cos_geometric(p.direction)) / self.light_paths;
        let others = power(seen) * end.rest(v, self.merging);
        let target = v.point.position + p.direction * p.distance;
        let shadow = shadow_ray(v.point.spawn(p.direction), target)?;
        Some((p, Connection { contribution: Contribution { value, weight: weight(others) }, shadow }))
    }

    /// s, t ≥ 2: the camera vertex `c` joined to the light vertex `l` (ibid. eqs. 40 and 41).
    #[inline]
    pub fn connect(&self, c: &Vertex, l: &Vertex) -> Option<Connection> {
        let scene = self.scene;
        let d = l.point.position - c.point.position;
        let distance = d.length();
        if distance == 0.0 {
            return None;
        }
        let wi = d / distance;
        let camera = End::new(c, wi, TransportMode::Radiance)?;
        let light = End::new(l, -wi, TransportMode::Importance)?;
        let to_light = c.interior.leaving(scene, &c.point, c.wo, wi);
        let body = to_light.or(l.interior.leaving(scene, &l.point, l.wo, -wi));
        let inverse = distance.recip();
        let value = camera.value * (inverse * inverse) * light.value * body.transmittance(scene, distance);
        let square = f64::from(distance) * f64::from(distance);
        let onto_light = f64::from(camera.forward) * f64::from(l.bsdf.cos_geometric(wi)) / square;
        let onto_camera = f64::from(light.forward) * f64::from(c.bsdf.cos_geometric(wi)) / square;
        let others =
            power(onto_light) * light.rest(l, self.merging) + power(onto_camera) * camera.rest(c, self.merging);
        let origin = c.point.spawn(wi);
        let shadow = shadow_ray(origin, l.point.arrival(origin))?;
        Some(Connection { contribution: Contribution { value, weight: weight(others) }, shadow })
    }

    /// Merging the camera vertex `c` with a light vertex on its surface: light of `power` from `wi`, whose shares √dVCM and
    /// √dVM are `shares` (ibid. eqs. 42, 50 and 51). The value is over the density of light vertices, still to be divided by
    /// their emitted number and the area of the disc.
    #[inline]
    pub fn merge(&self, c: &Vertex, wi: Vec3, light: Rgb, shares: [f64; 2]) -> Option<Contribution> {
        let (f, forward) = c.bsdf.eval_pdf(c.wo, wi, TransportMode::Radiance);
        if f.is_black() {
            return None;
        }
        let (_, reverse) = c.bsdf.eval_pdf(wi, c.wo, TransportMode::Importance);
        let [vcm, vm] = shares.map(power);
        let by_light = vcm * self.merging.vc + vm * power(f64::from(forward));
        let by_camera = c.quantities.vcm * self.merging.vc + c.quantities.vm * power(f64::from(reverse));
        Some(Contribution { value: c.throughput * f * light, weight: weight(by_light + by_camera) })
    }
}

/// The weight of a strategy, given Σ (pᵢ/p)² over all others.
#[inline]
fn weight(others: f64) -> f32 {
    (1.0 / (1.0 + others)) as f32
}

/// The ray between two points already off their surfaces.
#[inline]
fn shadow_ray(origin: Vec3, target: Vec3) -> Option<Ray> {
    let span = target - origin;
    let length = span.length();
    (length > 0.0).then(|| Ray::segment(origin, span * length.recip(), length))
}

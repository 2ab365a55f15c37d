use super::*;
use crate::math::{Purpose, Stream, ops, warp};
use crate::photon::pack::{encode_direction, encode_normal, encode_rgbe};
use crate::photon::{EmissionRange, MapKind, PhotonBatch};

const KERNELS: [Kernel; 3] = [Kernel::Constant, Kernel::Cone, Kernel::Epanechnikov];

/// A map of photons of equal power 1 with the given positions and normals, out of `emitted` paths.
fn map_of(photons: impl IntoIterator<Item = (Vec3, Vec3)>, emitted: u64) -> PhotonMap {
    let mut b = PhotonBatch::new(EmissionRange { first: 0, end: emitted }, true);
    for (p, n) in photons {
        b.positions.push(p.to_array());
        b.powers.push(encode_rgbe(Rgb::WHITE));
        b.normals.push(encode_normal(n));
        let v = b.vertices.as_mut().unwrap();
        v.directions.push(encode_direction(n));
        v.shares.push([0.0; 2]);
        v.lengths.push(1);
    }
    PhotonMap::build(MapKind::Global, b)
}

/// A Poisson process of mean `mean` photons on the square [−1, 1]² of the plane y = 0.
fn poisson_plane(seed: u64, mean: f32) -> Vec<(Vec3, Vec3)> {
    let mut s = Stream::new(seed, Purpose::Test, 1, 0);
    let mut photons = vec![];
    // Exponential gaps.
    let mut at = -ops::ln(1.0 - s.next_f32());
    while at < mean {
        let [u, v] = s.next_2d();
        photons.push((Vec3::new(2.0 * u - 1.0, 0.0, 2.0 * v - 1.0), Vec3::Y));
        at -= ops::ln(1.0 - s.next_f32());
    }
    photons
}

/// Mean of irradiance / truth over Poisson planes, and its standard error; each value is cut at `limit`.
fn mean_on_plane(gather: &Gather, photons: f32, seeds: u64, limit: f64) -> (f64, f64) {
    let (mut sum, mut squares) = (0.0, 0.0);
    for seed in 0..seeds {
        let map = map_of(poisson_plane(seed, photons), 1);
        let e = f64::from(irradiance(&map, Vec3::ZERO, Vec3::Y, gather).irradiance.g) / (f64::from(photons) / 4.0);
        sum += e.min(limit);
        squares += e.min(limit).powi(2);
    }
    let n = seeds as f64;
    let mean = sum / n;
    (mean, ((squares / n - mean * mean) / n).sqrt())
}

#[test]
fn k_nearest_estimates_of_a_uniform_plane_are_unbiased() {
    for kernel in KERNELS {
        for (k, photons, seeds) in [(3, 50.0, 6000), (5, 60.0, 6000), (50, 400.0, 2000)] {
            let gather = Gather { k, max_radius_squared: 1.0, kernel };
            let (mean, error) = mean_on_plane(&gather, photons, seeds, f64::INFINITY);
            assert!((mean - 1.0).abs() < 4.0 * error, "{kernel:?} k {k}: {mean} ± {error}");
            assert!(error < 0.03);
        }
    }
}

#[test]
fn two_nearest_photons_have_the_gamma_law_they_should() {
    // With k = 2 the estimate is λ/G, G ~ Gamma(2): mean 1, variance infinite. Cut at c its mean is c (1 − e^(−1/c)).
    let gather = Gather { k: 2, max_radius_squared: 1.0, kernel: Kernel::Constant };
    for c in [2.0f64, 20.0] {
        let (mean, error) = mean_on_plane(&gather, 40.0, 20_000, c);
        let expect = c * (1.0 - (-1.0 / c).exp());
        assert!((mean - expect).abs() < 4.0 * error, "{mean} ± {error}, not {expect}");
    }
}

#[test]
fn estimates_that_often_run_out_of_photons_stay_unbiased() {
    // The largest disc holds 50 photons on average: half of the estimates are k-nearest, half fixed-radius.
    let radius_squared = 50.0 / (100.0 * std::f32::consts::PI);
    for kernel in KERNELS {
        for k in [30, 50, 70] {
            let gather = Gather { k, max_radius_squared: radius_squared, kernel };
            let (mean, error) = mean_on_plane(&gather, 400.0, 2000, f64::INFINITY);
            assert!((mean - 1.0).abs() < 4.0 * error, "{kernel:?} {k}: {mean} ± {error}");
        }
    }
}

#[test]
fn senseless_radii_give_finite_estimates() {
    let map = map_of(poisson_plane(21, 100.0).into_iter().chain([(Vec3::ZERO, Vec3::Y)]), 1);
    for max_radius_squared in [0.0, -1.0, f32::NAN, 1e-45, f32::INFINITY, f32::MAX] {
        let e = irradiance(&map, Vec3::ZERO, Vec3::Y, &Gather { k: 500, max_radius_squared, kernel: Kernel::Cone });
        assert!(e.irradiance.is_finite() && e.count > 0, "{max_radius_squared} {e:?}");
    }
}

#[test]
fn a_hash_grid_gives_the_fixed_radius_estimate_of_the_tree() {
    let plain = map_of(poisson_plane(20, 4000.0), 5);
    let hashed = map_of(poisson_plane(20, 4000.0), 5);
    hashed.enable_hash_grid(0.1);
    let gather = Gather { k: 20, max_radius_squared: 0.01, kernel: Kernel::Epanechnikov };
    for i in 0..200 {
        let q = plain.position(i * 7) + Vec3::new(0.001, 0.0, 0.002);
        let tree = irradiance_within(&plain, q, Vec3::Y, 0.01, Kernel::Epanechnikov);
        let grid = irradiance(&hashed, q, Vec3::Y, &gather);
        assert_eq!((tree.count, tree.radius), (grid.count, grid.radius));
        assert!((tree.irradiance.r / grid.irradiance.r - 1.0).abs() < 1e-6);
    }
}

#[test]
fn a_curved_surface_is_estimated_without_bias_at_a_large_radius() {
    let mut s = Stream::new(5, Purpose::Test, 0, 0);
    let (radius, count, k) = (0.5f32, 20_000u32, 1500);
    let normals: Vec<Vec3> = (0..count).map(|_| warp::uniform_sphere(s.next_2d())).collect();
    let map = map_of(normals.iter().map(|&n| (n * radius, n)), 1);
    let truth = count as f32 / (4.0 * ops::PI * radius * radius);
    for kernel in KERNELS {
        let gather = Gather { k, max_radius_squared: 1.0, kernel };
        let (queries, mut sum) = (400, 0.0f64);
        for _ in 0..queries {
            let n = warp::uniform_sphere(s.next_2d());
            let e = irradiance(&map, n * radius, n, &gather);
            assert!(e.count == k - 1);
            sum += f64::from(e.irradiance.r / truth);
        }
        // Caps overlap: at most 20,000 photons speak, of which 13 caps of 1500 are independent.
        let error = (1.0 / (13.0 * f64::from(k)) * 4.0 / 3.0).sqrt();
        let mean = sum / f64::from(queries);
        assert!((mean - 1.0).abs() < 4.0 * error, "{kernel:?} {mean} ± {error}");
    }
}

#[test]
fn photons_of_other_surfaces_neither_count_nor_shrink_the_radius() {
    let plane = poisson_plane(77, 2000.0);
    let alone = map_of(plane.iter().copied(), 1);
    let others: [fn(Vec3) -> (Vec3, Vec3); 5] = [
        |p| (p, -Vec3::Y),                                   // the other side
        |p| (Vec3::new(0.0, p.x + 1.0, p.z), Vec3::X),       // a wall through the query point
        |p| (p * 0.1 + Vec3::Y * 0.05, Vec3::Y),             // a shelf right above
        |p| (p * 0.1 - Vec3::Y * 0.02, Vec3::Y),             // a floor below a thin sheet
        |p| (p + Vec3::Y * 0.001, Vec3::new(0.8, 0.6, 0.0)), // another orientation
    ];
    let gather = Gather { k: 60, max_radius_squared: 0.25, kernel: Kernel::Constant };
    let expect = irradiance(&alone, Vec3::ZERO, Vec3::Y, &gather);
    let nearest_in = |map: &PhotonMap, q| nearest_compatible(map.tree(), map.packed_normals(), q, Vec3::Y, 1.0);
    let nearest = nearest_in(&alone, Vec3::ZERO).map(|i| alone.position(i));
    for (i, other) in others.iter().enumerate() {
        let more = poisson_plane(78, 4000.0).into_iter().map(|(p, _)| other(p));
        let both = map_of(plane.iter().copied().chain(more), 1);
        let e = irradiance(&both, Vec3::ZERO, Vec3::Y, &gather);
        assert_eq!((e.count, e.radius), (expect.count, expect.radius), "{i}");
        assert!((e.irradiance.r / expect.irradiance.r - 1.0).abs() < 1e-6);
        assert_eq!(nearest_in(&both, Vec3::ZERO).map(|i| both.position(i)), nearest);
    }
}

#[test]
fn a_photon_at_the_very_point_on_the_other_side_does_not_count() {
    let map = map_of([(Vec3::X, -Vec3::Y), (Vec3::X, Vec3::X)], 1);
    let gather = Gather { k: 2, max_radius_squared: 1.0, kernel: Kernel::Constant };
    assert_eq!(irradiance(&map, Vec3::X, Vec3::Y, &gather).count, 0);
    assert_eq!(nearest_compatible(map.tree(), map.packed_normals(), Vec3::X, Vec3::Y, 1.0), None);
}

#[test]
fn the_divisor_is_the_emitted_count() {
    let e = |emitted| {
        let map = map_of(poisson_plane(3, 500.0), emitted);
        irradiance(&map, Vec3::ZERO, Vec3::Y, &Gather { k: 20, max_radius_squared: 1.0, kernel: Kernel::Cone })
            .irradiance
            .r
    };
    assert!((e(1000) * 1000.0 / e(1) - 1.0).abs() < 1e-6);
}

#[test]
fn few_and_no_photons_give_the_estimate_over_the_largest_disc() {
    let gather = Gather { k: 50, max_radius_squared: 0.25, kernel: Kernel::Constant };
    let none = irradiance(&map_of([], 7), Vec3::ZERO, Vec3::Y, &gather);
    assert_eq!(none, Estimate { irradiance: Rgb::BLACK, count: 0, radius: 0.5 });
    for n in [1, 7, 49] {
        let map = map_of((0..n).map(|i| (Vec3::X * 0.01 * i as f32, Vec3::Y)), 10);
        let e = irradiance(&map, Vec3::ZERO, Vec3::Y, &gather);
        let expect = n as f32 / (10.0 * ops::PI * 0.25);
        assert!(e.count == n && e.radius == 0.5 && (e.irradiance.r / expect - 1.0).abs() < 1e-6);
    }
}

#[test]
fn photons_at_one_point_give_a_finite_estimate_that_keeps_their_power() {
    let map = map_of((0..100_000).map(|_| (Vec3::splat(0.3), Vec3::Y)), 1);
    for kernel in KERNELS {
        let gather = Gather { k: 50, max_radius_squared: 0.25, kernel };
        let e = irradiance(&map, Vec3::splat(0.3), Vec3::Y, &gather);
        let expect = 100_000.0 * kernel.weight(0.0, MIN_GATHER_RADIUS * MIN_GATHER_RADIUS);
        assert!((e.irradiance.r / expect - 1.0).abs() < 1e-5 && e.count == 100_000);
        let beside = irradiance(&map, Vec3::new(0.3, 0.3, 0.4), Vec3::Y, &gather);
        assert!(beside.irradiance.is_finite());
    }
}

#[test]
fn weights_see_the_photons_directions() {
    let map = map_of(poisson_plane(9, 1000.0), 1);
    let gather = Gather { k: 30, max_radius_squared: 1.0, kernel: Kernel::Epanechnikov };
    let mut buffer = NeighbourBuffer::new();
    let plain = irradiance_into(&map, Vec3::ZERO, Vec3::Y, &gather, &mut buffer);
    let half = irradiance_weighted(&map, Vec3::ZERO, Vec3::Y, &gather, &mut buffer, |wi| 0.5 * wi.y);
    assert!((half.irradiance.r / plain.irradiance.r - 0.5).abs() < 1e-6 && half.count == plain.count);
}

#[test]
fn a_fixed_radius_counts_what_lies_within() {
    let map = map_of(poisson_plane(10, 5000.0), 1);
    let inside = (0..map.stored_count() as u32).filter(|&i| map.position(i).length_squared() < 0.04).count();
    let e = irradiance_within(&map, Vec3::ZERO, Vec3::Y, 0.04, Kernel::Constant);
    assert_eq!(e.count as usize, inside);
    assert!((e.irradiance.r / (inside as f32 / (ops::PI * 0.04)) - 1.0).abs() < 1e-6);
}

#[test]
fn the_default_radius_follows_the_density() {
    // Uniform: the k-th photon lies near √(k/(πλ)), the 90 % quantile a little above, at the rim of the square up to √4 × it.
    let map = map_of(poisson_plane(1, 40_000.0), 1);
    for k in [10u32, 50, 200] {
        let typical = (k as f32 / (ops::PI * 10_000.0)).sqrt();
        let r = choose_max_radius(&map, k);
        assert!(r > 2.0 * 0.9 * typical && r < 2.0 * 1.5 * typical, "{k}: {r} {typical}");
        assert_eq!(r, choose_max_radius(&map, k));
    }
    // A spot with most photons on a sparse ground: the radius fits the spot once nine in ten photons are in it.
    let ground = poisson_plane(2, 2_000.0);
    let spot = |n: f32| poisson_plane(3, n).into_iter().map(|(p, n)| (p * 0.01, n));
    let bright = choose_max_radius(&map_of(ground.iter().copied().chain(spot(60_000.0)), 1), 50);
    let weak = choose_max_radius(&map_of(ground.iter().copied().chain(spot(2_000.0)), 1), 50);
    assert!(bright < 0.004, "{bright}");
    assert!(weak > 2.0 * (50.0 / (ops::PI * 500.0)).sqrt() * 0.8, "{weak}");
    // Next to nothing.
    assert_eq!(choose_max_radius(&map_of([], 1), 50), 2.0 * SPARSE_RADIUS);
    assert_eq!(choose_max_radius(&map_of([(Vec3::X, Vec3::Y)], 1), 50), 2.0 * SPARSE_RADIUS);
    let point = map_of((0..1000).map(|_| (Vec3::X, Vec3::Y)), 1);
    assert_eq!(choose_max_radius(&point, 50), MIN_GATHER_RADIUS);
}

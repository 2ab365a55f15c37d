use super::*;
use crate::math::{Purpose, Stream};
use crate::photon::testing::{distance_squared, point_sets};

fn sorted_keys(found: impl Iterator<Item = Neighbour>) -> Vec<u64> {
    let mut keys: Vec<u64> = found.map(|n| key(n.distance_squared, n.index)).collect();
    keys.sort_unstable();
    keys
}

#[test]
fn searches_equal_brute_force() {
    let mut s = Stream::new(12, Purpose::Test, 0, 0);
    let mut buffer = NeighbourBuffer::new();
    for (name, points) in point_sets() {
        let n = points.len();
        let (tree, _) = KdTree::build(points);
        for _ in 0..40 {
            let q = if s.next_f32() < 0.5 && n > 0 {
                tree.position((s.next_u64() % n as u64) as u32)
            } else {
                [s.next_f32() * 3.0 - 1.5, s.next_f32() * 3.0 - 1.5, s.next_f32() * 3.0 - 1.5]
            };
            let radius_squared = match s.next_u64() % 4 {
                0 => f32::INFINITY,
                1 => 1.0,
                2 => 0.01,
                _ => s.next_f32(),
            };
            let modulus = 1 + (s.next_u64() % 3) as u32;
            let accept = |i: u32| i.is_multiple_of(modulus);
            let all: Vec<u64> = (0..n as u32)
                .map(|i| key(distance_squared(tree.position(i), q), i))
                .filter(|&k| k < bound_of(radius_squared))
                .collect();
            let mut accepted: Vec<u64> = all.iter().copied().filter(|&k| accept(k as u32)).collect();
            accepted.sort_unstable();
            let first = accepted.first().map(|&k| from_key(k));
            assert_eq!(tree.nearest(q, radius_squared, accept), first, "{name} {n}");
            for k in [0, 1, 2, 5, 17, 50, 100, 101, 200, 5000] {
                let expect = &accepted[..k.min(accepted.len())];
                tree.k_nearest(q, k, radius_squared, accept, &mut buffer);
                assert_eq!(sorted_keys(buffer.iter()), expect, "{name} n {n} k {k} r² {radius_squared}");
                tree.k_nearest_by_heap(q, k, radius_squared, accept, &mut buffer);
                assert_eq!(sorted_keys(buffer.iter()), expect, "heap: {name} n {n} k {k}");
                tree.k_nearest_by_buffer(q, k, radius_squared, accept, &mut buffer);
                assert_eq!(sorted_keys(buffer.iter()), expect, "buffer: {name} n {n} k {k}");
            }
            let mut within = Vec::new();
            tree.for_each_within(q, radius_squared, |n| within.push(n));
            let mut expect = all;
            expect.sort_unstable();
            assert_eq!(sorted_keys(within.into_iter()), expect, "{name} {n}");
        }
    }
}

#[test]
fn searches_with_senseless_arguments_find_nothing() {
    let (tree, _) = KdTree::build(vec![[0.0; 3]; 100]);
    let mut buffer = NeighbourBuffer::new();
    for r2 in [0.0, -1.0, f32::NAN, f32::NEG_INFINITY] {
        tree.k_nearest([0.0; 3], 20, r2, |_| true, &mut buffer);
        assert!(buffer.is_empty());
        assert_eq!(tree.nearest([0.0; 3], r2, |_| true), None);
    }
    for q in [[f32::NAN; 3], [f32::INFINITY; 3], [f32::MAX; 3]] {
        tree.k_nearest(q, 20, f32::INFINITY, |_| true, &mut buffer);
        assert!(buffer.is_empty());
    }
}

#[test]
fn non_finite_photons_are_never_found_and_harm_no_other() {
    let mut s = Stream::new(13, Purpose::Test, 0, 0);
    let mut points: Vec<[f32; 3]> = (0..1000).map(|_| [s.next_f32(), s.next_f32(), s.next_f32()]).collect();
    for i in (0..1000).step_by(10) {
        points[i][i / 10 % 3] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -f32::NAN][i / 10 % 4];
    }
    let (tree, _) = KdTree::build(points);
    let mut buffer = NeighbourBuffer::new();
    tree.k_nearest([0.5; 3], 2000, f32::INFINITY, |_| true, &mut buffer);
    assert_eq!(buffer.len(), 900);
}

#[test]
fn tree_is_balanced_and_the_order_is_a_permutation() {
    for (_, points) in point_sets() {
        let (tree, order) = KdTree::build(points.clone());
        let mut seen = vec![false; points.len()];
        for (i, &from) in order.iter().enumerate() {
            assert!(!std::mem::replace(&mut seen[from as usize], true));
            assert_eq!(tree.position(i as u32).map(f32::to_bits), points[from as usize].map(f32::to_bits));
        }
        for leaf in 0..1 << tree.levels {
            assert!(tree.first_photon(tree.levels, leaf + 1) - tree.first_photon(tree.levels, leaf) <= LEAF_PHOTONS);
        }
        assert_eq!(tree.nodes.len(), build::node_count(tree.levels));
    }
}

#[test]
fn rebuilding_from_tree_order_gives_the_same_tree() {
    for (_, points) in point_sets() {
        let (tree, _) = KdTree::build(points);
        let again = KdTree::from_tree_order([0, 1, 2].map(|a| tree.coordinates(a).to_vec()));
        assert_eq!(again, tree);
    }
}

#[test]
fn the_tree_does_not_depend_on_the_number_of_threads() {
    let mut s = Stream::new(14, Purpose::Test, 0, 0);
    let points: Vec<[f32; 3]> = (0..300_000).map(|_| [s.next_f32(), s.next_f32().powi(4), 0.0]).collect();
    let build = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| KdTree::build(points.clone()))
    };
    let one = build(1);
    for threads in [2, 3, 7] {
        assert!(build(threads) == one, "{threads} threads");
    }
}

#[test]
fn a_million_equal_points_are_searched_at_once() {
    let (tree, _) = KdTree::build(vec![[0.5, 0.5, 0.5]; 1_000_000]);
    let mut buffer = NeighbourBuffer::new();
    // Visiting everything a thousand times would take minutes; and the lowest indices win.
    for _ in 0..1000 {
        tree.k_nearest([0.5; 3], 100, 1.0, |_| true, &mut buffer);
        assert!(buffer.iter().all(|n| n.index < 100) && buffer.len() == 100);
        tree.k_nearest([0.2; 3], 10, 1.0, |_| true, &mut buffer);
        assert!(buffer.iter().all(|n| n.index < 10) && buffer.len() == 10);
        assert_eq!(tree.nearest([0.4; 3], 1.0, |_| true).unwrap().index, 0);
    }
}

use super::*;
use crate::math::{Purpose, Stream};
use crate::photon::pack::{encode_direction, encode_normal, encode_rgbe};
use crate::photon::query::NeighbourBuffer;

/// `n` photons of power ~1 on the unit square, or light vertices with random columns.
fn batch(n: u64, vertices: bool) -> PhotonBatch {
    let mut s = Stream::new(31, Purpose::Test, 0, n);
    let mut b = PhotonBatch::new(EmissionRange { first: 0, end: 2 * n }, vertices);
    for _ in 0..n {
        b.positions.push([s.next_f32(), 0.0, s.next_f32()]);
        b.powers.push(encode_rgbe(Rgb::new(1.0, s.next_f32(), 0.5)));
        b.normals.push(encode_normal(Vec3::Y));
        if let Some(v) = &mut b.vertices {
            v.directions.push(encode_direction(crate::math::warp::uniform_sphere(s.next_2d())));
            v.shares.push([s.next_f32(), s.next_f32()]);
            v.lengths.push(s.next_u64() as u8);
        }
    }
    b
}

#[test]
fn building_keeps_each_photon_whole() {
    for vertices in [false, true] {
        let from = batch(5000, vertices);
        let columns = |v: Option<&LightVertices>, i: usize| {
            v.map(|v| (v.directions[i], v.shares[i].map(f32::to_bits), v.lengths[i]))
        };
        let map = PhotonMap::build(MapKind::Global, from.clone());
        let mut before: Vec<_> = (0..from.len())
            .map(|i| {
                let d = columns(from.vertices.as_ref(), i);
                (from.positions[i].map(f32::to_bits), from.powers[i], from.normals[i], d)
            })
            .collect();
        let mut after: Vec<_> = (0..map.stored_count())
            .map(|i| {
                let d = columns(map.vertices(), i);
                let p = map.tree().position(i as u32).map(f32::to_bits);
                (p, map.packed_powers()[i], map.packed_normals()[i], d)
            })
            .collect();
        before.sort_unstable();
        after.sort_unstable();
        assert_eq!(before, after);
        assert_eq!(map.emitted_count(), 10_000);
    }
}

#[test]
fn parts_make_the_same_map_again() {
    for n in [0, 1, 17, 4321] {
        let map = PhotonMap::build(MapKind::Caustic, batch(n, true));
        let (tree, digest) = (map.tree().clone(), map.digest());
        let parts = map.into_parts();
        let again = PhotonMap::from_parts(parts.clone()).unwrap();
        assert_eq!(again.tree(), &tree);
        assert_eq!(again.digest(), digest);
        assert_eq!(again.into_parts(), parts);
    }
}

#[test]
fn bad_parts_are_refused_by_name() {
    let parts = PhotonMap::build(MapKind::Global, batch(100, true)).into_parts();
    let say = |change: &dyn Fn(&mut MapParts)| {
        let mut p = parts.clone();
        change(&mut p);
        PhotonMap::from_parts(p).unwrap_err().to_string()
    };
    assert_eq!(say(&|p| p.powers.truncate(99)), "global map: power has 99 entries for 100 photons");
    assert_eq!(say(&|p| p.coordinates[2].truncate(99)), "global map: z has 99 entries for 100 photons");
    assert_eq!(say(&|p| p.normals.push(0)), "global map: normal has 101 entries for 100 photons");
    assert_eq!(
        say(&|p| p.vertices.as_mut().unwrap().directions.clear()),
        "global map: direction has 0 entries for 100 photons"
    );
    let not_finite = "global map: the position of photon 7 is not finite";
    assert_eq!(say(&|p| p.coordinates[1][7] = f32::NAN), not_finite);
    assert_eq!(say(&|p| p.coordinates[0][7] = f32::INFINITY), not_finite);
}

#[test]
fn photons_in_another_order_make_a_slower_map_with_the_same_answers() {
    let map = PhotonMap::build(MapKind::Global, batch(3000, false));
    let mut parts = PhotonMap::build(MapKind::Global, batch(3000, false)).into_parts();
    for c in &mut parts.coordinates {
        c.reverse();
        c.rotate_left(1234);
    }
    let shuffled = PhotonMap::from_parts(parts).unwrap();
    let (mut a, mut b) = (NeighbourBuffer::new(), NeighbourBuffer::new());
    for i in (0..3000).step_by(101) {
        let q = map.tree().position(i);
        map.tree().k_nearest(q, 40, 1.0, |_| true, &mut a);
        shuffled.tree().k_nearest(q, 40, 1.0, |_| true, &mut b);
        assert_eq!(a.farthest().unwrap().distance_squared, b.farthest().unwrap().distance_squared);
    }
}

#[test]
fn the_digest_sees_every_field() {
    let parts = PhotonMap::build(MapKind::Global, batch(50, true)).into_parts();
    let digest = |change: &dyn Fn(&mut MapParts)| {
        let mut p = parts.clone();
        change(&mut p);
        PhotonMap::from_parts(p).unwrap().digest()
    };
    let digests = [
        digest(&|_| ()),
        digest(&|p| p.kind = MapKind::Caustic),
        digest(&|p| p.emitted_count += 1),
        digest(&|p| p.coordinates[1][3] = 0.1),
        digest(&|p| p.powers[49] ^= 1),
        digest(&|p| p.normals[0] ^= 1),
        digest(&|p| p.vertices.as_mut().unwrap().directions[20] ^= 1),
        digest(&|p| p.vertices.as_mut().unwrap().shares[21][1] += 1.0),
        digest(&|p| p.vertices.as_mut().unwrap().lengths[22] ^= 1),
        digest(&|p| p.vertices = None),
    ];
    for i in 0..digests.len() {
        for j in 0..i {
            assert_ne!(digests[i], digests[j], "{i} {j}");
        }
    }
}

#[test]
fn memory_stays_within_28_bytes_a_photon_and_41_a_light_vertex() {
    // The worst count for the tree is just above a power of two of full leaves.
    for n in [100_000usize, (1 << 17) + 1, 1 << 17, 10_000_000, (1 << 24) + 1] {
        for vertices in [false, true] {
            let bytes = PhotonMap::memory_bytes_for(n, vertices) as f64 / n as f64;
            assert!(bytes <= if vertices { 37.0 } else { 24.0 }, "{n}: {bytes}");
        }
    }
    for k in [2, 60] {
        let map = PhotonMap::build(MapKind::Global, batch(70_000, true));
        let sites = map.precomputed(k).memory_bytes();
        let held = [0, 1, 2].map(|a| map.tree.coordinates(a).len() * 4).iter().sum::<usize>()
            + map.powers.capacity() * 4
            + map.normals.capacity() * 2
            + map
                .vertices
                .as_ref()
                .map_or(0, |v| v.directions.capacity() * 4 + v.shares.capacity() * 8 + v.lengths.capacity());
        assert!(held as u64 + sites <= map.memory_bytes());
        assert!(map.memory_bytes() <= 41 * 70_000, "{k}: {}", map.memory_bytes());
    }
}

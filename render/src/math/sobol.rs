//! Owen-scrambled Sobol' points, padded in pairs of dimensions (Burley 2020, "Practical Hash-based Owen Scrambling").

use super::rng::{Purpose, Stream, mix64, stream_key};

/// Pairs of dimensions that come from the low-discrepancy sequence; later ones are independent random numbers, where
/// stratification no longer helps and a hash is cheaper.
const SOBOL_PAIRS: u32 = 20;

/// The numbers of one sample: a pure function of (seed, purpose, round, sequence, index).
///
/// Samples of one `sequence` (a pixel, or the photon paths of a map) with consecutive indices are well stratified in
/// each pair of dimensions; different sequences are independent.
#[derive(Clone, Debug)]
pub struct Sampler {
    sequence_seed: u64,
    index: u32,
    pair: u32,
    tail: Stream,
}

impl Sampler {
    /// Sample `index` of `sequence`. Indices beyond 2³² continue in further independent sequences.
    #[inline]
    pub fn new(seed: u64, purpose: Purpose, round: u32, sequence: u64, index: u64) -> Self {
        let key = stream_key(seed, purpose, round);
        let sequence_seed = mix64(key ^ mix64(sequence.wrapping_add((index >> 32) << 48)));
        Sampler { sequence_seed, index: index as u32, pair: 0, tail: Stream::from_key(sequence_seed, index) }
    }

    /// The numbers of part `part` < `parts` of this sample, where it splits into so many. The parts of all samples of the
    /// sequence are stratified together, as `parts` times as many samples are; they are independent of the sample's own numbers.
    #[inline]
    pub fn branch(&self, part: u32, parts: u32) -> Self {
        let index = u64::from(self.index) * u64::from(parts) + u64::from(part);
        let own = self.sequence_seed.wrapping_add(mix64(u64::from(self.pair) << 32 | u64::from(parts)));
        let sequence_seed = mix64(own.wrapping_add((index >> 32) << 48));
        Sampler { sequence_seed, index: index as u32, pair: 0, tail: Stream::from_key(sequence_seed, index) }
    }

    /// One number in [0, 1).
    #[inline]
    pub fn next_1d(&mut self) -> f32 {
        if self.pair >= SOBOL_PAIRS {
            return self.tail.next_f32();
        }
        let seed = self.next_seed();
        let n = owen_scramble(self.index, seed as u32);
        to_unit(owen_scramble(n.reverse_bits(), (seed >> 32) as u32))
    }

    /// Two numbers in [0, 1), stratified together.
    #[inline]
    pub fn next_2d(&mut self) -> [f32; 2] {
        if self.pair >= SOBOL_PAIRS {
            return self.tail.next_2d();
        }
        let seed = self.next_seed();
        let n = owen_scramble(self.index, seed as u32);
        let y_seed = mix64(seed) as u32;
        [to_unit(owen_scramble(n.reverse_bits(), (seed >> 32) as u32)), to_unit(owen_scramble(sobol_second(n), y_seed))]
    }

    /// Three numbers in [0, 1); the first two stratified together.
    #[inline]
    pub fn next_3d(&mut self) -> [f32; 3] {
        let [a, b] = self.next_2d();
        [a, b, self.next_1d()]
    }

    #[inline]
    fn next_seed(&mut self) -> u64 {
        self.pair += 1;
        mix64(self.sequence_seed.wrapping_add(u64::from(self.pair).wrapping_mul(0x9e37_79b9_7f4a_7c15)))
    }
}

#[inline]
fn to_unit(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Second dimension of the Sobol' sequence: the binomial (Pascal) matrix modulo 2 applied to the bits of `n`.
#[inline]
fn sobol_second(n: u32) -> u32 {
    // Multiplying by the Pascal matrix mod 2 is a subset-sum (zeta) transform over bit positions.
    let mut v = n.reverse_bits();
    v ^= (v & 0x5555_5555) << 1;
    v ^= (v & 0x3333_3333) << 2;
    v ^= (v & 0x0f0f_0f0f) << 4;
    v ^= (v & 0x00ff_00ff) << 8;
    v ^= (v & 0x0000_ffff) << 16;
    v
}

/// Nested uniform scrambling by hashing (Burley 2020, listing 3, with the hash of Vegdahl 2021).
#[inline]
fn owen_scramble(x: u32, seed: u32) -> u32 {
    let mut v = x.reverse_bits();
    v ^= v.wrapping_mul(0x3d20_adea);
    v = v.wrapping_add(seed);
    v = v.wrapping_mul((seed >> 16) | 1);
    v ^= v.wrapping_mul(0x0552_6c56);
    v ^= v.wrapping_mul(0x53a2_2864);
    v.reverse_bits()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reference_second(mut n: u32) -> u32 {
        let (mut v, mut r) = (1u32 << 31, 0u32);
        while n != 0 {
            if n & 1 == 1 {
                r ^= v;
            }
            n >>= 1;
            v ^= v >> 1;
        }
        r
    }

    #[test]
    fn the_second_dimension_is_the_sobol_matrix() {
        for n in (0..5000).chain([u32::MAX, 0x8000_0001, 0xdead_beef]) {
            assert_eq!(sobol_second(n), reference_second(n), "{n}");
        }
    }

    /// Every elementary interval of a (0, 2)-sequence holds one of 64 consecutive points, in every pair of dimensions.
    #[test]
    fn each_pair_is_a_scrambled_net() {
        for pair in 0..6 {
            let points: Vec<[f32; 2]> = (0..64)
                .map(|i| {
                    let mut s = Sampler::new(5, Purpose::Test, 0, 17, i);
                    for _ in 0..pair {
                        s.next_2d();
                    }
                    s.next_2d()
                })
                .collect();
            for log_x in 0..=6 {
                let (nx, ny) = (1usize << log_x, 64usize >> log_x);
                let mut seen = vec![0; 64];
                for p in &points {
                    seen[(p[0] * nx as f32) as usize * ny + (p[1] * ny as f32) as usize] += 1;
                }
                assert!(seen.iter().all(|&c| c == 1), "pair {pair}, {nx} × {ny}");
            }
        }
    }

    #[test]
    fn parts_of_samples_are_a_net_together() {
        // 16 samples with 4 parts each: every elementary interval holds one of the 64 points, in every pair of dimensions.
        for pair in 0..3 {
            let points: Vec<[f32; 2]> = (0..64)
                .map(|i| {
                    let mut s = Sampler::new(5, Purpose::Test, 0, 18, i / 4);
                    s.next_3d();
                    let mut part = s.branch((i % 4) as u32, 4);
                    for _ in 0..pair {
                        part.next_2d();
                    }
                    part.next_2d()
                })
                .collect();
            for log_x in 0..=6 {
                let (nx, ny) = (1usize << log_x, 64usize >> log_x);
                let mut seen = vec![0; 64];
                for p in &points {
                    seen[(p[0] * nx as f32) as usize * ny + (p[1] * ny as f32) as usize] += 1;
                }
                assert!(seen.iter().all(|&c| c == 1), "pair {pair}, {nx} × {ny}");
            }
        }
        // Indices beyond 32 bits begin another sequence instead of repeating one.
        let of = |index: u64| Sampler::new(5, Purpose::Test, 0, 18, index).branch(0, 1 << 16).next_2d();
        assert_ne!(of(0), of(1 << 16));
    }

    #[test]
    fn pairs_and_sequences_are_uncorrelated() {
        let n = 4096;
        let mut sums = [0.0f64; 2];
        for i in 0..n {
            let mut a = Sampler::new(5, Purpose::Test, 0, 1, i);
            let mut b = Sampler::new(5, Purpose::Test, 0, 2, i);
            let (a0, a1, b0) = (a.next_1d(), a.next_1d(), b.next_1d());
            sums[0] += f64::from((a0 - 0.5) * (a1 - 0.5));
            sums[1] += f64::from((a0 - 0.5) * (b0 - 0.5));
        }
        for s in sums {
            // Standard error of the correlation for independent values: 1/12/√n = 0.0013.
            assert!((s / n as f64).abs() < 4.5 * 0.0013, "{s}");
        }
    }
}

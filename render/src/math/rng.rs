//! Random streams that are pure functions of (seed, purpose, round, index): the index is the seed.
//!
//! Nothing else may influence a result: not the worker, the thread, the batch size or the order of arrival.

/// What a stream is for; streams of different purposes are independent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u32)]
pub enum Purpose {
    /// Camera samples of a pixel.
    Camera = 1,
    /// Photon paths of the global map.
    GlobalPhotons = 2,
    /// Photon paths of the caustic map.
    CausticPhotons = 3,
    /// Pilot runs of the plan.
    Plan = 4,
    /// Light sub-paths of bidirectional methods.
    LightPath = 5,
    /// Markov chains.
    Chain = 6,
    /// Bootstrap paths of the Markov chains.
    Bootstrap = 7,
    /// Roulette over the connections of bidirectional methods.
    Connection = 8,
    /// Camera samples that look for the error of a photon map.
    MapError = 9,
    /// Tests.
    Test = 99,
}

/// Mixes 64 bits bijectively (SplitMix64 finaliser, Steele, Lea and Flood 2014).
#[inline]
pub const fn mix64(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// A key for (seed, purpose, round) under which indices are numbered; see [`Stream::from_key`].
#[inline]
pub const fn stream_key(seed: u64, purpose: Purpose, round: u32) -> u64 {
    let k = mix64(seed.wrapping_add(GOLDEN));
    mix64(k ^ ((purpose as u64) << 32 | round as u64).wrapping_mul(GOLDEN))
}

/// A counter-based stream: value `n` is a pure function of the key, the index and `n`.
#[derive(Clone, Debug)]
pub struct Stream {
    state: u64,
}

impl Stream {
    /// The stream of `index` for (seed, purpose, round).
    #[inline]
    pub const fn new(seed: u64, purpose: Purpose, round: u32, index: u64) -> Self {
        Self::from_key(stream_key(seed, purpose, round), index)
    }
    /// The stream of `index` under `key`. Different indices have different states (the map is a bijection).
    #[inline]
    pub const fn from_key(key: u64, index: u64) -> Self {
        Stream { state: mix64(mix64(index.wrapping_mul(GOLDEN) ^ key).wrapping_add(key)) }
    }
    /// 64 uniform bits.
    #[inline]
    pub fn next_u64(&mut self) -> u64 {
        self.state = self.state.wrapping_add(GOLDEN);
        mix64(self.state)
    }
    /// Uniform in [0, 1), a multiple of 2⁻²⁴.
    #[inline]
    pub fn next_f32(&mut self) -> f32 {
        (self.next_u64() >> 40) as f32 * (1.0 / 16_777_216.0)
    }
    /// Two independent values in [0, 1).
    #[inline]
    pub fn next_2d(&mut self) -> [f32; 2] {
        let bits = self.next_u64();
        const SCALE: f32 = 1.0 / 16_777_216.0;
        [(bits >> 40) as f32 * SCALE, (bits & 0xff_ffff) as f32 * SCALE]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_are_reproducible_and_differ_in_every_argument() {
        let first = |seed, purpose, round, index| Stream::new(seed, purpose, round, index).next_u64();
        let base = first(1, Purpose::Camera, 0, 0);
        assert_eq!(base, first(1, Purpose::Camera, 0, 0));
        for other in [
            first(2, Purpose::Camera, 0, 0),
            first(1, Purpose::GlobalPhotons, 0, 0),
            first(1, Purpose::Camera, 1, 0),
            first(1, Purpose::Camera, 0, 1),
        ] {
            assert_ne!(base, other);
        }
    }

    /// Chi² over 16 × 16 cells of (first value of stream i, first value of stream i + 1): 255 degrees of freedom,
    /// the 0.9999 quantile is 347.
    #[test]
    fn neighbouring_streams_are_independent() {
        let n = 65_536u64;
        let mut cells = [0u32; 256];
        for i in 0..n {
            let a = Stream::new(7, Purpose::Test, 0, i).next_f32();
            let b = Stream::new(7, Purpose::Test, 0, i + 1).next_f32();
            cells[(a * 16.0) as usize * 16 + (b * 16.0) as usize] += 1;
        }
        let e = n as f64 / 256.0;
        let chi2: f64 = cells.iter().map(|&c| (f64::from(c) - e).powi(2) / e).sum();
        assert!(chi2 < 347.0, "chi² {chi2}");
    }

    #[test]
    fn values_lie_in_the_half_open_unit_interval() {
        let mut s = Stream::new(3, Purpose::Test, 0, 0);
        let mut sum = 0.0f64;
        for _ in 0..100_000 {
            let v = s.next_f32();
            assert!((0.0..1.0).contains(&v));
            sum += f64::from(v);
        }
        // Mean 0.5 with standard error 0.000913.
        assert!((sum / 1e5 - 0.5).abs() < 4.5 * 0.000_913);
    }
}

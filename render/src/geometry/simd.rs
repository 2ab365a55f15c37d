//! Eight and four floats at a time: portable, SSE2 and AVX2. The only module with unsafe code.
//!
//! Every operation is one correctly rounded IEEE operation per lane (no fused multiply-add, no approximate reciprocal,
//! minimum and maximum as SSE defines them), so all implementations give the same bits.
//!
//! Safety: the unsafe blocks call intrinsics on plain values, with two exceptions that load from and store to
//! references of exactly the vector's size by unaligned moves. SSE2 is part of every x86-64. AVX2 values can only be
//! made from an [`Avx2`] token, and a token only by [`Avx2::detect`] on a processor that has AVX2.
#![allow(unsafe_code)]

/// A vector of floats.
pub(super) trait Lanes: Copy {
    /// Proof that the processor can do it.
    type Token: Copy;
    /// `[f32; 4]` or `[f32; 8]`.
    type Row: Copy + AsRef<[f32]>;
    /// One truth value per lane.
    type Mask: Copy;
    /// From memory.
    fn load(token: Self::Token, row: &Self::Row) -> Self;
    /// To memory.
    fn store(self) -> Self::Row;
    /// The same value in every lane.
    fn splat(token: Self::Token, value: f32) -> Self;
    /// self + other.
    fn add(self, other: Self) -> Self;
    /// self − other.
    fn sub(self, other: Self) -> Self;
    /// self × other.
    fn mul(self, other: Self) -> Self;
    /// self ÷ other.
    fn div(self, other: Self) -> Self;
    /// `if self < other { self } else { other }`: other if either is not a number.
    fn min(self, other: Self) -> Self;
    /// `if self > other { self } else { other }`: other if either is not a number.
    fn max(self, other: Self) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
    /// self ≤ other; false if either is not a number.
    fn le(self, other: Self) -> Self::Mask;
    /// self = other; false if either is not a number.
    fn eq(self, other: Self) -> Self::Mask;
    /// Both.
    fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// Either.
    fn or(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// Bit i is lane i.
    fn bits(mask: Self::Mask) -> u32;
}

/// A set of vector types that one kernel is compiled for.
pub(super) trait Simd: Copy {
    /// Eight lanes.
    type F8: Lanes<Row = [f32; 8], Token = Self>;
    /// Four lanes.
    type F4: Lanes<Row = [f32; 4], Token = Self>;
}

/// A computation written once for every [`Simd`]; `run` must be `#[inline(always)]`.
pub(super) trait Kernel {
    /// What it gives.
    type Output;
    /// Runs it with the given vectors.
    fn run<S: Simd>(self, simd: S) -> Self::Output;
}

/// Which implementation to use; all give the same bits.
#[derive(Clone, Copy, Debug)]
pub(super) enum Level {
    /// Arrays of floats: for other processors, and for tests.
    #[cfg_attr(all(target_arch = "x86_64", not(test)), allow(dead_code))]
    Portable(Portable),
    /// SSE2, which every x86-64 has.
    #[cfg(target_arch = "x86_64")]
    Sse2(Sse2),
    /// AVX2.
    #[cfg(target_arch = "x86_64")]
    Avx2(Avx2),
}

impl Level {
    /// The fastest one that this processor has.
    pub(super) fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        return Avx2::detect().map_or(Level::Sse2(Sse2), Level::Avx2);
        #[cfg(not(target_arch = "x86_64"))]
        return Level::Portable(Portable);
    }
    /// Every one that this processor has.
    #[cfg(test)]
    pub(super) fn all() -> Vec<Self> {
        #[allow(unused_mut)]
        let mut all = vec![Level::Portable(Portable)];
        #[cfg(target_arch = "x86_64")]
        {
            all.push(Level::Sse2(Sse2));
            all.extend(Avx2::detect().map(Level::Avx2));
        }
        all
    }
    /// Runs a kernel.
    #[inline(always)]
    pub(super) fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self {
            Level::Portable(token) => kernel.run(token),
            #[cfg(target_arch = "x86_64")]
            Level::Sse2(token) => kernel.run(token),
            #[cfg(target_arch = "x86_64")]
            Level::Avx2(token) => token.run(kernel),
        }
    }
}

/// Arrays of floats.
#[derive(Clone, Copy, Debug)]
pub(super) struct Portable;

impl Simd for Portable {
    type F8 = Array<8>;
    type F4 = Array<4>;
}

/// A vector as an array.
#[derive(Clone, Copy)]
pub(super) struct Array<const N: usize>([f32; N]);

impl<const N: usize> Array<N> {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Array(std::array::from_fn(|i| f(self.0[i], other.0[i])))
    }
    #[inline(always)]
    fn test(self, other: Self, f: impl Fn(f32, f32) -> bool) -> u32 {
        (0..N).fold(0, |m, i| m | u32::from(f(self.0[i], other.0[i])) << i)
    }
}

impl<const N: usize> Lanes for Array<N> {
    type Token = Portable;
    type Row = [f32; N];
    type Mask = u32;
    #[inline(always)]
    fn load(_: Portable, row: &[f32; N]) -> Self {
        Array(*row)
    }
    #[inline(always)]
    fn store(self) -> [f32; N] {
        self.0
    }
    #[inline(always)]
    fn splat(_: Portable, value: f32) -> Self {
        Array([value; N])
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.zip(other, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.zip(other, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Array(self.0.map(f32::abs))
    }
    #[inline(always)]
    fn le(self, other: Self) -> u32 {
        self.test(other, |a, b| a <= b)
    }
    #[inline(always)]
    fn eq(self, other: Self) -> u32 {
        self.test(other, |a, b| a == b)
    }
    #[inline(always)]
    fn and(a: u32, b: u32) -> u32 {
        a & b
    }
    #[inline(always)]
    fn or(a: u32, b: u32) -> u32 {
        a | b
    }
    #[inline(always)]
    fn bits(mask: u32) -> u32 {
        mask
    }
}

#[cfg(target_arch = "x86_64")]
pub(super) use x86::{Avx2, Sse2};

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{Kernel, Lanes, Simd};
    use std::arch::x86_64::*;

    /// Token of SSE2.
    #[derive(Clone, Copy, Debug)]
    pub(in super::super) struct Sse2;

    /// Token of AVX2: exists only where the processor has it.
    #[derive(Clone, Copy, Debug)]
    pub(in super::super) struct Avx2(());

    impl Avx2 {
        /// The token, if the processor has AVX2.
        pub(in super::super) fn detect() -> Option<Self> {
            std::arch::is_x86_feature_detected!("avx2").then_some(Avx2(()))
        }
        /// Compiles `kernel` for AVX2 and runs it.
        #[inline(always)]
        pub(super) fn run<K: Kernel>(self, kernel: K) -> K::Output {
            #[target_feature(enable = "avx2")]
            fn compiled<K: Kernel>(kernel: K, token: Avx2) -> K::Output {
                kernel.run(token)
            }
            // Safety: the token shows that the processor has AVX2.
            unsafe { compiled(kernel, self) }
        }
    }

    impl Simd for Sse2 {
        type F8 = Pair;
        type F4 = Quad<Sse2>;
    }

    impl Simd for Avx2 {
        type F8 = Octet;
        type F4 = Quad<Avx2>;
    }

    /// Four floats in an SSE register.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Quad<T>(__m128, T);

    /// Eight floats in two SSE registers.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Pair(Quad<Sse2>, Quad<Sse2>);

    /// Eight floats in an AVX register.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Octet(__m256, Avx2);

    /// The lane-wise operations by intrinsics. Safety: the value's token shows that the processor has them.
    macro_rules! operations {
        ($($name:ident: $intrinsic:ident),*) => {$(
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self(unsafe { $intrinsic(self.0, other.0) }, self.1)
            }
        )*};
    }

    impl<T: Copy> Lanes for Quad<T> {
        type Token = T;
        type Row = [f32; 4];
        type Mask = __m128;
        operations!(add: _mm_add_ps, sub: _mm_sub_ps, mul: _mm_mul_ps, div: _mm_div_ps, min: _mm_min_ps, max: _mm_max_ps);
        #[inline(always)]
        fn load(token: T, row: &[f32; 4]) -> Self {
            // Safety: four floats are readable; the move needs no alignment.
            Quad(unsafe { _mm_loadu_ps(row.as_ptr()) }, token)
        }
        #[inline(always)]
        fn store(self) -> [f32; 4] {
            let mut row = [0.0; 4];
            // Safety: four floats are writable; the move needs no alignment.
            unsafe { _mm_storeu_ps(row.as_mut_ptr(), self.0) };
            row
        }
        #[inline(always)]
        fn splat(token: T, value: f32) -> Self {
            Quad(unsafe { _mm_set1_ps(value) }, token)
        }
        #[inline(always)]
        fn abs(self) -> Self {
            Quad(unsafe { _mm_andnot_ps(_mm_set1_ps(-0.0), self.0) }, self.1)
        }
        #[inline(always)]
        fn le(self, other: Self) -> __m128 {
            unsafe { _mm_cmple_ps(self.0, other.0) }
        }
        #[inline(always)]
        fn eq(self, other: Self) -> __m128 {
            unsafe { _mm_cmpeq_ps(self.0, other.0) }
        }
        #[inline(always)]
        fn and(a: __m128, b: __m128) -> __m128 {
            unsafe { _mm_and_ps(a, b) }
        }
        #[inline(always)]
        fn or(a: __m128, b: __m128) -> __m128 {
            unsafe { _mm_or_ps(a, b) }
        }
        #[inline(always)]
        fn bits(mask: __m128) -> u32 {
            (unsafe { _mm_movemask_ps(mask) }) as u32
        }
    }

    impl Lanes for Octet {
        type Token = Avx2;
        type Row = [f32; 8];
        type Mask = __m256;
        operations!(add: _mm256_add_ps, sub: _mm256_sub_ps, mul: _mm256_mul_ps, div: _mm256_div_ps, min: _mm256_min_ps, max: _mm256_max_ps);
        #[inline(always)]
        fn load(token: Avx2, row: &[f32; 8]) -> Self {
            // Safety: eight floats are readable; the move needs no alignment.
            Octet(unsafe { _mm256_loadu_ps(row.as_ptr()) }, token)
        }
        #[inline(always)]
        fn store(self) -> [f32; 8] {
            let mut row = [0.0; 8];
            // Safety: eight floats are writable; the move needs no alignment.
            unsafe { _mm256_storeu_ps(row.as_mut_ptr(), self.0) };
            row
        }
        #[inline(always)]
        fn splat(token: Avx2, value: f32) -> Self {
            Octet(unsafe { _mm256_set1_ps(value) }, token)
        }
        #[inline(always)]
        fn abs(self) -> Self {
            Octet(unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0) }, self.1)
        }
        #[inline(always)]
        fn le(self, other: Self) -> __m256 {
            unsafe { _mm256_cmp_ps::<_CMP_LE_OQ>(self.0, other.0) }
        }
        #[inline(always)]
        fn eq(self, other: Self) -> __m256 {
            unsafe { _mm256_cmp_ps::<_CMP_EQ_OQ>(self.0, other.0) }
        }
        #[inline(always)]
        fn and(a: __m256, b: __m256) -> __m256 {
            unsafe { _mm256_and_ps(a, b) }
        }
        #[inline(always)]
        fn or(a: __m256, b: __m256) -> __m256 {
            unsafe { _mm256_or_ps(a, b) }
        }
        #[inline(always)]
        fn bits(mask: __m256) -> u32 {
            (unsafe { _mm256_movemask_ps(mask) }) as u32
        }
    }

    /// Each operation on both halves.
    macro_rules! by_halves {
        ($($name:ident),*) => {$(
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Pair(self.0.$name(other.0), self.1.$name(other.1))
            }
        )*};
    }

    impl Lanes for Pair {
        type Token = Sse2;
        type Row = [f32; 8];
        type Mask = (__m128, __m128);
        by_halves!(add, sub, mul, div, min, max);
        #[inline(always)]
        fn load(token: Sse2, row: &[f32; 8]) -> Self {
            let [a, b, c, d, e, f, g, h] = *row;
            Pair(Quad::load(token, &[a, b, c, d]), Quad::load(token, &[e, f, g, h]))
        }
        #[inline(always)]
        fn store(self) -> [f32; 8] {
            let ([a, b, c, d], [e, f, g, h]) = (self.0.store(), self.1.store());
            [a, b, c, d, e, f, g, h]
        }
        #[inline(always)]
        fn splat(token: Sse2, value: f32) -> Self {
            Pair(Quad::splat(token, value), Quad::splat(token, value))
        }
        #[inline(always)]
        fn abs(self) -> Self {
            Pair(self.0.abs(), self.1.abs())
        }
        #[inline(always)]
        fn le(self, other: Self) -> Self::Mask {
            (self.0.le(other.0), self.1.le(other.1))
        }
        #[inline(always)]
        fn eq(self, other: Self) -> Self::Mask {
            (self.0.eq(other.0), self.1.eq(other.1))
        }
        #[inline(always)]
        fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask {
            (Quad::<Sse2>::and(a.0, b.0), Quad::<Sse2>::and(a.1, b.1))
        }
        #[inline(always)]
        fn or(a: Self::Mask, b: Self::Mask) -> Self::Mask {
            (Quad::<Sse2>::or(a.0, b.0), Quad::<Sse2>::or(a.1, b.1))
        }
        #[inline(always)]
        fn bits(mask: Self::Mask) -> u32 {
            Quad::<Sse2>::bits(mask.0) | Quad::<Sse2>::bits(mask.1) << 4
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const VALUES: [f32; 12] =
        [0.0, -0.0, 1.0, -1.5, 1e-45, 3e38, -3e38, f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 0.1, 1e-38];

    /// The bits of every operation's result on two rows of eight.
    struct Operations([f32; 8], [f32; 8]);

    impl Kernel for Operations {
        type Output = (Vec<u32>, Vec<u32>);
        #[inline(always)]
        fn run<S: Simd>(self, simd: S) -> Self::Output {
            let (mut values, mut masks) = (Vec::new(), Vec::new());
            let (a, b) = (S::F8::load(simd, &self.0), S::F8::load(simd, &self.1));
            run_lanes(a, b, S::F8::splat(simd, self.0[0]), &mut values, &mut masks);
            let four = |row: &[f32; 8]| [row[2], row[3], row[4], row[5]];
            let (a, b) = (S::F4::load(simd, &four(&self.0)), S::F4::load(simd, &four(&self.1)));
            run_lanes(a, b, S::F4::splat(simd, self.1[0]), &mut values, &mut masks);
            (values, masks)
        }
    }

    #[inline(always)]
    fn run_lanes<L: Lanes>(a: L, b: L, c: L, values: &mut Vec<u32>, masks: &mut Vec<u32>) {
        for v in [a.add(b), a.sub(b), a.mul(b), a.div(b), a.min(b), a.max(b), a.abs(), c] {
            // Not-a-numbers differ in their payload only, which no result shows.
            values.extend(v.store().as_ref().iter().map(|x| if x.is_nan() { u32::MAX } else { x.to_bits() }));
        }
        masks.extend([a.le(b), a.eq(b), L::and(a.le(b), a.eq(b)), L::or(a.le(b), b.le(a))].map(L::bits));
    }

    #[test]
    fn all_levels_give_the_same_bits() {
        for i in 0..VALUES.len() {
            for j in 0..VALUES.len() {
                let row = |from: usize, step: usize| std::array::from_fn(|k| VALUES[(from + k * step) % VALUES.len()]);
                let (a, b) = (row(i, 1), row(j, 5));
                let expected = Level::Portable(Portable).run(Operations(a, b));
                for level in Level::all() {
                    assert_eq!(level.run(Operations(a, b)), expected, "{level:?} {a:?} {b:?}");
                }
            }
        }
    }
}

//! Lanes by AVX2, for machines with AVX-512, too.
//!
//! SAFETY of all that follows: the instructions are there, since only `Vectors::run` leads
//! here; loads and stores go through references to arrays of the right length, or behind a
//! comparison with the length.

use super::{Kernel, Lanes, Pair, Part, LANES};
use std::arch::x86_64::*;
use std::marker::PhantomData;

#[target_feature(enable = "avx2,popcnt")]
pub(super) unsafe fn run<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Avx2>()
}

#[inline(never)]
#[target_feature(enable = "avx2,popcnt")]
unsafe fn run_part<W: Part<Avx2>>(part: W) -> W::Output {
    part.run()
}

/// Vectors of eight, and what two of them are.
#[derive(Clone, Copy)]
pub struct Avx<W>(PhantomData<W>);

pub type Avx2 = Avx<Two>;

/// What the machine makes of two vectors.
pub trait Width: Copy {
    type Pair: Pair<Avx<Self>>;
    /// The lanes of the mask at the front, and how many they are.
    unsafe fn closed_up(mask: __m256, values: __m256) -> (__m256, usize);
    /// As [`Lanes::larger`].
    unsafe fn larger(best: (__m256, __m256i), other: (__m256, __m256i)) -> (__m256, __m256i);
    /// As [`Lanes::apart`].
    fn apart<P: Part<Avx<Self>>>(part: P) -> P::Output;
}

/// They stay two.
#[derive(Clone, Copy)]
pub struct Two;

impl Width for Two {
    type Pair = [__m256; 2];

    #[inline(always)]
    unsafe fn closed_up(mask: __m256, values: __m256) -> (__m256, usize) {
        let bits = _mm256_movemask_ps(mask);
        (_mm256_permutevar8x32_ps(values, to_front(bits)), bits.count_ones() as usize)
    }

    #[inline(always)]
    unsafe fn larger(best: (__m256, __m256i), other: (__m256, __m256i)) -> (__m256, __m256i) {
        let is_larger = _mm256_castps_si256(_mm256_cmp_ps::<_CMP_GT_OQ>(other.0, best.0));
        (_mm256_max_ps(other.0, best.0), _mm256_blendv_epi8(best.1, other.1, is_larger))
    }

    #[inline(always)]
    fn apart<P: Part<Avx2>>(part: P) -> P::Output {
        unsafe { run_part(part) }
    }
}

/// By mask: the lanes to be moved to the front, a byte each.
static FRONT: [u64; 1 << LANES] = {
    let mut table = [0; 1 << LANES];
    let mut mask = 0;
    while mask < table.len() {
        let (mut lane, mut at) = (0, 0);
        while lane < LANES {
            if mask >> lane & 1 != 0 {
                table[mask] |= (lane as u64) << (8 * at);
                at += 1;
            }
            lane += 1;
        }
        mask += 1;
    }
    table
};

/// The halves of a vector of doubles.
type Halves = [__m256d; 2];

#[inline(always)]
unsafe fn to_front(mask: i32) -> __m256i {
    _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(FRONT[(mask & 255) as usize] as i64))
}

impl<W: Width> Lanes for Avx<W> {
    type F = __m256;
    type I = __m256i;
    type D = Halves;
    type Pair = W::Pair;

    #[inline(always)]
    fn splat(value: f32) -> Self::F {
        unsafe { _mm256_set1_ps(value) }
    }
    #[inline(always)]
    fn load(from: &[f32; LANES]) -> Self::F {
        unsafe { _mm256_loadu_ps(from.as_ptr()) }
    }
    #[inline(always)]
    fn store(values: Self::F, into: &mut [f32; LANES]) {
        unsafe { _mm256_storeu_ps(into.as_mut_ptr(), values) }
    }
    #[inline(always)]
    fn add(a: Self::F, b: Self::F) -> Self::F {
        unsafe { _mm256_add_ps(a, b) }
    }
    #[inline(always)]
    fn sub(a: Self::F, b: Self::F) -> Self::F {
        unsafe { _mm256_sub_ps(a, b) }
    }
    #[inline(always)]
    fn mul(a: Self::F, b: Self::F) -> Self::F {
        unsafe { _mm256_mul_ps(a, b) }
    }
    #[inline(always)]
    fn abs(a: Self::F) -> Self::F {
        unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), a) }
    }
    #[inline(always)]
    fn greater(a: Self::F, b: Self::F) -> Self::F {
        unsafe { _mm256_cmp_ps::<_CMP_GT_OQ>(a, b) }
    }
    #[inline(always)]
    fn equal(a: Self::F, b: Self::F) -> Self::F {
        unsafe { _mm256_cmp_ps::<_CMP_EQ_OQ>(a, b) }
    }
    #[inline(always)]
    fn neither(a: Self::F, b: Self::F) -> Self::F {
        unsafe { _mm256_xor_ps(_mm256_or_ps(a, b), _mm256_castsi256_ps(_mm256_set1_epi32(-1))) }
    }
    #[inline(always)]
    fn choose(mask: Self::F, yes: Self::F, no: Self::F) -> Self::F {
        unsafe { _mm256_blendv_ps(no, yes, mask) }
    }
    #[inline(always)]
    fn choose_i(mask: Self::F, yes: Self::I, no: Self::I) -> Self::I {
        unsafe {
            let (yes, no) = (_mm256_castsi256_ps(yes), _mm256_castsi256_ps(no));
            _mm256_castps_si256(_mm256_blendv_ps(no, yes, mask))
        }
    }
    #[inline(always)]
    fn splat_i(value: i32) -> Self::I {
        unsafe { _mm256_set1_epi32(value) }
    }
    #[inline(always)]
    fn ramp(start: i32, step: i32) -> Self::I {
        unsafe {
            let steps =
                _mm256_mullo_epi32(_mm256_set1_epi32(step), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
            _mm256_add_epi32(_mm256_set1_epi32(start), steps)
        }
    }
    #[inline(always)]
    fn add_i(a: Self::I, b: Self::I) -> Self::I {
        unsafe { _mm256_add_epi32(a, b) }
    }
    #[inline(always)]
    fn or_i(a: Self::I, b: Self::I) -> Self::I {
        unsafe { _mm256_or_si256(a, b) }
    }
    #[inline(always)]
    fn sub_i(a: Self::I, b: Self::I) -> Self::I {
        unsafe { _mm256_sub_epi32(a, b) }
    }
    #[inline(always)]
    fn mul_i(a: Self::I, b: Self::I) -> Self::I {
        unsafe { _mm256_mullo_epi32(a, b) }
    }
    #[inline(always)]
    fn min_i(a: Self::I, b: Self::I) -> Self::I {
        unsafe { _mm256_min_epi32(a, b) }
    }
    #[inline(always)]
    fn max_i(a: Self::I, b: Self::I) -> Self::I {
        unsafe { _mm256_max_epi32(a, b) }
    }
    #[inline(always)]
    fn shift_up<const BITS: i32>(a: Self::I) -> Self::I {
        unsafe { _mm256_slli_epi32::<BITS>(a) }
    }
    #[inline(always)]
    fn shift_down<const BITS: i32>(a: Self::I) -> Self::I {
        unsafe { _mm256_srai_epi32::<BITS>(a) }
    }
    #[inline(always)]
    fn load_i(from: &[i32; LANES]) -> Self::I {
        unsafe { _mm256_loadu_si256(from.as_ptr().cast()) }
    }
    #[inline(always)]
    fn store_i(values: Self::I, into: &mut [i32; LANES]) {
        unsafe { _mm256_storeu_si256(into.as_mut_ptr().cast(), values) }
    }
    #[inline(always)]
    fn splat_d(value: f64) -> Self::D {
        unsafe { [_mm256_set1_pd(value); 2] }
    }
    #[inline(always)]
    fn load_d(from: &[f64; LANES]) -> Self::D {
        unsafe { [0, LANES / 2].map(|i| _mm256_loadu_pd(from.as_ptr().add(i))) }
    }
    #[inline(always)]
    fn store_d(values: Self::D, into: &mut [f64; LANES]) {
        unsafe {
            _mm256_storeu_pd(into.as_mut_ptr(), values[0]);
            _mm256_storeu_pd(into.as_mut_ptr().add(LANES / 2), values[1]);
        }
    }
    #[inline(always)]
    fn to_d(a: Self::I) -> Self::D {
        unsafe {
            let (low, high) = (_mm256_castsi256_si128(a), _mm256_extracti128_si256::<1>(a));
            [_mm256_cvtepi32_pd(low), _mm256_cvtepi32_pd(high)]
        }
    }
    #[inline(always)]
    fn add_d(a: Self::D, b: Self::D) -> Self::D {
        unsafe { [_mm256_add_pd(a[0], b[0]), _mm256_add_pd(a[1], b[1])] }
    }
    #[inline(always)]
    fn sub_d(a: Self::D, b: Self::D) -> Self::D {
        unsafe { [_mm256_sub_pd(a[0], b[0]), _mm256_sub_pd(a[1], b[1])] }
    }
    #[inline(always)]
    fn mul_d(a: Self::D, b: Self::D) -> Self::D {
        unsafe { [_mm256_mul_pd(a[0], b[0]), _mm256_mul_pd(a[1], b[1])] }
    }
    #[inline(always)]
    fn div_d(a: Self::D, b: Self::D) -> Self::D {
        unsafe { [_mm256_div_pd(a[0], b[0]), _mm256_div_pd(a[1], b[1])] }
    }
    #[inline(always)]
    fn abs_d(a: Self::D) -> Self::D {
        unsafe { a.map(|a| _mm256_andnot_pd(_mm256_set1_pd(-0.0), a)) }
    }
    #[inline(always)]
    fn max_d(a: Self::D, b: Self::D) -> Self::D {
        unsafe { [_mm256_max_pd(a[0], b[0]), _mm256_max_pd(a[1], b[1])] }
    }
    #[inline(always)]
    fn to_f(a: Self::I) -> Self::F {
        unsafe { _mm256_cvtepi32_ps(a) }
    }
    #[inline(always)]
    fn where_negative(sign: Self::I, yes: Self::F, no: Self::F) -> Self::F {
        unsafe { _mm256_blendv_ps(no, yes, _mm256_castsi256_ps(sign)) }
    }
    #[inline(always)]
    fn unless_negative(sign: Self::I, value: Self::F) -> Self::F {
        unsafe { _mm256_andnot_ps(_mm256_castsi256_ps(_mm256_srai_epi32::<31>(sign)), value) }
    }
    #[inline(always)]
    fn max(a: Self::F, b: Self::F) -> Self::F {
        unsafe { _mm256_max_ps(a, b) }
    }
    #[inline(always)]
    fn largest(values: Self::F) -> f32 {
        unsafe {
            let half = _mm_max_ps(_mm256_castps256_ps128(values), _mm256_extractf128_ps::<1>(values));
            let pair = _mm_max_ps(half, _mm_movehl_ps(half, half));
            _mm_cvtss_f32(_mm_max_ss(pair, _mm_shuffle_ps::<1>(pair, pair)))
        }
    }
    #[inline(always)]
    fn larger(best: (Self::F, Self::I), other: (Self::F, Self::I)) -> (Self::F, Self::I) {
        unsafe { W::larger(best, other) }
    }
    #[inline(always)]
    fn min(a: Self::F, b: Self::F) -> Self::F {
        unsafe { _mm256_min_ps(a, b) }
    }
    #[inline(always)]
    fn sums([a, b, c, d]: [Self::F; 4]) -> [f32; 4] {
        unsafe {
            let pairs = _mm256_hadd_ps(_mm256_hadd_ps(a, b), _mm256_hadd_ps(c, d));
            let sums = _mm_add_ps(_mm256_castps256_ps128(pairs), _mm256_extractf128_ps::<1>(pairs));
            let mut into = [0.0; 4];
            _mm_storeu_ps(into.as_mut_ptr(), sums);
            into
        }
    }
    #[inline(always)]
    fn first_largest(values: Self::F, index: Self::I) -> (f32, i32) {
        unsafe {
            let largest = Self::largest(values);
            let is_it = _mm256_cmp_ps::<_CMP_EQ_OQ>(values, _mm256_set1_ps(largest));
            let index = Self::choose_i(is_it, index, _mm256_set1_epi32(i32::MAX));
            let half = _mm_min_epi32(_mm256_castsi256_si128(index), _mm256_extracti128_si256::<1>(index));
            let pair = _mm_min_epi32(half, _mm_unpackhi_epi64(half, half));
            let first = _mm_min_epi32(pair, _mm_shuffle_epi32::<1>(pair));
            (largest, _mm_cvtsi128_si32(first))
        }
    }
    #[inline(always)]
    fn compress(mask: Self::F, values: Self::F, into: &mut [f32], at: usize) -> usize {
        // One comparison, where a part of the slice would take three.
        if into.len() < LANES || at > into.len() - LANES {
            return 0;
        }
        unsafe {
            let (closed_up, count) = W::closed_up(mask, values);
            _mm256_storeu_ps(into.as_mut_ptr().add(at), closed_up);
            count
        }
    }
    #[inline(always)]
    fn count(mask: Self::F) -> usize {
        unsafe { _mm256_movemask_ps(mask).count_ones() as usize }
    }
    #[inline(always)]
    fn is_any(mask: Self::F) -> bool {
        unsafe { _mm256_movemask_ps(mask) != 0 }
    }
    #[inline(always)]
    fn tally(counts: Self::I, mask: Self::F) -> Self::I {
        // A lane that is set is -1.
        unsafe { _mm256_sub_epi32(counts, _mm256_castps_si256(mask)) }
    }
    #[inline(always)]
    fn apart<P: Part<Self>>(part: P) -> P::Output {
        W::apart(part)
    }
}

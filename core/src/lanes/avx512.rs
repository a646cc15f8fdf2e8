//! Lanes by AVX2, and two vectors of them as one by AVX-512.
//!
//! SAFETY of all that follows: as in `avx2`.

use super::avx2::{Avx, Width};
use super::{Kernel, Pair, Part, LANES};
use std::arch::x86_64::*;

#[target_feature(enable = "avx2,popcnt,avx512f,avx512vl,avx512vbmi2")]
pub(super) unsafe fn run<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Avx512>()
}

#[inline(never)]
#[target_feature(enable = "avx2,popcnt,avx512f,avx512vl,avx512vbmi2")]
unsafe fn run_part<P: Part<Avx512>>(part: P) -> P::Output {
    part.run()
}

pub type Avx512 = Avx<One>;

/// Two vectors are one.
#[derive(Clone, Copy)]
pub struct One;

impl Width for One {
    type Pair = __m512;

    #[inline(always)]
    unsafe fn closed_up(mask: __m256, values: __m256) -> (__m256, usize) {
        let mask = _mm256_cmplt_epi32_mask(_mm256_castps_si256(mask), _mm256_setzero_si256());
        (_mm256_maskz_compress_ps(mask, values), mask.count_ones() as usize)
    }

    #[inline(always)]
    unsafe fn larger(best: (__m256, __m256i), other: (__m256, __m256i)) -> (__m256, __m256i) {
        let is_larger = _mm256_cmp_ps_mask::<_CMP_GT_OQ>(other.0, best.0);
        (_mm256_max_ps(other.0, best.0), _mm256_mask_mov_epi32(best.1, is_larger, other.1))
    }

    #[inline(always)]
    fn apart<P: Part<Avx512>>(part: P) -> P::Output {
        unsafe { run_part(part) }
    }
}

#[inline(always)]
unsafe fn both(left: __m256i, right: __m256i) -> __m512i {
    _mm512_inserti64x4::<1>(_mm512_castsi256_si512(left), right)
}

impl Pair<Avx512> for __m512 {
    type Edge = __m512i;
    type Ints = __m512i;

    #[inline(always)]
    fn join(left: __m256, right: __m256) -> Self {
        unsafe {
            let left = _mm512_castpd256_pd512(_mm256_castps_pd(left));
            _mm512_castpd_ps(_mm512_insertf64x4::<1>(left, _mm256_castps_pd(right)))
        }
    }
    #[inline(always)]
    fn edge(left: __m256i, beyond: __m256i) -> __m512i {
        unsafe { both(left, _mm256_add_epi32(left, beyond)) }
    }
    #[inline(always)]
    fn ramp(start: i32, step: i32) -> __m512i {
        unsafe {
            let lanes = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
            let steps = _mm512_mullo_epi32(_mm512_set1_epi32(step), lanes);
            _mm512_add_epi32(_mm512_set1_epi32(start), steps)
        }
    }
    #[inline(always)]
    fn step(edge: __m512i, by: __m256i) -> __m512i {
        unsafe { _mm512_add_epi32(edge, both(by, by)) }
    }
    #[inline(always)]
    fn either([a, b, c]: [__m512i; 3]) -> __m512i {
        unsafe { _mm512_or_si512(_mm512_or_si512(a, b), c) }
    }
    #[inline(always)]
    fn halves(self) -> [__m256; 2] {
        unsafe {
            let right = _mm512_extractf64x4_pd::<1>(_mm512_castps_pd(self));
            [_mm512_castps512_ps256(self), _mm256_castpd_ps(right)]
        }
    }
    #[inline(always)]
    fn ints(edge: __m512i) -> __m512i {
        edge
    }
    #[inline(always)]
    fn half_ints(ints: __m512i) -> [__m256i; 2] {
        unsafe { [_mm512_castsi512_si256(ints), _mm512_extracti64x4_epi64::<1>(ints)] }
    }
    #[inline(always)]
    fn larger((best, places): (Self, __m512i), errors: Self, at: __m512i) -> (Self, __m512i) {
        unsafe {
            let is_larger = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(errors, best);
            (_mm512_max_ps(errors, best), _mm512_mask_mov_epi32(places, is_larger, at))
        }
    }
    #[inline(always)]
    fn load(from: &[f32; 2 * LANES]) -> Self {
        unsafe { _mm512_loadu_ps(from.as_ptr()) }
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        unsafe { _mm512_add_ps(self, other) }
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        unsafe { _mm512_sub_ps(self, other) }
    }
    #[inline(always)]
    fn abs(self) -> Self {
        unsafe { _mm512_abs_ps(self) }
    }
    #[inline(always)]
    fn where_negative(self, sign: __m512i, value: f32) -> Self {
        unsafe {
            let is_negative = _mm512_cmplt_epi32_mask(sign, _mm512_setzero_si512());
            _mm512_mask_blend_ps(is_negative, self, _mm512_set1_ps(value))
        }
    }
    #[inline(always)]
    fn compress(self, least: f32, into: &mut [f32], at: usize) -> usize {
        if into.len() < 2 * LANES || at > into.len() - 2 * LANES {
            return 0;
        }
        unsafe {
            let mask = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(self, _mm512_set1_ps(least));
            let closed_up = _mm512_maskz_compress_ps(mask, self);
            _mm512_storeu_ps(into.as_mut_ptr().add(at), closed_up);
            mask.count_ones() as usize
        }
    }
    #[inline(always)]
    fn sift(self, (from, to): (f32, f32), into: &mut [f32], at: usize) -> (usize, usize) {
        if into.len() < 2 * LANES || at > into.len() - 2 * LANES {
            return (0, 0);
        }
        unsafe {
            let under = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self, _mm512_set1_ps(from));
            let within = !under & _mm512_cmp_ps_mask::<_CMP_LE_OQ>(self, _mm512_set1_ps(to));
            let closed_up = _mm512_maskz_compress_ps(within, self);
            _mm512_storeu_ps(into.as_mut_ptr().add(at), closed_up);
            (under.count_ones() as usize, within.count_ones() as usize)
        }
    }
    #[inline(always)]
    fn tally(self, counts: __m512i, value: f32) -> __m512i {
        unsafe {
            let is_greater = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(self, _mm512_set1_ps(value));
            _mm512_mask_add_epi32(counts, is_greater, counts, _mm512_set1_epi32(1))
        }
    }
    #[inline(always)]
    fn less(value: i32, ints: __m512i) -> __m512i {
        unsafe { _mm512_sub_epi32(_mm512_set1_epi32(value), ints) }
    }
}

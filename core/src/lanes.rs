//! Eight numbers at a time: AVX2 where the machine has it, plain arrays elsewhere, with the
//! same bits as the result. The only module with `unsafe` code.

#![allow(unsafe_code)]

/// How many numbers an operation works on.
pub const LANES: usize = 8;

/// Operations on vectors of `f32` (`F`) and `i32` (`I`).
pub trait Lanes: Copy {
    type F: Copy;
    type I: Copy;

    fn splat(value: f32) -> Self::F;
    fn load(from: &[f32; LANES]) -> Self::F;
    fn add(a: Self::F, b: Self::F) -> Self::F;
    fn sub(a: Self::F, b: Self::F) -> Self::F;
    fn mul(a: Self::F, b: Self::F) -> Self::F;
    fn abs(a: Self::F) -> Self::F;
    /// A mask of the lanes where a > b, both being numbers.
    fn greater(a: Self::F, b: Self::F) -> Self::F;
    /// A mask of the lanes that two others leave out.
    fn neither(a: Self::F, b: Self::F) -> Self::F;
    /// `yes` in the lanes of the mask, `no` elsewhere.
    fn choose(mask: Self::F, yes: Self::F, no: Self::F) -> Self::F;
    fn choose_i(mask: Self::F, yes: Self::I, no: Self::I) -> Self::I;
    fn splat_i(value: i32) -> Self::I;
    /// start, start + step, start + 2 step, ...
    fn ramp(start: i32, step: i32) -> Self::I;
    fn add_i(a: Self::I, b: Self::I) -> Self::I;
    fn or_i(a: Self::I, b: Self::I) -> Self::I;
    fn to_f(a: Self::I) -> Self::F;
    /// `yes` where `sign` is negative, `no` elsewhere.
    fn where_negative(sign: Self::I, yes: Self::F, no: Self::F) -> Self::F;
    /// The larger of two, `b` where `a` is no number.
    fn max(a: Self::F, b: Self::F) -> Self::F;
    fn largest(values: Self::F) -> f32;
    /// The largest of the values and the smallest index that goes with it.
    fn first_largest(values: Self::F, index: Self::I) -> (f32, i32);
    /// Writes the lanes of the mask, closed up, to the front of `into` (what follows
    /// them there is undefined) and says how many they are.
    fn compress(mask: Self::F, values: Self::F, into: &mut [f32; LANES]) -> usize;
    /// Lanes of the mask.
    fn count(mask: Self::F) -> usize;
    /// One more in the lanes of the mask.
    fn tally(counts: Self::I, mask: Self::F) -> Self::I;
}

/// Work written once for all vectors.
pub trait Kernel {
    type Output;
    /// Must be `#[inline(always)]`, to be compiled for the vectors at hand.
    fn run<L: Lanes>(self) -> Self::Output;
}

/// The vectors to work with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Vectors {
    Plain,
    #[cfg(target_arch = "x86_64")]
    Avx2,
}

impl Vectors {
    /// The widest that this machine has.
    pub fn best() -> Self {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("popcnt") {
            return Vectors::Avx2;
        }
        Vectors::Plain
    }

    #[inline(always)]
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self {
            Vectors::Plain => kernel.run::<Plain>(),
            // SAFETY: made by `best` alone outside tests, after a look at the machine.
            #[cfg(target_arch = "x86_64")]
            Vectors::Avx2 => unsafe { avx2::run(kernel) },
        }
    }
}

/// Arrays, which the compiler turns into what vectors every machine of its kind has.
#[derive(Clone, Copy)]
pub struct Plain;

#[inline(always)]
fn each<A: Copy, R>(a: [A; LANES], f: impl Fn(A) -> R) -> [R; LANES] {
    a.map(f)
}

#[inline(always)]
fn both<A: Copy, B: Copy, R>(a: [A; LANES], b: [B; LANES], f: impl Fn(A, B) -> R) -> [R; LANES] {
    std::array::from_fn(|i| f(a[i], b[i]))
}

const TRUE: f32 = f32::from_bits(u32::MAX);

#[inline(always)]
fn is_set(mask: f32) -> bool {
    mask.to_bits() >> 31 != 0
}

impl Lanes for Plain {
    type F = [f32; LANES];
    type I = [i32; LANES];

    #[inline(always)]
    fn splat(value: f32) -> Self::F {
        [value; LANES]
    }
    #[inline(always)]
    fn load(from: &[f32; LANES]) -> Self::F {
        *from
    }
    #[inline(always)]
    fn add(a: Self::F, b: Self::F) -> Self::F {
        both(a, b, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(a: Self::F, b: Self::F) -> Self::F {
        both(a, b, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(a: Self::F, b: Self::F) -> Self::F {
        both(a, b, |a, b| a * b)
    }
    #[inline(always)]
    fn abs(a: Self::F) -> Self::F {
        each(a, f32::abs)
    }
    #[inline(always)]
    fn greater(a: Self::F, b: Self::F) -> Self::F {
        both(a, b, |a, b| if a > b { TRUE } else { 0.0 })
    }
    #[inline(always)]
    fn neither(a: Self::F, b: Self::F) -> Self::F {
        both(a, b, |a, b| if is_set(a) || is_set(b) { 0.0 } else { TRUE })
    }
    #[inline(always)]
    fn choose(mask: Self::F, yes: Self::F, no: Self::F) -> Self::F {
        std::array::from_fn(|i| if is_set(mask[i]) { yes[i] } else { no[i] })
    }
    #[inline(always)]
    fn choose_i(mask: Self::F, yes: Self::I, no: Self::I) -> Self::I {
        std::array::from_fn(|i| if is_set(mask[i]) { yes[i] } else { no[i] })
    }
    #[inline(always)]
    fn splat_i(value: i32) -> Self::I {
        [value; LANES]
    }
    #[inline(always)]
    fn ramp(start: i32, step: i32) -> Self::I {
        std::array::from_fn(|i| start.wrapping_add(step.wrapping_mul(i as i32)))
    }
    #[inline(always)]
    fn add_i(a: Self::I, b: Self::I) -> Self::I {
        both(a, b, i32::wrapping_add)
    }
    #[inline(always)]
    fn or_i(a: Self::I, b: Self::I) -> Self::I {
        both(a, b, |a, b| a | b)
    }
    #[inline(always)]
    fn to_f(a: Self::I) -> Self::F {
        each(a, |a| a as f32)
    }
    #[inline(always)]
    fn where_negative(sign: Self::I, yes: Self::F, no: Self::F) -> Self::F {
        std::array::from_fn(|i| if sign[i] < 0 { yes[i] } else { no[i] })
    }
    #[inline(always)]
    fn max(a: Self::F, b: Self::F) -> Self::F {
        both(a, b, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn largest(values: Self::F) -> f32 {
        values.iter().fold(f32::NEG_INFINITY, |a, &b| if b > a { b } else { a })
    }
    #[inline(always)]
    fn first_largest(values: Self::F, index: Self::I) -> (f32, i32) {
        let largest = Self::largest(values);
        let at = values.iter().zip(index).filter(|(&v, _)| v == largest).map(|(_, i)| i).min();
        (largest, at.unwrap_or(i32::MAX))
    }
    #[inline(always)]
    fn compress(mask: Self::F, values: Self::F, into: &mut [f32; LANES]) -> usize {
        let mut count = 0;
        for i in 0..LANES {
            into[count.min(LANES - 1)] = values[i];
            count += usize::from(is_set(mask[i]));
        }
        count
    }
    #[inline(always)]
    fn count(mask: Self::F) -> usize {
        mask.iter().filter(|&&m| is_set(m)).count()
    }
    #[inline(always)]
    fn tally(counts: Self::I, mask: Self::F) -> Self::I {
        both(counts, mask, |count, m| count + i32::from(is_set(m)))
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    //! SAFETY of all that follows: the instructions are there, since only `Vectors::run` leads
    //! here; loads and stores go through references to arrays of the right length.

    use super::{Kernel, Lanes, LANES};
    use std::arch::x86_64::*;

    #[target_feature(enable = "avx2,popcnt")]
    pub(super) unsafe fn run<K: Kernel>(kernel: K) -> K::Output {
        kernel.run::<Avx2>()
    }

    #[derive(Clone, Copy)]
    pub struct Avx2;

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

    #[inline(always)]
    unsafe fn to_front(mask: i32) -> __m256i {
        _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(FRONT[(mask & 255) as usize] as i64))
    }

    impl Lanes for Avx2 {
        type F = __m256;
        type I = __m256i;

        #[inline(always)]
        fn splat(value: f32) -> Self::F {
            unsafe { _mm256_set1_ps(value) }
        }
        #[inline(always)]
        fn load(from: &[f32; LANES]) -> Self::F {
            unsafe { _mm256_loadu_ps(from.as_ptr()) }
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
        fn to_f(a: Self::I) -> Self::F {
            unsafe { _mm256_cvtepi32_ps(a) }
        }
        #[inline(always)]
        fn where_negative(sign: Self::I, yes: Self::F, no: Self::F) -> Self::F {
            unsafe { _mm256_blendv_ps(no, yes, _mm256_castsi256_ps(sign)) }
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
        fn compress(mask: Self::F, values: Self::F, into: &mut [f32; LANES]) -> usize {
            unsafe {
                let bits = _mm256_movemask_ps(mask);
                _mm256_storeu_ps(into.as_mut_ptr(), _mm256_permutevar8x32_ps(values, to_front(bits)));
                bits.count_ones() as usize
            }
        }
        #[inline(always)]
        fn count(mask: Self::F) -> usize {
            unsafe { _mm256_movemask_ps(mask).count_ones() as usize }
        }
        #[inline(always)]
        fn tally(counts: Self::I, mask: Self::F) -> Self::I {
            // A lane that is set is -1.
            unsafe { _mm256_sub_epi32(counts, _mm256_castps_si256(mask)) }
        }
    }
}

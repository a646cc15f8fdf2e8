//! Eight numbers at a time: AVX2 where the machine has it, plain arrays elsewhere, with the
//! same bits as the result. Here and in `avx2` is all `unsafe` code.

#![allow(unsafe_code)]

#[cfg(target_arch = "x86_64")]
mod avx2;
mod plain;

pub use plain::Plain;

/// How many numbers an operation works on.
pub const LANES: usize = 8;

/// Operations on vectors of `f32` (`F`), `i32` (`I`) and `f64` (`D`). Integers wrap around.
pub trait Lanes: Copy {
    type F: Copy;
    type I: Copy;
    type D: Copy;

    fn splat(value: f32) -> Self::F;
    fn load(from: &[f32; LANES]) -> Self::F;
    fn add(a: Self::F, b: Self::F) -> Self::F;
    fn sub(a: Self::F, b: Self::F) -> Self::F;
    fn mul(a: Self::F, b: Self::F) -> Self::F;
    fn abs(a: Self::F) -> Self::F;
    /// A mask of the lanes where a > b, both being numbers.
    fn greater(a: Self::F, b: Self::F) -> Self::F;
    /// A mask of the lanes where a = b, both being numbers.
    fn equal(a: Self::F, b: Self::F) -> Self::F;
    /// A mask of the lanes that two others leave out.
    fn neither(a: Self::F, b: Self::F) -> Self::F;
    /// `yes` in the lanes of the mask, `no` elsewhere.
    fn choose(mask: Self::F, yes: Self::F, no: Self::F) -> Self::F;
    fn choose_i(mask: Self::F, yes: Self::I, no: Self::I) -> Self::I;
    fn splat_i(value: i32) -> Self::I;
    /// start, start + step, start + 2 step, ...
    fn ramp(start: i32, step: i32) -> Self::I;
    fn add_i(a: Self::I, b: Self::I) -> Self::I;
    fn sub_i(a: Self::I, b: Self::I) -> Self::I;
    fn mul_i(a: Self::I, b: Self::I) -> Self::I;
    fn min_i(a: Self::I, b: Self::I) -> Self::I;
    fn max_i(a: Self::I, b: Self::I) -> Self::I;
    fn or_i(a: Self::I, b: Self::I) -> Self::I;
    fn shift_up<const BITS: i32>(a: Self::I) -> Self::I;
    fn shift_down<const BITS: i32>(a: Self::I) -> Self::I;
    fn load_i(from: &[i32; LANES]) -> Self::I;
    fn store_i(values: Self::I, into: &mut [i32; LANES]);
    fn splat_d(value: f64) -> Self::D;
    fn load_d(from: &[f64; LANES]) -> Self::D;
    fn store_d(values: Self::D, into: &mut [f64; LANES]);
    fn to_d(a: Self::I) -> Self::D;
    fn add_d(a: Self::D, b: Self::D) -> Self::D;
    fn sub_d(a: Self::D, b: Self::D) -> Self::D;
    fn mul_d(a: Self::D, b: Self::D) -> Self::D;
    fn div_d(a: Self::D, b: Self::D) -> Self::D;
    fn abs_d(a: Self::D) -> Self::D;
    /// The larger of two, `b` where either is no number.
    fn max_d(a: Self::D, b: Self::D) -> Self::D;
    fn to_f(a: Self::I) -> Self::F;
    /// `yes` where `sign` is negative, `no` elsewhere.
    fn where_negative(sign: Self::I, yes: Self::F, no: Self::F) -> Self::F;
    /// The larger of two, `b` where `a` is no number.
    fn max(a: Self::F, b: Self::F) -> Self::F;
    fn largest(values: Self::F) -> f32;
    /// The smaller of two, `b` where `a` is no number.
    fn min(a: Self::F, b: Self::F) -> Self::F;
    /// The sums over the lanes of each.
    fn sums(values: [Self::F; 4]) -> [f32; 4];
    /// The largest of the values and the smallest index that goes with it.
    fn first_largest(values: Self::F, index: Self::I) -> (f32, i32);
    /// Writes the lanes of the mask, closed up, from `at` on (what is in a vector's place after
    /// them is undefined) and says how many they are; none where there is no place for a vector.
    fn compress(mask: Self::F, values: Self::F, into: &mut [f32], at: usize) -> usize;
    /// Lanes of the mask.
    fn count(mask: Self::F) -> usize;
    fn is_any(mask: Self::F) -> bool;
    /// One more in the lanes of the mask.
    fn tally(counts: Self::I, mask: Self::F) -> Self::I;
    /// Has memory send what lies there to the cache.
    fn prefetch<T>(there: &T);
    /// Runs what is rare in a function of its own, so that it takes no registers from what is not.
    fn apart<W: Part<Self>>(part: W) -> W::Output;
}

/// Work written once for all vectors.
pub trait Kernel {
    type Output;
    /// Must be `#[inline(always)]`, to be compiled for the vectors at hand.
    fn run<L: Lanes>(self) -> Self::Output;
}

/// A part of a kernel.
pub trait Part<L: Lanes> {
    type Output;
    /// Must be `#[inline(always)]`, too.
    fn run(self) -> Self::Output;
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

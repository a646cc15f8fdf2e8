//! Eight numbers at a time, or twice eight: AVX-512 or AVX2 where the machine has it, plain arrays elsewhere,
//! with the same bits as the result. Here and in `avx2` and `avx512` is all `unsafe` code.

#![allow(unsafe_code)]

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod plain;

pub use plain::Plain;

/// How many numbers an operation works on.
pub const LANES: usize = 8;

/// Operations on vectors of `f32` (`F`), `i32` (`I`) and `f64` (`D`). Integers wrap around.
pub trait Lanes: Copy {
    type F: Copy;
    type I: Copy;
    type D: Copy;
    type Pair: Pair<Self>;

    fn splat(value: f32) -> Self::F;
    fn load(from: &[f32; LANES]) -> Self::F;
    fn store(values: Self::F, into: &mut [f32; LANES]);
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
    /// 0 where `sign` is negative, `value` elsewhere.
    fn unless_negative(sign: Self::I, value: Self::F) -> Self::F;
    /// The larger of two, `b` where `a` is no number.
    fn max(a: Self::F, b: Self::F) -> Self::F;
    fn largest(values: Self::F) -> f32;
    /// Lane by lane the larger of two and the number that goes with it, the first of two alike and where the second is
    /// no number.
    fn larger(best: (Self::F, Self::I), other: (Self::F, Self::I)) -> (Self::F, Self::I);
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
    /// Runs what is rare in a function of its own, so that it takes no registers from what is not.
    fn apart<W: Part<Self>>(part: W) -> W::Output;
}

/// Two vectors of `f32` beside each other, in one where the machine has such.
pub trait Pair<L: Lanes>: Copy {
    /// Two vectors of `i32`, the right one so much larger than the left one.
    type Edge: Copy;
    /// Two vectors of `i32`, whatever these are.
    type Ints: Copy;

    fn join(left: L::F, right: L::F) -> Self;
    fn edge(left: L::I, beyond: L::I) -> Self::Edge;
    /// As [`Lanes::ramp`].
    fn ramp(start: i32, step: i32) -> Self::Edge;
    /// The same added to both.
    fn step(edge: Self::Edge, by: L::I) -> Self::Edge;
    /// Negative where one of the edges is.
    fn either(edges: [Self::Edge; 3]) -> Self::Ints;
    fn halves(self) -> [L::F; 2];
    fn ints(edge: Self::Edge) -> Self::Ints;
    fn half_ints(ints: Self::Ints) -> [L::I; 2];
    /// As [`Lanes::larger`].
    fn larger(best: (Self, Self::Ints), errors: Self, at: Self::Edge) -> (Self, Self::Ints);
    fn load(from: &[f32; 2 * LANES]) -> Self;
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    fn abs(self) -> Self;
    /// `value` where `sign` is negative, and otherwise as it is.
    fn where_negative(self, sign: Self::Ints, value: f32) -> Self;
    /// As [`Lanes::compress`] of what is greater than `least`.
    fn compress(self, least: f32, into: &mut [f32], at: usize) -> usize;
    /// As [`Lanes::compress`] of what lies between two numbers or is one of them; and how many lanes are under these.
    fn sift(self, range: (f32, f32), into: &mut [f32], at: usize) -> (usize, usize);
    /// One more in the lanes that are greater than `value`.
    fn tally(self, counts: Self::Ints, value: f32) -> Self::Ints;
    /// `value` less the numbers.
    fn less(value: i32, ints: Self::Ints) -> Self::Ints;
}

impl<L: Lanes> Pair<L> for [L::F; 2] {
    /// The left vector and what the right one is larger by: fewer to keep at hand.
    type Edge = [L::I; 2];
    type Ints = [L::I; 2];

    #[inline(always)]
    fn join(left: L::F, right: L::F) -> Self {
        [left, right]
    }
    #[inline(always)]
    fn edge(left: L::I, beyond: L::I) -> Self::Edge {
        [left, beyond]
    }
    #[inline(always)]
    fn ramp(start: i32, step: i32) -> Self::Edge {
        [L::ramp(start, step), L::splat_i(step.wrapping_mul(LANES as i32))]
    }
    #[inline(always)]
    fn step([left, beyond]: Self::Edge, by: L::I) -> Self::Edge {
        [L::add_i(left, by), beyond]
    }
    #[inline(always)]
    fn either(edges: [Self::Edge; 3]) -> Self::Ints {
        let either = |[a, b, c]: [L::I; 3]| L::or_i(L::or_i(a, b), c);
        [either(edges.map(|[left, _]| left)), either(edges.map(|[left, beyond]| L::add_i(left, beyond)))]
    }
    #[inline(always)]
    fn halves(self) -> [L::F; 2] {
        self
    }
    #[inline(always)]
    fn ints([left, beyond]: Self::Edge) -> Self::Ints {
        [left, L::add_i(left, beyond)]
    }
    #[inline(always)]
    fn half_ints(ints: Self::Ints) -> [L::I; 2] {
        ints
    }
    #[inline(always)]
    fn larger((best, places): (Self, Self::Ints), errors: Self, at: Self::Edge) -> (Self, Self::Ints) {
        let at = <Self as Pair<L>>::ints(at);
        let left = L::larger((best[0], places[0]), (errors[0], at[0]));
        let right = L::larger((best[1], places[1]), (errors[1], at[1]));
        ([left.0, right.0], [left.1, right.1])
    }
    #[inline(always)]
    fn load(from: &[f32; 2 * LANES]) -> Self {
        let (halves, _) = from.as_chunks();
        [L::load(&halves[0]), L::load(&halves[1])]
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        [L::add(self[0], other[0]), L::add(self[1], other[1])]
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        [L::sub(self[0], other[0]), L::sub(self[1], other[1])]
    }
    #[inline(always)]
    fn abs(self) -> Self {
        self.map(L::abs)
    }
    #[inline(always)]
    fn where_negative(self, sign: Self::Ints, value: f32) -> Self {
        let value = L::splat(value);
        [L::where_negative(sign[0], value, self[0]), L::where_negative(sign[1], value, self[1])]
    }
    #[inline(always)]
    fn compress(self, least: f32, into: &mut [f32], at: usize) -> usize {
        let least = L::splat(least);
        let count = L::compress(L::greater(self[0], least), self[0], into, at);
        count + L::compress(L::greater(self[1], least), self[1], into, at + count)
    }
    #[inline(always)]
    fn sift(self, (from, to): (f32, f32), into: &mut [f32], at: usize) -> (usize, usize) {
        let (from, to) = (L::splat(from), L::splat(to));
        let under = [L::greater(from, self[0]), L::greater(from, self[1])];
        let within =
            [L::neither(under[0], L::greater(self[0], to)), L::neither(under[1], L::greater(self[1], to))];
        let count = L::compress(within[0], self[0], into, at);
        let count = count + L::compress(within[1], self[1], into, at + count);
        (L::count(under[0]) + L::count(under[1]), count)
    }
    #[inline(always)]
    fn tally(self, counts: Self::Ints, value: f32) -> Self::Ints {
        let value = L::splat(value);
        [L::tally(counts[0], L::greater(self[0], value)), L::tally(counts[1], L::greater(self[1], value))]
    }
    #[inline(always)]
    fn less(value: i32, ints: Self::Ints) -> Self::Ints {
        let value = L::splat_i(value);
        [L::sub_i(value, ints[0]), L::sub_i(value, ints[1])]
    }
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
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Vectors {
    /// The widest that this machine has.
    pub fn best() -> Self {
        Vectors::all().last().unwrap_or(Vectors::Plain)
    }

    /// All that this machine has, the widest last.
    pub fn all() -> impl Iterator<Item = Self> {
        let all = [
            Vectors::Plain,
            #[cfg(target_arch = "x86_64")]
            Vectors::Avx2,
            #[cfg(target_arch = "x86_64")]
            Vectors::Avx512,
        ];
        all.into_iter().filter(|vectors| vectors.is_there())
    }

    fn is_there(self) -> bool {
        match self {
            Vectors::Plain => true,
            #[cfg(target_arch = "x86_64")]
            Vectors::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("popcnt"),
            // Machines with AVX-512 but without VBMI2 slow down for a while after instructions on so many lanes.
            #[cfg(target_arch = "x86_64")]
            Vectors::Avx512 => {
                Vectors::Avx2.is_there()
                    && is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512vl")
                    && is_x86_feature_detected!("avx512vbmi2")
            }
        }
    }

    #[inline(always)]
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self {
            Vectors::Plain => kernel.run::<Plain>(),
            // SAFETY: made by `all` alone, after a look at the machine.
            #[cfg(target_arch = "x86_64")]
            Vectors::Avx2 => unsafe { avx2::run(kernel) },
            // SAFETY: likewise.
            #[cfg(target_arch = "x86_64")]
            Vectors::Avx512 => unsafe { avx512::run(kernel) },
        }
    }
}

/// Has memory send what lies there to the cache, if the machine can be asked to.
#[inline(always)]
pub fn prefetch<T>(there: &T) {
    // SAFETY: it is there; and nothing comes of it but that.
    #[cfg(target_arch = "x86_64")]
    unsafe {
        use std::arch::x86_64::{_mm_prefetch, _MM_HINT_T0};
        _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(there).cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = there;
}

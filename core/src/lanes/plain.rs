//! Lanes without special instructions.

use super::{Lanes, Part, LANES};

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
    type D = [f64; LANES];
    type Pair = [Self::F; 2];

    #[inline(always)]
    fn splat(value: f32) -> Self::F {
        [value; LANES]
    }
    #[inline(always)]
    fn load(from: &[f32; LANES]) -> Self::F {
        *from
    }
    #[inline(always)]
    fn store(values: Self::F, into: &mut [f32; LANES]) {
        *into = values;
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
    fn equal(a: Self::F, b: Self::F) -> Self::F {
        both(a, b, |a, b| if a == b { TRUE } else { 0.0 })
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
    fn sub_i(a: Self::I, b: Self::I) -> Self::I {
        both(a, b, i32::wrapping_sub)
    }
    #[inline(always)]
    fn mul_i(a: Self::I, b: Self::I) -> Self::I {
        both(a, b, i32::wrapping_mul)
    }
    #[inline(always)]
    fn min_i(a: Self::I, b: Self::I) -> Self::I {
        both(a, b, i32::min)
    }
    #[inline(always)]
    fn max_i(a: Self::I, b: Self::I) -> Self::I {
        both(a, b, i32::max)
    }
    #[inline(always)]
    fn shift_up<const BITS: i32>(a: Self::I) -> Self::I {
        each(a, |a| a << BITS)
    }
    #[inline(always)]
    fn shift_down<const BITS: i32>(a: Self::I) -> Self::I {
        each(a, |a| a >> BITS)
    }
    #[inline(always)]
    fn load_i(from: &[i32; LANES]) -> Self::I {
        *from
    }
    #[inline(always)]
    fn store_i(values: Self::I, into: &mut [i32; LANES]) {
        *into = values;
    }
    #[inline(always)]
    fn splat_d(value: f64) -> Self::D {
        [value; LANES]
    }
    #[inline(always)]
    fn load_d(from: &[f64; LANES]) -> Self::D {
        *from
    }
    #[inline(always)]
    fn store_d(values: Self::D, into: &mut [f64; LANES]) {
        *into = values;
    }
    #[inline(always)]
    fn to_d(a: Self::I) -> Self::D {
        each(a, f64::from)
    }
    #[inline(always)]
    fn add_d(a: Self::D, b: Self::D) -> Self::D {
        both(a, b, |a, b| a + b)
    }
    #[inline(always)]
    fn sub_d(a: Self::D, b: Self::D) -> Self::D {
        both(a, b, |a, b| a - b)
    }
    #[inline(always)]
    fn mul_d(a: Self::D, b: Self::D) -> Self::D {
        both(a, b, |a, b| a * b)
    }
    #[inline(always)]
    fn div_d(a: Self::D, b: Self::D) -> Self::D {
        both(a, b, |a, b| a / b)
    }
    #[inline(always)]
    fn abs_d(a: Self::D) -> Self::D {
        each(a, f64::abs)
    }
    #[inline(always)]
    fn max_d(a: Self::D, b: Self::D) -> Self::D {
        both(a, b, |a, b| if a > b { a } else { b })
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
    fn unless_negative(sign: Self::I, value: Self::F) -> Self::F {
        std::array::from_fn(|i| if sign[i] < 0 { 0.0 } else { value[i] })
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
    fn larger(best: (Self::F, Self::I), other: (Self::F, Self::I)) -> (Self::F, Self::I) {
        let is_larger = Self::greater(other.0, best.0);
        (Self::max(other.0, best.0), Self::choose_i(is_larger, other.1, best.1))
    }
    #[inline(always)]
    fn min(a: Self::F, b: Self::F) -> Self::F {
        both(a, b, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn sums(values: [Self::F; 4]) -> [f32; 4] {
        values.map(|v| ((v[0] + v[1]) + (v[2] + v[3])) + ((v[4] + v[5]) + (v[6] + v[7])))
    }
    #[inline(always)]
    fn first_largest(values: Self::F, index: Self::I) -> (f32, i32) {
        let largest = Self::largest(values);
        let at = values.iter().zip(index).filter(|(&v, _)| v == largest).map(|(_, i)| i).min();
        (largest, at.unwrap_or(i32::MAX))
    }
    #[inline(always)]
    fn compress(mask: Self::F, values: Self::F, into: &mut [f32], at: usize) -> usize {
        let Some(into) = into.get_mut(at..).and_then(|into| into.first_chunk_mut::<LANES>()) else {
            return 0;
        };
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
    fn is_any(mask: Self::F) -> bool {
        mask.iter().any(|&m| is_set(m))
    }
    #[inline(always)]
    fn tally(counts: Self::I, mask: Self::F) -> Self::I {
        both(counts, mask, |count, m| count + i32::from(is_set(m)))
    }
    #[inline(never)]
    fn apart<W: Part<Self>>(part: W) -> W::Output {
        part.run()
    }
}

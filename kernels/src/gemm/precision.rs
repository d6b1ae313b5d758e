//! The number formats of products, and rounding to them.

use crate::simd::{LANES, Simd};

/// The format in which a product's operands are held. Sums, bias, functions and residuals are f32 in all of them.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Precision {
    /// f32, as given.
    #[default]
    F32,
    /// bf16: 8 bits of significand, rounded to nearest even; magnitudes below 2⁻⁵⁶ become 0.
    Bf16,
    /// 8-bit integers: weights with a scale per output channel, inputs with a scale per row.
    Int8,
}

/// The smallest magnitude that bf16 operands keep.
///
/// Their products are whole multiples of 2⁻¹²⁶, and so is every sum of them: none is near the denormal numbers, which the
/// instructions for bf16 flush in their own way.
pub(crate) const SMALLEST: f32 = f32::from_bits((127 - 56) << 23);

/// The nearest bf16, as f32. NaN stays NaN.
#[inline(always)]
pub(crate) fn round_bf16<S: Simd>(s: S, x: S::F32) -> S::F32 {
    let bits = s.to_bits(x);
    let odd = s.and_i32(s.shr::<16>(bits), s.splat_i32(1));
    let rounded = s.add_i32(bits, s.add_i32(odd, s.splat_i32(0x7fff)));
    let rounded = s.from_bits(s.and_i32(rounded, s.splat_i32(0xffff_0000_u32.cast_signed())));
    let rounded = s.select(s.eq(x, x), rounded, s.splat(f32::NAN));
    s.select(s.lt(s.abs(x), s.splat(SMALLEST)), s.splat(0.0), rounded)
}

/// [`round_bf16`] of one value.
pub(crate) fn round_bf16_scalar(x: f32) -> f32 {
    if x.is_nan() {
        f32::NAN
    } else if x.abs() < SMALLEST {
        0.0
    } else {
        let bits = x.to_bits();
        f32::from_bits((bits + 0x7fff + (bits >> 16 & 1)) & 0xffff_0000)
    }
}

/// Two bf16, held as f32, in one word: `first` in the high half.
#[inline(always)]
pub(crate) fn pair(first: f32, second: f32) -> u32 {
    (first.to_bits() & 0xffff_0000) | second.to_bits() >> 16
}

/// [`pair`] of two vectors of values that are bf16.
#[inline(always)]
pub(crate) fn pair_bf16<S: Simd>(s: S, first: S::F32, second: S::F32) -> S::I32 {
    s.or_i32(s.to_bits(first), s.shr::<16>(s.to_bits(second)))
}

/// The scale of a row for 8-bit integers, `max|x|/127`, and its inverse; 0 and 0 for a row of zeros or one that is not finite.
#[inline(always)]
pub(crate) fn scale_of(most: f32) -> (f32, f32) {
    // A smaller maximum has no finite inverse.
    if (1e-36..f32::INFINITY).contains(&most) { (most / 127.0, 127.0 / most) } else { (0.0, 0.0) }
}

/// [`scale_of`] in every lane.
#[inline(always)]
pub(crate) fn scales_of<S: Simd>(s: S, most: S::F32) -> (S::F32, S::F32) {
    let has = s.and(s.le(s.splat(1e-36), most), s.lt(most, s.splat(f32::INFINITY)));
    let of = s.splat(127.0);
    (s.keep(has, s.div(most, of)), s.keep(has, s.div(of, most)))
}

/// The larger of magnitudes, as bits: those of NaN and infinity are above all others.
#[inline(always)]
pub(crate) fn larger<S: Simd>(s: S, most: S::I32, x: S::F32) -> S::I32 {
    s.max_i32(most, s.and_i32(s.to_bits(x), s.splat_i32(i32::MAX)))
}

/// The largest of magnitudes; infinite where a value is not finite.
#[inline(always)]
pub(crate) fn largest<S: Simd>(s: S, most: S::I32) -> f32 {
    let bad = s.gt_i32(most, s.splat_i32(f32::MAX.to_bits().cast_signed()));
    if s.any(bad) { f32::INFINITY } else { s.max_lane(s.from_bits(most)) }
}

/// The largest magnitude of a row; 0 where it has none, infinite where a value is not finite.
#[inline(always)]
pub(crate) fn largest_magnitude<S: Simd>(s: S, x: &[f32]) -> f32 {
    // Several chains, as each step waits for the one before.
    let mut most = [s.splat_i32(0); 4];
    let whole = x.len() / (4 * LANES) * (4 * LANES);
    for four in x[..whole].chunks_exact(4 * LANES) {
        for j in 0..4 {
            most[j] = larger(s, most[j], s.load(&four[j * LANES..]));
        }
    }
    for (j, x) in x[whole..].chunks(LANES).enumerate() {
        most[j] = larger(s, most[j], s.load_partial(x, 0.0));
    }
    largest(s, s.max_i32(s.max_i32(most[0], most[1]), s.max_i32(most[2], most[3])))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Level;
    use crate::simd::{Operation, dispatch};

    #[test]
    fn scales_of_lanes_are_those_of_rows_on_every_level() {
        struct Scales([f32; LANES]);
        impl Operation for Scales {
            type Output = [[f32; LANES]; 2];
            #[inline(always)]
            fn run<S: Simd>(self, s: S) -> [[f32; LANES]; 2] {
                let (scale, inverse) = scales_of(s, s.from_array(self.0));
                [s.to_array(scale), s.to_array(inverse)]
            }
        }
        let below = 1e-36_f32.next_down();
        let ends = [0.0, 1e-40, below, 1e-36, 1.0, 3.0, 127.0, 1e30, f32::MAX, f32::INFINITY, f32::NAN, 0.1];
        let most: [f32; LANES] = std::array::from_fn(|i| *ends.get(i).unwrap_or(&(1.0 / i as f32)));
        for level in Level::available() {
            let [scales, inverses] = dispatch(level, Scales(most));
            for i in 0..LANES {
                assert_eq!((scales[i], inverses[i]), scale_of(most[i]), "{level}: {}", most[i]);
            }
        }
    }

    #[test]
    fn the_largest_magnitude_is_found_wherever_it_stands_and_what_is_not_finite_outweighs_it() {
        struct Largest<'a>(&'a [f32]);
        impl Operation for Largest<'_> {
            type Output = f32;
            #[inline(always)]
            fn run<S: Simd>(self, s: S) -> f32 {
                largest_magnitude(s, self.0)
            }
        }
        for level in Level::available() {
            assert_eq!(dispatch(level, Largest(&[])), 0.0);
            for len in [1, 15, 16, 63, 64, 150] {
                for at in 0..len {
                    let mut x: Vec<f32> = (0..len).map(|i| 1.0 / (i + 2) as f32).collect();
                    x[at] = -7.5;
                    assert_eq!(dispatch(level, Largest(&x)), 7.5, "{level}: {at} of {len}");
                    for bad in [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                        x[at] = bad;
                        assert_eq!(dispatch(level, Largest(&x)), f32::INFINITY, "{level}: {bad} at {at} of {len}");
                    }
                }
            }
        }
    }
}

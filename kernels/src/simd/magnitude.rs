//! The largest magnitude of values.

use super::vector::{LANES, Simd};

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
    use crate::simd::{Operation, dispatch};

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
        for level in crate::testing::levels() {
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

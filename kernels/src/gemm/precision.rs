//! The number formats of products, their blocks of `k`, and the scales of 8-bit integers.

use crate::simd::Elementwise;

/// Steps of `k` whose products are summed in one chain.
pub const K_BLOCK: usize = 256;

/// [`K_BLOCK`] where operands are bf16: the error of longer chains is far below that of the operands.
pub const K_BLOCK_LOW: usize = 1024;

/// The format in which a product's operands are held. Sums, bias, functions and residuals are f32 in all of them.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Precision {
    /// f32, unchanged.
    #[default]
    F32,
    /// bf16: 8 bits of significand, rounded to nearest even; magnitudes below 2⁻⁵⁶ become 0.
    Bf16,
    /// 8-bit integers: weights with a scale per output channel, inputs with a scale per row.
    Int8,
}

/// The scale of a row for 8-bit integers, `max|x|/127`, and its inverse; 0 and 0 for a row of zeros or one that is not
/// finite.
#[inline(always)]
pub(crate) fn scale_of(most: f32) -> (f32, f32) {
    // A smaller maximum has no finite inverse.
    if (1e-36..f32::INFINITY).contains(&most) { (most / 127.0, 127.0 / most) } else { (0.0, 0.0) }
}

/// [`scale_of`] in every lane.
#[inline(always)]
pub(crate) fn scales_of<S: Elementwise>(s: S, most: S::F32) -> (S::F32, S::F32) {
    let has = s.and(s.le(s.splat(1e-36), most), s.lt(most, s.splat(f32::INFINITY)));
    let of = s.splat(127.0);
    (s.keep(has, s.div(most, of)), s.keep(has, s.div(of, most)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::{LANES, Operation, Simd, dispatch};

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
        for level in crate::testing::levels() {
            let [scales, inverses] = dispatch(level, Scales(most));
            for i in 0..LANES {
                assert_eq!((scales[i], inverses[i]), scale_of(most[i]), "{level}: {}", most[i]);
            }
        }
    }
}

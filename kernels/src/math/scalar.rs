//! The functions of [`math`](super) on one value, with the bits of the vector functions.

use crate::simd::One;

/// Defines a function of one value by the vector algorithm.
macro_rules! twin {
    ($($name:ident)*) => {
        $(
            #[doc = concat!("[`math::", stringify!($name), "`](super::", stringify!($name), ") of one value.")]
            pub fn $name(x: f32) -> f32 {
                super::$name(One, x)
            }
        )*
    };
}

twin!(exp exp_nonpositive exp2_low log softplus sigmoid silu silu_low tanh erf erfc erfinv gelu normal_cdf);

/// [`math::sin_cos`](super::sin_cos) of one value.
pub fn sin_cos(x: f32) -> (f32, f32) {
    super::sin_cos(One, x)
}

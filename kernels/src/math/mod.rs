//! Elementary functions, bit for bit the same on every level.
//!
//! The functions consist of +, −, ×, /, fused multiply-add, square root and integer operations. [`Elementwise`] defines
//! all of these to the bit, so the results are defined to the bit as well. The vector functions take the token of a
//! level; the functions of [`scalar`] run the same algorithms on one value. NaN returns NaN everywhere; denormal
//! results are rounded to denormal numbers (except in [`exp_nonpositive`], which may flush them).
//!
//! | function | largest error, ulp | at | measured over |
//! |---|---|---|---|
//! | [`exp`] | 0.891 | −5.848642 | all patterns |
//! | [`exp_nonpositive`] | 0.891 | −5.848642 | all patterns ≤ 0 |
//! | [`log`] | 0.806 | 1.4044684 | all patterns; never falls |
//! | [`softplus`] | 1.787 | −0.8751337 | all patterns |
//! | [`sigmoid`] | 2.402 | −4.157294 | all patterns |
//! | [`silu`] | 3.344 | −5.9388933 | all patterns |
//! | [`tanh`] | 2.606 | −0.06241588 | all patterns |
//! | [`erf`] | 1.071 | −1.0769311 | all patterns |
//! | [`erfc`] | 4.760 | 8.206442 | all patterns |
//! | [`erfinv`] | 2.038 | −0.99512655 | all patterns; never falls |
//! | [`normal_cdf`] | 4.759 | −8.537904 | all patterns |
//! | [`gelu`] | 5.261 | −11.700364 | all patterns |
//! | [`sin_cos`], sine | 1.560 | −922.8229 | all patterns |
//! | [`sin_cos`], cosine | 1.562 | −1840.216 | all patterns |
//!
//! Errors are in units of the last place of binary32 at the exact value, against [`mod@f64`]. The example `ulp` of this
//! crate measures them: `cargo run --release -p streamsplat-kernels --example ulp -- exhaustive` goes over all 2³²
//! patterns. Only [`log`] and [`erfinv`] grow everywhere; the others may fall by a unit in the last place where they
//! are flat (`exp` does at 2,914 of all arguments).
//!
//! Two functions are for the lower precisions, where a result is then rounded to 8 bits of significand or fewer:
//! [`exp2_low`] is within 7.5e-5 of its value, [`silu_low`] within 1e-4 from −87 on.
//!
//! Polynomials are minimax fits with coefficients rounded one after the other, the rest refitted; the remaining error
//! is noted at each as a power of two, relative to the function.

mod erf;
mod exp;
pub mod f64;
mod log;
pub mod scalar;
mod sigmoid;
mod trigonometry;

#[cfg(test)]
mod monotone;
#[cfg(test)]
mod tests;

pub use erf::{erf, erfc, erfinv, gelu, normal_cdf};
pub(crate) use exp::EXP2_LOW;
pub use exp::{exp, exp_nonpositive, exp2_low};
pub use log::{log, softplus};
pub use sigmoid::{sigmoid, silu, silu_low, tanh};
pub use trigonometry::sin_cos;

use crate::simd::Elementwise;

/// Horner's scheme with fused steps, highest power first.
#[inline(always)]
fn polynomial<S: Elementwise, const N: usize>(s: S, x: S::F32, coefficients: &[f32; N]) -> S::F32 {
    let mut sum = s.splat(coefficients[0]);
    for &c in &coefficients[1..] {
        sum = s.mul_add(sum, x, s.splat(c));
    }
    sum
}

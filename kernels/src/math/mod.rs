//! Elementary functions, bit for bit the same on every level.
//!
//! Made of +, −, ×, /, fused multiply-add, square root and integer operations, all of them defined to the bit by
//! [`Simd`], so the results are too. The vector functions take the token of a level; the functions of [`scalar`] run the
//! same algorithms on one value.

mod erf;
mod exp;
pub mod f64;
mod log;
mod one;
pub mod scalar;
mod sigmoid;
mod trigonometry;

#[cfg(test)]
mod tests;

pub use erf::{erf, erfc, erfinv, gelu, normal_cdf};
pub use exp::{exp, exp_nonpositive};
pub use log::{log, softplus};
pub use sigmoid::{sigmoid, silu, tanh};
pub use trigonometry::sin_cos;

use crate::simd::Simd;

/// Horner's scheme with fused steps, highest power first.
#[inline(always)]
fn polynomial<S: Simd, const N: usize>(s: S, x: S::F32, coefficients: &[f32; N]) -> S::F32 {
    let mut sum = s.splat(coefficients[0]);
    for &c in &coefficients[1..] {
        sum = s.mul_add(sum, x, s.splat(c));
    }
    sum
}

//! Elementary functions in binary64 without a C library: for tables, for sampling, and as references of the binary32
//! functions.
//!
//! Made of +, −, ×, / and square roots in binary64, none of them fused, and integers; the same bits on every machine.
//!
//! | function | error |
//! |---|---|

mod erf;
mod exp;
mod trigonometry;

#[cfg(test)]
mod table;
#[cfg(test)]
mod tests;

pub use erf::{erf, erfc, erfcinv, erfinv};
pub use exp::{exp, expm1, ln, ln_1p};
pub use trigonometry::{cos, sin, sin_cos};

/// Horner's scheme, highest power first.
#[inline(always)]
fn polynomial(x: f64, coefficients: &[f64]) -> f64 {
    coefficients.iter().fold(0.0, |sum, c| sum * x + c)
}

/// a·b as a rounded product and its error (Dekker); no overflow or underflow of the parts.
#[inline(always)]
fn product(a: f64, b: f64) -> (f64, f64) {
    let split = |x: f64| {
        let high = f64::from_bits(x.to_bits() & !0x7ff_ffff);
        (high, x - high)
    };
    let p = a * b;
    let ((ah, al), (bh, bl)) = (split(a), split(b));
    (p, ((ah * bh - p) + ah * bl + al * bh) + al * bl)
}

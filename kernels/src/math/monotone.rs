//! The functions documented as monotone never fall from one binary32 number to the next.

use super::scalar;

/// Neighbours that are compared in one place.
const RUN: u32 = 64;
/// Places.
const PLACES: u32 = 1 << 16;

/// Runs of consecutive numbers all over the positive ones up to `last`, each with its function never below the one
/// before.
fn never_falls(name: &str, last: f32, function: impl Fn(f32) -> f32) {
    let step = last.to_bits() / PLACES;
    let mut highest = f32::NEG_INFINITY;
    for place in 0..PLACES {
        let first = place * step + place.wrapping_mul(2_654_435_761) % (step - RUN);
        for bits in first..first + RUN {
            let x = f32::from_bits(bits);
            let y = function(x);
            assert!(y >= highest, "{name}({x:e}) is {y:e} after {highest:e}");
            highest = y;
        }
    }
    assert!(function(last) >= highest, "{name}({last:e})");
}

#[test]
fn the_logarithm_never_falls() {
    never_falls("log", f32::INFINITY, scalar::log);
}

#[test]
fn the_inverse_error_function_never_falls_on_either_side() {
    never_falls("erfinv", 1.0, scalar::erfinv);
    never_falls("−erfinv(−x)", 1.0, |x| -scalar::erfinv(-x));
}

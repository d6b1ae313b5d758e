//! Elementary functions in binary64, of +, −, ×, ÷ and integer operations alone: the same bits on every machine.
//!
//! For the few places that want more than f32 carries: tables made once at load, opacity in time.

/// eˣ within 2⁻⁵⁰ relative; 0 below −745 and ∞ above 709.78.
///
/// x = n·ln 2 + r with |r| ≤ ½ ln 2 (ln 2 in two parts, so that n·hi is exact), then the Taylor polynomial of degree 13.
pub(crate) fn exp(x: f64) -> f64 {
    const LN2_HI: f64 = 0.693_147_180_369_123_816_490;
    const LN2_LO: f64 = 1.908_214_929_270_587_700_02e-10;
    if x < -745.0 {
        return 0.0;
    }
    if x > 709.78 {
        return f64::INFINITY;
    }
    let n = (x * std::f64::consts::LOG2_E).round_ties_even();
    let r = (x - n * LN2_HI) - n * LN2_LO;
    // Horner from 1/13!.
    let mut p = 1.0 / 6_227_020_800.0;
    for factorial in
        [479_001_600.0, 39_916_800.0, 3_628_800.0, 362_880.0, 40_320.0, 5_040.0, 720.0, 120.0, 24.0, 6.0, 2.0, 1.0, 1.0]
    {
        p = p * r + 1.0 / factorial;
    }
    // 2ⁿ in two factors: n reaches −1075, under the smallest exponent.
    let half = n as i32 / 2;
    let power = |k: i32| f64::from_bits(((1023 + k) as u64) << 52);
    p * power(half) * power(n as i32 - half)
}

/// (sin x, cos x) within 2⁻⁴⁸ for |x| ≤ 2²⁰.
///
/// x = n·π/2 + r with |r| ≤ π/4 (π/2 in three parts, so that n times the first two is exact), then Taylor polynomials.
pub(crate) fn sin_cos(x: f64) -> (f64, f64) {
    // π/2 = HI + MIDDLE + LO; the first two have 31 bits.
    const HI: f64 = 1.5707963267341256;
    const MIDDLE: f64 = 6.07710050359346e-11;
    const LO: f64 = 2.912732056093356e-20;
    let n = (x * std::f64::consts::FRAC_2_PI).round_ties_even();
    let r = ((x - n * HI) - n * MIDDLE) - n * LO;
    let r2 = r * r;
    let series = |first: f64, terms: std::ops::Range<u32>, odd: u32| {
        // Σ (−1)^k r^{2k} / (2k + odd)!, Horner from the last term.
        let mut p = 0.0;
        for k in terms.rev() {
            let (a, b) = (f64::from(2 * k + 1 + odd), f64::from(2 * k + 2 + odd));
            p = first - p * (r2 / (a * b));
        }
        p
    };
    let sin = r * series(1.0, 0..9, 1);
    let cos = series(1.0, 0..10, 0);
    match n as i64 & 3 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

#[cfg(test)]
mod tests {
    use super::{exp, sin_cos};

    #[test]
    fn sine_and_cosine_are_close_over_their_range() {
        let mut x: f64 = -20_000.0;
        while x < 20_000.0 {
            let (s, c) = sin_cos(x);
            assert!((s - x.sin()).abs() < 1e-13 && (c - x.cos()).abs() < 1e-13, "{x}: {s} {c}");
            x += 0.617;
        }
        assert_eq!(sin_cos(0.0), (0.0, 1.0));
    }

    #[test]
    fn exp_is_close_over_its_range() {
        assert_eq!(exp(0.0), 1.0);
        let mut x = -740.0;
        while x < 709.0 {
            let (found, expected) = (exp(x), f64::exp(x));
            let tolerance = if expected < 1e-300 { 1e-3 } else { 1e-14 };
            assert!((found / expected - 1.0).abs() < tolerance, "exp({x}) = {found}, expected {expected}");
            x += 0.37;
        }
        assert_eq!(exp(-1e9), 0.0);
        assert_eq!(exp(f64::NEG_INFINITY), 0.0);
        assert_eq!(exp(1e9), f64::INFINITY);
    }
}

//! Exponential and logarithm.

/// ln 2 to 33 bits: its product with an integer of 11 bits is exact.
const LN2_HI: f64 = 0.693_147_180_485_539_1;
/// The rest of ln 2.
const LN2_LO: f64 = 7.440_617_110_012_397e-11;
/// Adding it leaves the nearest integer in the low bits: 1.5 · 2⁵².
const TO_INTEGER: f64 = 6_755_399_441_055_744.0;

/// 2ⁿ for n in −1022 … 1023.
#[inline(always)]
fn power_of_two(n: i32) -> f64 {
    f64::from_bits(((n + 1023) as u64) << 52)
}

/// x = n ln 2 + (r + c).
#[inline(always)]
fn reduce(x: f64) -> (i32, f64, f64) {
    let n = (x * std::f64::consts::LOG2_E + TO_INTEGER) - TO_INTEGER;
    let high = x - n * LN2_HI;
    let low = n * LN2_LO;
    let r = high - low;
    (n as i32, r, (high - r) - low)
}

/// e^(r + c) − 1 − r: Taylor's series up to r¹³, exact to 2^−57 of eʳ on |r| ≤ ln 2 / 2.
#[inline(always)]
fn after_linear(r: f64, c: f64) -> f64 {
    let mut sum = 1.0 / 6_227_020_800.0;
    for inverse in [
        1.0 / 479_001_600.0,
        1.0 / 39_916_800.0,
        1.0 / 3_628_800.0,
        1.0 / 362_880.0,
        1.0 / 40_320.0,
        1.0 / 5_040.0,
        1.0 / 720.0,
        1.0 / 120.0,
        1.0 / 24.0,
        1.0 / 6.0,
        0.5,
    ] {
        sum = sum * r + inverse;
    }
    r * r * sum + (c + c * r)
}

/// eˣ. Overflows to ∞, underflows gradually to 0.
pub fn exp(x: f64) -> f64 {
    if x.is_nan() {
        return x;
    }
    let (n, r, c) = reduce(x.clamp(-800.0, 800.0));
    let half = n / 2;
    (1.0 + (r + after_linear(r, c))) * power_of_two(half) * power_of_two(n - half)
}

/// eˣ − 1.
pub fn expm1(x: f64) -> f64 {
    if x.is_nan() || x == 0.0 {
        return x;
    }
    let (n, r, c) = reduce(x.clamp(-100.0, 800.0));
    let q = r + after_linear(r, c);
    if n == 0 {
        return q;
    }
    if n > 60 {
        return exp(x);
    }
    // 2ⁿ(1 + q) − 1 with the exact difference first.
    let scale = power_of_two(n);
    scale * q + (scale - 1.0)
}

/// ln(1 + f + c) + k ln 2 for 1 + f between √½ and √2 and c beyond its last place: with s = f/(2 + f), the series of
/// 2 artanh s.
fn log_1p_plus(f: f64, c: f64, k: f64) -> f64 {
    let s = f / (2.0 + f);
    let z = s * s;
    let mut series = 0.0;
    for odd in [25.0, 23.0, 21.0, 19.0, 17.0, 15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0] {
        series = series * z + 2.0 / odd;
    }
    let half_square = 0.5 * f * f;
    // 2 artanh s = f − f²/2 + s (f²/2 + z·series).
    k * LN2_HI - ((half_square - (s * (half_square + z * series) + (k * LN2_LO + c / (1.0 + f)))) - f)
}

/// x = 2ᵏ·m with m between √½ and √2; x positive and finite.
fn split(x: f64) -> (f64, f64) {
    const SQRT_HALF: u64 = 0x3fe6_a09e_667f_3bcd;
    let denormal = x < f64::MIN_POSITIVE;
    let x = if denormal { x * 18_014_398_509_481_984.0 } else { x };
    let offset = x.to_bits().wrapping_sub(SQRT_HALF);
    let k = (offset.cast_signed() >> 52) - if denormal { 54 } else { 0 };
    (f64::from_bits((offset & 0x000f_ffff_ffff_ffff) + SQRT_HALF), k as f64)
}

/// ln x. Zero returns −∞, negative x NaN.
pub fn ln(x: f64) -> f64 {
    if x.is_nan() || x < 0.0 {
        return f64::NAN;
    }
    if x == 0.0 {
        return f64::NEG_INFINITY;
    }
    if x == f64::INFINITY {
        return x;
    }
    let (m, k) = split(x);
    log_1p_plus(m - 1.0, 0.0, k)
}

/// ln(1 + x).
pub fn ln_1p(x: f64) -> f64 {
    if x.is_nan() || x < -1.0 {
        return f64::NAN;
    }
    if x == -1.0 {
        return f64::NEG_INFINITY;
    }
    if x == f64::INFINITY || x == 0.0 {
        return x;
    }
    if x > -0.29 && x < 0.41 {
        return log_1p_plus(x, 0.0, 0.0);
    }
    let w = 1.0 + x;
    // Rounding error of 1 + x.
    let lost = if x.abs() < 1.0 { x - (w - 1.0) } else { 1.0 - (w - x) };
    let (m, k) = split(w);
    log_1p_plus(m - 1.0, if k.abs() < 60.0 { lost * power_of_two(-k as i32) } else { 0.0 }, k)
}

//! Sine and cosine of any finite argument.

use super::{polynomial, product};

/// 2/π in binary after the point, 64 bits a word.
const TWO_OVER_PI: [u64; 20] = [
    0xa2f9_836e_4e44_1529,
    0xfc27_57d1_f534_ddc0,
    0xdb62_9599_3c43_9041,
    0xfe51_63ab_debb_c561,
    0xb724_6e3a_424d_d2e0,
    0x0649_2eea_09d1_921c,
    0xfe1d_eb1c_b129_a73e,
    0xe882_35f5_2ebb_4484,
    0xe99c_7026_b45f_7e41,
    0x3991_d639_8353_39f4,
    0x9c84_5f8b_bdf9_283b,
    0x1ff8_97ff_de05_980f,
    0xef2f_118b_5a0a_6d1f,
    0x6d36_7ecf_27cb_09b7,
    0x4f46_3f66_9e5f_ea2d,
    0x7527_bac7_ebe5_f17b,
    0x3d07_39f7_8a52_92ea,
    0x6bfb_5fb1_1f8d_5d08,
    0x5603_3046_fc7b_6bab,
    0xf0cf_bc20_9af4_361d,
];
/// π/2 − its binary64 value.
const HALF_PI_LO: f64 = 6.123_233_995_736_766e-17;

/// Word `i` of the binary string of 2/π that starts at its bit `start` (bit 1 is worth ½; bits before it are 0).
fn window(start: i32, i: i32) -> u64 {
    let first = start - 1 + 64 * i;
    let word = |w: i32| usize::try_from(w).ok().and_then(|w| TWO_OVER_PI.get(w)).copied().unwrap_or(0);
    let (w, shift) = (first.div_euclid(64), first.rem_euclid(64));
    if shift == 0 { word(w) } else { word(w) << shift | word(w + 1) >> (64 - shift) }
}

/// x = q·π/2 + (r + c) with |r| ≤ π/4: q mod 4, r and c. After Payne and Hanek: of x·2/π only the bits that decide the
/// quadrant and 137 after the point are formed, in integers.
fn reduce(x: f64) -> (u32, f64, f64) {
    if x.abs() < std::f64::consts::FRAC_PI_4 {
        return (0, x, 0.0);
    }
    let bits = x.abs().to_bits();
    let mantissa = u128::from(bits & 0x000f_ffff_ffff_ffff | 0x0010_0000_0000_0000);
    let exponent = (bits >> 52) as i32 - 1075;
    // mantissa · 2^exponent · 2/π modulo 4 = (mantissa · three words) modulo 2¹⁹², over 2¹⁹⁰.
    let start = exponent - 1;
    let low = mantissa * u128::from(window(start, 2));
    let middle = mantissa * u128::from(window(start, 1)) + (low >> 64);
    let high = (mantissa * u128::from(window(start, 0)) + (middle >> 64)) as u64;
    let (middle, low) = (middle as u64, low as u64);
    // The quadrant is the nearest integer; the rest is a signed fraction.
    let quadrant = (high >> 62) as u32 + (high >> 61 & 1) as u32;
    let fraction = [high << 2 | middle >> 62, middle << 2 | low >> 62, low << 2];
    let negative = fraction[0] >> 63 == 1;
    let flip = |w: u64| if negative { !w } else { w };
    let upper = u128::from(flip(fraction[0])) << 64 | u128::from(flip(fraction[1]));
    let lower = flip(fraction[2]);
    // 128 bits from the first that is set; the rest is under 2⁻¹²⁰ of it.
    let zeros = upper.leading_zeros().min(64);
    let top = if zeros == 0 { upper } else { upper << zeros | u128::from(lower) >> (64 - zeros) };
    let first = (top >> 75) << 75;
    let scale = f64::from_bits(((1023 - 128 - zeros) as u64) << 52);
    let (f, g) = (first as f64 * scale, (top - first) as f64 * scale);
    let (r, e) = product(f, std::f64::consts::FRAC_PI_2);
    let c = e + (f * HALF_PI_LO + g * std::f64::consts::FRAC_PI_2);
    let (sum, rest) = (r + c, c - ((r + c) - r));
    let sign = if negative != (x < 0.0) { -1.0 } else { 1.0 };
    (if x < 0.0 { quadrant.wrapping_neg() } else { quadrant } & 3, sign * sum, sign * rest)
}

/// sin(r + c) on |r| ≤ π/4: Taylor's series up to r¹⁷.
fn sin_kernel(r: f64, c: f64) -> f64 {
    let z = r * r;
    let series = polynomial(
        z,
        &[
            1.0 / 355_687_428_096_000.0,
            -1.0 / 1_307_674_368_000.0,
            1.0 / 6_227_020_800.0,
            -1.0 / 39_916_800.0,
            1.0 / 362_880.0,
            -1.0 / 5_040.0,
            1.0 / 120.0,
            -1.0 / 6.0,
        ],
    );
    r + (z * r * series + c * (1.0 - 0.5 * z))
}

/// cos(r + c) on |r| ≤ π/4: Taylor's series up to r¹⁸; 1 − r²/2 with its rounding error.
fn cos_kernel(r: f64, c: f64) -> f64 {
    let z = r * r;
    let series = polynomial(
        z,
        &[
            -1.0 / 6_402_373_705_728_000.0,
            1.0 / 20_922_789_888_000.0,
            -1.0 / 87_178_291_200.0,
            1.0 / 479_001_600.0,
            -1.0 / 3_628_800.0,
            1.0 / 40_320.0,
            -1.0 / 720.0,
            1.0 / 24.0,
        ],
    );
    let half = 0.5 * z;
    let w = 1.0 - half;
    w + (((1.0 - w) - half) + (z * z * series - r * c))
}

/// (sin x, cos x). Infinite x return NaN.
pub fn sin_cos(x: f64) -> (f64, f64) {
    if !x.is_finite() {
        return (f64::NAN, f64::NAN);
    }
    let (quadrant, r, c) = reduce(x);
    let (sin, cos) = (sin_kernel(r, c), cos_kernel(r, c));
    match quadrant {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

/// sin x.
pub fn sin(x: f64) -> f64 {
    // Keeps the sign of zero.
    if x == 0.0 { x } else { sin_cos(x).0 }
}

/// cos x.
pub fn cos(x: f64) -> f64 {
    sin_cos(x).1
}

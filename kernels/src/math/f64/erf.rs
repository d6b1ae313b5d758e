//! The error function and its inverse.

use super::{exp, expm1, ln, polynomial, product};

/// erf x = x + x·P(x²) on [0, 0.85]; 2^−68.7.
const NEAR: [f64; 13] = [
    6.752128814075869e-11,
    -1.1765811790894532e-9,
    1.4745336098871178e-8,
    -1.6361083108247278e-7,
    1.646186537194235e-6,
    -1.4925641386675094e-5,
    0.000120553327599773,
    -0.0008548327019769047,
    0.005223977625402893,
    -0.02686617064512875,
    0.11283791670955118,
    -0.37612638903183754,
    0.1283791670955126,
];
/// e^(a²)·erfc a = t·P(t − 0.15625), t = 1/(a + 3), on [0.45, 28]; 2^−67.8.
const TAIL: [f64; 26] = [
    8239177440.967809,
    118973902.68311201,
    -2052831238.1046124,
    165305663.00933218,
    279244972.43785965,
    -55715952.45896084,
    -28841569.427096054,
    10827657.725441346,
    2589363.669214228,
    -1749427.7867067514,
    -226191.74587870657,
    272414.5468742466,
    25916.61108333863,
    -44076.71144649299,
    -5845.771730561467,
    7477.821457030479,
    2055.907425476594,
    -1148.8618577654277,
    -762.6229011828854,
    2.31857392640684,
    210.2708539772933,
    143.98368025901928,
    60.83371958901263,
    19.251052687334845,
    4.87883713723174,
    1.0210263338171548,
];
/// 2/√π.
const SLOPE: f64 = std::f64::consts::FRAC_2_SQRT_PI;

/// erf x on |x| ≤ 0.85.
fn near(x: f64) -> f64 {
    x + x * polynomial(x * x, &NEAR)
}

/// erfc a for a ≥ 0.45.
fn tail(a: f64) -> f64 {
    if a > 28.0 {
        return 0.0;
    }
    let d = a + 3.0;
    let t = 1.0 / d;
    let scaled = t * polynomial(t - 0.156_25, &TAIL);
    // The relative change of t by both roundings is corrected in the result through (e^(a²) erfc a)' = 2a e^(a²) erfc a
    // − 2/√π.
    let (p, lost) = product(t, d);
    let moved = ((1.0 - p) - lost) - t * (a - (d - 3.0));
    let scaled = scaled - (2.0 * a * scaled - SLOPE) * d * moved;
    // e^(−a²): the square of the upper half of a is exact.
    let upper = f64::from_bits(a.to_bits() & !0x7ff_ffff);
    let rest = expm1((upper - a) * (upper + a));
    let value = scaled + scaled * rest;
    value * exp(-upper * upper)
}

/// erf x = 2/√π ∫₀ˣ e^(−t²) dt.
pub fn erf(x: f64) -> f64 {
    let a = x.abs();
    if a <= 0.85 {
        near(x)
    } else {
        // NaN takes this branch and stays NaN.
        (1.0 - if a.is_nan() { a } else { tail(a) }).copysign(x)
    }
}

/// erfc x = 1 − erf x, accurate in the tail.
pub fn erfc(x: f64) -> f64 {
    if x.is_nan() {
        x
    } else if x < -0.45 {
        2.0 - tail(-x)
    } else if x < 0.45 {
        1.0 - near(x)
    } else {
        tail(x)
    }
}

/// One of Halley's steps for erf y = x or erfc y = x. `off`: the function's error at y over its slope there.
fn halley(y: f64, off: f64) -> f64 {
    y - off / (1.0 + y * off)
}

/// The y ≥ 0 with erfc y = q, for q in (0, 0.3].
fn inverse_tail(q: f64) -> f64 {
    // Hastings's approximation to the normal quantile (Abramowitz and Stegun 26.2.23) is off by 4.5e-4 at most.
    let t = (-2.0 * ln(0.5 * q)).sqrt();
    let z =
        t - (2.515_517 + t * (0.802_853 + t * 0.010_328)) / (1.0 + t * (1.432_788 + t * (0.189_269 + t * 0.001_308)));
    let mut y = z * std::f64::consts::FRAC_1_SQRT_2;
    for _ in 0..2 {
        let slope = -SLOPE * exp(-y * y);
        if slope > -1e-300 {
            break;
        }
        y = halley(y, (erfc(y) - q) / slope);
    }
    y
}

/// The y with erf y = x, for |x| ≤ 0.75.
fn inverse_near(x: f64) -> f64 {
    if x.abs() < 1e-8 {
        return x / SLOPE;
    }
    // The first terms of the series leave 7e-3 at 0.75.
    const PI: f64 = std::f64::consts::PI;
    let z = PI * x * x;
    let mut y = x / SLOPE * (1.0 + z * (1.0 / 12.0 + z * (7.0 / 480.0 + z * (127.0 / 40_320.0))));
    for _ in 0..2 {
        y = halley(y, (erf(y) - x) / (SLOPE * exp(-y * y)));
    }
    y
}

/// The inverse of [`erf`]. ±1 return ±∞, values beyond them NaN.
pub fn erfinv(x: f64) -> f64 {
    let a = x.abs();
    if a <= 0.75 {
        inverse_near(x)
    } else if a < 1.0 {
        inverse_tail(1.0 - a).copysign(x)
    } else if a == 1.0 {
        f64::INFINITY.copysign(x)
    } else {
        f64::NAN
    }
}

/// The inverse of [`erfc`]: from ∞ at 0 over 0 at 1 to −∞ at 2, NaN beyond. Accurate for small q, down to 1e-300.
pub fn erfcinv(q: f64) -> f64 {
    if !(0.0..=2.0).contains(&q) {
        f64::NAN
    } else if q == 0.0 {
        f64::INFINITY
    } else if q < 0.25 {
        inverse_tail(q)
    } else {
        // The difference is exact from ½ on, and off by 2⁻⁵⁴ before.
        erfinv(1.0 - q)
    }
}

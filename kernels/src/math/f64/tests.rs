//! Against values to full precision, and against the platform's library where it has the function.

use super::table;
use super::*;

/// Distance in units of the last place at `exact`.
fn ulps(got: f64, exact: f64) -> f64 {
    if got == exact || got.is_nan() && exact.is_nan() {
        return 0.0;
    }
    let unit = f64::from_bits(exact.abs().to_bits() + 1) - exact.abs();
    (got - exact).abs() / unit
}

fn check(name: &str, f: impl Fn(f64) -> f64, values: &[(u64, u64)], limit: f64) {
    for &(x, y) in values {
        let (x, y) = (f64::from_bits(x), f64::from_bits(y));
        let error = ulps(f(x), y);
        assert!(error <= limit, "{name}({x:e}) = {:e} is off by {error} ulp", f(x));
    }
}

#[test]
fn functions_agree_with_values_to_full_precision() {
    check("exp", exp, &table::EXP, 1.0);
    check("expm1", expm1, &table::EXPM1, 2.0);
    check("ln", ln, &table::LN, 1.0);
    check("ln_1p", ln_1p, &table::LN_1P, 2.0);
    check("sin", sin, &table::SIN, 1.0);
    check("cos", cos, &table::COS, 1.0);
    check("erf", erf, &table::ERF, 2.0);
    check("erfc", erfc, &table::ERFC, 4.0);
    check("erfinv", erfinv, &table::ERFINV, 2.0);
    check("erfcinv", erfcinv, &table::ERFCINV, 3.0);
}

#[test]
fn functions_agree_with_the_platform_library() {
    let mut state = 7_u64;
    let mut next = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    for _ in 0..200_000 {
        let u = next();
        let close = |name: &str, x: f64, got: f64, expected: f64, limit: f64| {
            assert!(ulps(got, expected) <= limit, "{name}({x:e}) = {got:e}, expected {expected:e}");
        };
        let x = 1490.0 * u - 745.0;
        close("exp", x, exp(x), x.exp(), 2.0);
        close("expm1", x, expm1(x), x.exp_m1(), 2.0);
        let x = 4.0 * u - 2.0;
        close("expm1", x, expm1(x), x.exp_m1(), 3.0);
        close("ln", u, ln(u), u.ln(), 2.0);
        let x = 3.0 * u - 1.0;
        close("ln_1p", x, ln_1p(x), x.ln_1p(), 3.0);
        for scale in [1.0, 50.0, 1e6, 1e18, 1e300] {
            let x = scale * (u - 0.5);
            close("sin", x, sin(x), x.sin(), 2.0);
            close("cos", x, cos(x), x.cos(), 2.0);
        }
    }
}

#[test]
fn inverses_go_back() {
    for i in 1..2000 {
        let q = f64::from(i) / 1000.0;
        assert!((erfc(erfcinv(q)) - q).abs() <= 1e-15 * q, "{q}");
        let x = f64::from(i) / 2001.0;
        assert!((erf(erfinv(x)) - x).abs() <= 4e-16, "{x}");
        assert_eq!(erfinv(-x), -erfinv(x));
    }
}

#[test]
fn special_values() {
    assert_eq!(exp(f64::NEG_INFINITY), 0.0);
    assert_eq!(exp(f64::INFINITY), f64::INFINITY);
    assert_eq!(exp(-745.0), 5e-324);
    assert_eq!(expm1(f64::NEG_INFINITY), -1.0);
    assert_eq!(ln(0.0), f64::NEG_INFINITY);
    assert_eq!(ln_1p(-1.0), f64::NEG_INFINITY);
    assert!(ln(-1.0).is_nan() && ln_1p(-2.0).is_nan());
    assert_eq!((erf(f64::INFINITY), erf(f64::NEG_INFINITY)), (1.0, -1.0));
    assert_eq!((erfc(f64::INFINITY), erfc(f64::NEG_INFINITY)), (0.0, 2.0));
    assert_eq!((erfinv(1.0), erfcinv(0.0), erfcinv(2.0)), (f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY));
    assert_eq!(erfcinv(1.0), 0.0);
    assert!(erfinv(1.5).is_nan() && erfcinv(-0.1).is_nan());
    for f in [exp, expm1, ln, ln_1p, sin, cos, erf, erfc, erfinv, erfcinv] {
        assert!(f(f64::NAN).is_nan());
    }
    assert!(sin(f64::INFINITY).is_nan() && cos(f64::NEG_INFINITY).is_nan());
}

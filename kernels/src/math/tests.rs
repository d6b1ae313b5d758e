//! Sweeps over bit patterns: error against binary64 references, special values, and equality of levels and twins.

use super::{f64 as double, scalar};
use crate::level::Level;
use crate::simd::{LANES, Operation, Simd, dispatch};

/// The bits of a value, with one pattern for all NaN.
fn bits(x: f32) -> u32 {
    if x.is_nan() { f32::NAN.to_bits() } else { x.to_bits() }
}

/// Every 2¹⁴-th bit pattern with wandering low bits, and the surroundings of values where something changes.
fn sweep() -> Vec<f32> {
    let mut v: Vec<f32> =
        (0..1_u32 << 18).map(|i| f32::from_bits(i << 14 | (i.wrapping_mul(2_654_435_761) >> 18))).collect();
    let edges = [
        0.0,
        1.0,
        2.0,
        0.5,
        88.0,
        88.722_84,
        87.336_55,
        87.683_1,
        103.972_08,
        104.0,
        0.346_573_6,
        0.707_106_77,
        std::f32::consts::SQRT_2,
        f32::MIN_POSITIVE,
        f32::MAX,
        f32::INFINITY,
        f32::NAN,
    ];
    for edge in edges {
        for step in -64..=64 {
            let near = f32::from_bits(edge.to_bits().wrapping_add_signed(step));
            v.extend([near, -near]);
        }
    }
    v
}

/// The distance of `got` from `exact` in units of the last place of binary32 at `exact`.
fn ulps(got: f32, exact: f64) -> f64 {
    if exact.is_nan() || got.is_nan() {
        return if exact.is_nan() && got.is_nan() { 0.0 } else { f64::INFINITY };
    }
    // Values past the largest finite one count as if the exponent continued.
    let (got, exact) = if got.is_infinite() && exact.abs() > f64::from(f32::MAX) && (exact > 0.0) == (got > 0.0) {
        return if exact.is_infinite() || exact.abs() >= 2.0_f64.powi(128) {
            0.0
        } else {
            (2.0_f64.powi(128) - exact.abs()) / 2.0_f64.powi(104)
        };
    } else {
        (f64::from(got), exact)
    };
    if got == exact {
        return 0.0;
    }
    let exponent = ((exact.to_bits() >> 52 & 0x7ff) as i32 - 1023).max(-126);
    (got - exact).abs() / 2.0_f64.powi(exponent - 23)
}

/// A vector function by name.
trait Function: Copy {
    fn vector<S: Simd>(self, s: S, x: S::F32) -> S::F32;
    fn scalar(self, x: f32) -> f32;
}

macro_rules! function {
    ($token:ident, $name:ident) => {
        #[derive(Clone, Copy)]
        struct $token;
        impl Function for $token {
            #[inline(always)]
            fn vector<S: Simd>(self, s: S, x: S::F32) -> S::F32 {
                super::$name(s, x)
            }
            fn scalar(self, x: f32) -> f32 {
                scalar::$name(x)
            }
        }
    };
}

struct Apply<'a, F>(F, &'a [f32], &'a mut [f32]);

impl<F: Function> Operation for Apply<'_, F> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        for (from, to) in self.1.chunks(LANES).zip(self.2.chunks_mut(LANES)) {
            s.store_partial(self.0.vector(s, s.load_partial(from, 0.0)), to);
        }
    }
}

/// FNV over the bits of all results.
fn digest(results: &[f32]) -> u64 {
    results.iter().fold(0xcbf2_9ce4_8422_2325, |digest, &y| (digest ^ u64::from(bits(y))).wrapping_mul(0x100_0000_01b3))
}

/// All levels and the scalar twin agree on `values`; the error is at most `limit` ulp.
fn check<F: Function>(name: &str, f: F, values: &[f32], limit: f64, exact: impl Fn(f64) -> f64) {
    let mut results = vec![0.0; values.len()];
    dispatch(Level::scalar(), Apply(f, values, &mut results));
    for level in crate::testing::levels() {
        let mut other = vec![0.0; values.len()];
        dispatch(level, Apply(f, values, &mut other));
        for (i, x) in values.iter().enumerate() {
            assert_eq!(bits(other[i]), bits(results[i]), "{name}({x:e}) on {level}");
        }
    }
    let mut worst = (0.0, 0.0);
    for (&x, &y) in values.iter().zip(&results) {
        assert_eq!(bits(f.scalar(x)), bits(y), "scalar {name}({x:e})");
        let error = ulps(y, exact(f64::from(x)));
        if error > worst.0 {
            worst = (error, x);
        }
    }
    assert!(worst.0 <= limit, "{name}({:e}) is off by {} ulp", worst.1, worst.0);
    println!("{name}: {:.3} ulp at {:e}", worst.0, worst.1);
}

function!(Exp, exp);
function!(ExpNonpositive, exp_nonpositive);

#[test]
fn exp_is_within_an_ulp() {
    check("exp", Exp, &sweep(), 1.0, f64::exp);
    assert_eq!(scalar::exp(0.0), 1.0);
    assert_eq!(scalar::exp(f32::NEG_INFINITY).to_bits(), 0);
    assert_eq!(scalar::exp(f32::INFINITY), f32::INFINITY);
    assert!(scalar::exp(f32::NAN).is_nan());
}

#[test]
fn exp_of_nonpositive_numbers_has_the_bits_of_exp_until_it_flushes() {
    let values: Vec<f32> = sweep().into_iter().filter(|x| x.is_nan() || *x <= 0.0).collect();
    let limit = -87.336_55_f32;
    check("exp_nonpositive", ExpNonpositive, &values, 1.0, |x| {
        if x < -126.5 * std::f64::consts::LN_2 { 0.0 } else { x.exp() }
    });
    for x in values {
        let y = scalar::exp_nonpositive(x);
        if x > limit {
            assert_eq!(bits(y), bits(scalar::exp(x)), "{x:e}");
        }
        if x < -88.0 {
            assert_eq!(y.to_bits(), 0, "{x:e}");
        }
    }
}

function!(Log, log);
function!(Softplus, softplus);
function!(Sigmoid, sigmoid);
function!(Silu, silu);
function!(Tanh, tanh);

#[test]
fn log_is_within_an_ulp() {
    check("log", Log, &sweep(), 1.0, f64::ln);
    assert_eq!(scalar::log(1.0).to_bits(), 0);
    assert_eq!(scalar::log(0.0), f32::NEG_INFINITY);
    assert_eq!(scalar::log(-0.0), f32::NEG_INFINITY);
    assert_eq!(scalar::log(f32::INFINITY), f32::INFINITY);
    assert!(scalar::log(-1e-45).is_nan());
    assert!(scalar::log(f32::NEG_INFINITY).is_nan());
}

#[test]
fn softplus_is_accurate_for_every_argument() {
    check("softplus", Softplus, &sweep(), 2.0, |x| x.max(0.0) + (-x.abs()).exp().ln_1p() + 0.0 * x.clamp(-1.0, 0.0));
    assert_eq!(scalar::softplus(f32::INFINITY), f32::INFINITY);
    assert_eq!(scalar::softplus(f32::NEG_INFINITY).to_bits(), 0);
    assert_eq!(scalar::softplus(1e30), 1e30);
}

#[test]
fn sigmoid_reaches_its_limits_and_keeps_its_tail() {
    check("sigmoid", Sigmoid, &sweep(), 2.5, |x| {
        if x < 0.0 { x.exp() / (1.0 + x.exp()) } else { 1.0 / (1.0 + (-x).exp()) }
    });
    assert_eq!(scalar::sigmoid(0.0), 0.5);
    assert_eq!(scalar::sigmoid(f32::INFINITY), 1.0);
    assert_eq!(scalar::sigmoid(f32::NEG_INFINITY).to_bits(), 0);
}

#[test]
fn silu_is_accurate_down_to_minus_zero() {
    check("silu", Silu, &sweep(), 3.0, |x| if x == f64::NEG_INFINITY { -0.0 } else { x / (1.0 + (-x).exp()) });
    assert_eq!(scalar::silu(f32::NEG_INFINITY).to_bits(), (-0.0_f32).to_bits());
    assert_eq!(scalar::silu(-0.0).to_bits(), (-0.0_f32).to_bits());
    assert_eq!(scalar::silu(f32::INFINITY), f32::INFINITY);
}

function!(Exp2Low, exp2_low);
function!(SiluLow, silu_low);

#[test]
fn functions_for_the_lower_precisions_keep_their_thirteen_bits() {
    let within = |range: std::ops::RangeInclusive<f32>| -> Vec<f32> {
        sweep().into_iter().filter(|x| range.contains(x)).collect()
    };
    check("exp2_low", Exp2Low, &within(-126.0..=126.0), 1_260.0, f64::exp2);
    check("silu_low", SiluLow, &within(-87.0..=f32::MAX), 1_300.0, |x| x / (1.0 + (-x).exp()));
    for x in [-88.0, -112.0, -1e30, f32::NEG_INFINITY] {
        let y = scalar::silu_low(x);
        assert!(y < 0.0 && y > -2e-36, "{x}: {y:e}");
    }
    assert_eq!(scalar::silu_low(f32::INFINITY), f32::INFINITY);
    assert!(scalar::silu_low(f32::NAN).is_nan());
}

#[test]
fn tanh_is_odd_and_ends_at_one() {
    check("tanh", Tanh, &sweep(), 2.6, f64::tanh);
    assert_eq!(scalar::tanh(-0.0).to_bits(), (-0.0_f32).to_bits());
    assert_eq!(scalar::tanh(f32::NEG_INFINITY), -1.0);
}

function!(Erf, erf);
function!(Erfc, erfc);
function!(Erfinv, erfinv);
function!(NormalCdf, normal_cdf);
function!(Gelu, gelu);

#[test]
fn erf_is_odd_and_ends_at_one() {
    check("erf", Erf, &sweep(), 2.0, double::erf);
    assert_eq!(scalar::erf(-0.0).to_bits(), (-0.0_f32).to_bits());
    assert_eq!(scalar::erf(f32::NEG_INFINITY), -1.0);
}

#[test]
fn erfc_keeps_its_tail() {
    check("erfc", Erfc, &sweep(), 4.0, double::erfc);
    assert_eq!(scalar::erfc(f32::INFINITY).to_bits(), 0);
    assert_eq!(scalar::erfc(f32::NEG_INFINITY), 2.0);
    assert!(scalar::erfc(10.0) > 0.0);
}

#[test]
fn erfinv_is_infinite_at_one() {
    check("erfinv", Erfinv, &sweep(), 4.0, double::erfinv);
    assert_eq!(scalar::erfinv(1.0), f32::INFINITY);
    assert_eq!(scalar::erfinv(-1.0), f32::NEG_INFINITY);
    assert!(scalar::erfinv(1.000_000_1).is_nan());
    assert_eq!(scalar::erfinv(-0.0).to_bits(), (-0.0_f32).to_bits());
}

/// Φ(x) in binary64: x/√2 is formed with its error, which e^(−x²/2) magnifies.
fn normal_cdf(x: f64) -> f64 {
    let y = -x * std::f64::consts::FRAC_1_SQRT_2;
    0.5 * double::erfc(y)
}

#[test]
fn normal_cdf_keeps_its_lower_tail() {
    check("normal_cdf", NormalCdf, &sweep(), 4.0, normal_cdf);
    assert_eq!(scalar::normal_cdf(0.0), 0.5);
    assert_eq!(scalar::normal_cdf(f32::INFINITY), 1.0);
    assert_eq!(scalar::normal_cdf(f32::NEG_INFINITY).to_bits(), 0);
}

#[test]
fn gelu_is_accurate_down_to_minus_zero() {
    check("gelu", Gelu, &sweep(), 5.0, |x| if x == f64::NEG_INFINITY { -0.0 } else { x * normal_cdf(x) });
    assert_eq!(scalar::gelu(f32::NEG_INFINITY).to_bits(), (-0.0_f32).to_bits());
    assert_eq!(scalar::gelu(-0.0).to_bits(), (-0.0_f32).to_bits());
    assert_eq!(scalar::gelu(f32::INFINITY), f32::INFINITY);
}

#[derive(Clone, Copy)]
struct Sin;
impl Function for Sin {
    #[inline(always)]
    fn vector<S: Simd>(self, s: S, x: S::F32) -> S::F32 {
        super::sin_cos(s, x).0
    }
    fn scalar(self, x: f32) -> f32 {
        scalar::sin_cos(x).0
    }
}

#[derive(Clone, Copy)]
struct Cos;
impl Function for Cos {
    #[inline(always)]
    fn vector<S: Simd>(self, s: S, x: S::F32) -> S::F32 {
        super::sin_cos(s, x).1
    }
    fn scalar(self, x: f32) -> f32 {
        scalar::sin_cos(x).1
    }
}

#[test]
fn sine_and_cosine_are_accurate_for_every_argument() {
    let mut values = sweep();
    // Multiples of π/2 and of π/4, where the reduction cancels and where it switches.
    values.extend((0..20_000).map(|i| (f64::from(i - 10_000) * std::f64::consts::FRAC_PI_4) as f32));
    check("sin", Sin, &values, 2.0, double::sin);
    check("cos", Cos, &values, 2.0, double::cos);
    assert_eq!(scalar::sin_cos(-0.0).0.to_bits(), (-0.0_f32).to_bits());
    assert!(scalar::sin_cos(f32::INFINITY).1.is_nan());
}

#[test]
fn bits_are_those_of_every_other_machine() {
    fn of<F: Function>(f: F) -> u64 {
        let values = sweep();
        let mut results = vec![0.0; values.len()];
        dispatch(Level::detect(), Apply(f, &values, &mut results));
        digest(&results)
    }
    let golden = [
        ("exp", of(Exp), 0x1c0c_c238_ed89_7876),
        ("exp_nonpositive", of(ExpNonpositive), 0x4944_6869_a16c_7373),
        ("log", of(Log), 0xc7c1_e6c0_3003_b55a),
        ("softplus", of(Softplus), 0xf717_81c4_0afe_9b96),
        ("sigmoid", of(Sigmoid), 0xce93_ceff_54da_d3fa),
        ("silu", of(Silu), 0xce91_3cd1_fbbb_e4f4),
        ("tanh", of(Tanh), 0xf7a1_e4e6_62ff_c284),
        ("erf", of(Erf), 0x6b8e_696f_3fe2_2c43),
        ("erfc", of(Erfc), 0x4636_b14a_ee9c_2856),
        ("erfinv", of(Erfinv), 0x88ec_1202_a3e7_59cc),
        ("normal_cdf", of(NormalCdf), 0x19d1_052f_313b_9324),
        ("gelu", of(Gelu), 0x8eb2_03c3_5f16_ff95),
        ("sin", of(Sin), 0x0cd7_aa00_2f6c_5ea6),
        ("cos", of(Cos), 0x7321_86ee_eb2e_d301),
    ];
    for (name, got, expected) in golden {
        assert_eq!(got, expected, "{name}: {got:#018x}");
    }
}

//! Measures the error of the binary32 functions of `math` against binary64.
//!
//! ```text
//! cargo run --release -p streamsplat-kernels --example ulp                        every 251st bit pattern
//! cargo run --release -p streamsplat-kernels --example ulp -- exhaustive [NAME…]  all 2³² of them
//! cargo run --release -p streamsplat-kernels --example ulp -- --isa scalar        on a lower level
//! ```
//!
//! A row per function: the largest error in units of the last place and where it is; for functions that only grow, how
//! often a larger argument returned a smaller value; and a digest of all result bits. The digest is equal on every
//! level and machine.

use std::process::ExitCode;

use streamsplat_kernels::simd::{LANES, Operation, Simd, dispatch};
use streamsplat_kernels::{Level, math, parallel};

/// Patterns in one task.
const CHUNK: u64 = 1 << 18;

struct Function {
    name: &'static str,
    run: fn(Level, &[f32], &mut [f32]),
    exact: fn(f64) -> f64,
    ends: Ends,
    /// Arguments for which the function is defined; others only enter the digest.
    domain: fn(f32) -> bool,
    grows: bool,
}

macro_rules! row {
    ($name:literal, $f:expr, $exact:expr, $ends:expr, $domain:expr, $grows:expr) => {
        Function {
            name: $name,
            run: |level, from, to| {
                struct Apply<'a>(&'a [f32], &'a mut [f32]);
                impl Operation for Apply<'_> {
                    type Output = ();
                    #[inline(always)]
                    fn run<S: Simd>(self, s: S) {
                        for (from, to) in self.0.chunks(LANES).zip(self.1.chunks_mut(LANES)) {
                            s.store_partial($f(s, s.load_partial(from, 0.0)), to);
                        }
                    }
                }
                dispatch(level, Apply(from, to));
            },
            exact: $exact,
            ends: $ends,
            domain: $domain,
            grows: $grows,
        }
    };
}

fn sigmoid(x: f64) -> f64 {
    if x < 0.0 { math::f64::exp(x) / (1.0 + math::f64::exp(x)) } else { 1.0 / (1.0 + math::f64::exp(-x)) }
}

fn tanh(x: f64) -> f64 {
    let e = math::f64::expm1(2.0 * x.abs());
    (e / (e + 2.0)).copysign(x)
}

fn normal_cdf(x: f64) -> f64 {
    0.5 * math::f64::erfc(-x * std::f64::consts::FRAC_1_SQRT_2)
}

/// References where a few terms determine the value: |x| < 2⁻³⁰, x ≤ −128, x ≥ 128. They save the sweep most of its
/// time.
#[derive(Clone, Copy)]
struct Ends {
    tiny: fn(f64) -> f64,
    low: fn(f64) -> f64,
    high: fn(f64) -> f64,
}

fn rows() -> Vec<Function> {
    const SLOPE: f64 = std::f64::consts::FRAC_2_SQRT_PI;
    const LN_2: f64 = std::f64::consts::LN_2;
    let always: fn(f32) -> bool = |_| true;
    let exp = Ends { tiny: |x| 1.0 + x, low: |_| 0.0, high: |_| f64::INFINITY };
    let exp_nonpositive = Ends { ..exp };
    let softplus = Ends { tiny: |x| LN_2 + 0.5 * x, low: |_| 0.0, high: |x| x };
    let logistic = Ends { tiny: |x| 0.5 + 0.25 * x, low: |_| 0.0, high: |_| 1.0 };
    let silu = Ends { tiny: |x| 0.5 * x + 0.25 * x * x, low: |_| -0.0, high: |x| x };
    let tangent = Ends { tiny: |x| x, low: |_| -1.0, high: |_| 1.0 };
    let erf = Ends { tiny: |x| SLOPE * x, ..tangent };
    let erfc = Ends { tiny: |x| 1.0 - SLOPE * x, low: |_| 2.0, high: |_| 0.0 };
    let erfinv = Ends { tiny: |x| x / SLOPE, low: |_| f64::NAN, high: |_| f64::NAN };
    const HALF: f64 = 0.5 * std::f64::consts::FRAC_1_SQRT_2 * SLOPE;
    let cdf = Ends { tiny: |x| 0.5 + HALF * x, ..logistic };
    let gelu = Ends { tiny: |x| 0.5 * x + HALF * x * x, ..silu };
    let sin = Ends { tiny: |x| x, low: math::f64::sin, high: math::f64::sin };
    let cos = Ends { tiny: |_| 1.0, low: math::f64::cos, high: math::f64::cos };
    let log = Ends { tiny: math::f64::ln, low: |_| f64::NAN, high: math::f64::ln };
    let flushed = |x: f64| if x < -126.5 * LN_2 { 0.0 } else { math::f64::exp(x) };
    let softplus_of = |x: f64| x.max(0.0) + math::f64::ln_1p(math::f64::exp(-x.abs()));
    vec![
        row!("exp", math::exp, math::f64::exp, exp, always, true),
        row!("exp_nonpositive", math::exp_nonpositive, flushed, exp_nonpositive, |x| x <= 0.0, true),
        row!("log", math::log, math::f64::ln, log, always, true),
        row!("softplus", math::softplus, softplus_of, softplus, always, true),
        row!("sigmoid", math::sigmoid, sigmoid, logistic, always, true),
        row!("silu", math::silu, |x| x * sigmoid(x), silu, always, false),
        row!("tanh", math::tanh, tanh, tangent, always, true),
        row!("erf", math::erf, math::f64::erf, erf, always, true),
        row!("erfc", math::erfc, math::f64::erfc, erfc, always, false),
        row!("erfinv", math::erfinv, math::f64::erfinv, erfinv, always, true),
        row!("normal_cdf", math::normal_cdf, normal_cdf, cdf, always, true),
        row!("gelu", math::gelu, |x| x * normal_cdf(x), gelu, always, false),
        row!("sin", |s, x| math::sin_cos(s, x).0, math::f64::sin, sin, always, false),
        row!("cos", |s, x| math::sin_cos(s, x).1, math::f64::cos, cos, always, false),
    ]
}

impl Function {
    fn reference(&self, x: f32) -> f64 {
        let wide = f64::from(x);
        if x.abs() < 9.313_226e-10 {
            (self.ends.tiny)(wide)
        } else if x >= 128.0 {
            (self.ends.high)(wide)
        } else if x <= -128.0 {
            (self.ends.low)(wide)
        } else {
            (self.exact)(wide)
        }
    }
}

/// The `i`-th binary32 pattern in ascending order of value, negative NaN first and positive NaN last.
fn ascending(i: u32) -> f32 {
    f32::from_bits(if i < 1 << 31 { !i } else { i ^ 1 << 31 })
}

/// The distance of `got` from `exact` in units of the last place of binary32 at `exact`.
fn ulps(got: f32, exact: f64) -> f64 {
    if exact.is_nan() || got.is_nan() {
        return if exact.is_nan() && got.is_nan() { 0.0 } else { f64::INFINITY };
    }
    if f64::from(got) == exact || got == exact as f32 && got.is_infinite() {
        return 0.0;
    }
    // An infinity that should be finite, or the reverse, counts from 2¹²⁸.
    let got = if got.is_infinite() { 2.0_f64.powi(128).copysign(f64::from(got)) } else { f64::from(got) };
    let exact = exact.clamp(-(2.0_f64.powi(128)), 2.0_f64.powi(128));
    let exponent = ((exact.to_bits() >> 52 & 0x7ff) as i32 - 1023).clamp(-126, 127);
    (got - exact).abs() * f64::from_bits(((1023 + 23 - exponent) as u64) << 52)
}

struct Part {
    worst: f64,
    at: f32,
    falls: u64,
    digest: u64,
    ends: Option<(f32, f32)>,
}

/// FNV over the bits, all NaN as one.
fn digest(digest: u64, y: f32) -> u64 {
    let bits = if y.is_nan() { f32::NAN.to_bits() } else { y.to_bits() };
    (digest ^ u64::from(bits)).wrapping_mul(0x100_0000_01b3)
}

fn measure(row: &Function, level: Level, step: u64) -> Part {
    let parts = parallel::map_indexed(((1 << 32) / CHUNK) as usize, |task| {
        let start = task as u64 * CHUNK;
        let first = start.next_multiple_of(step);
        let x: Vec<f32> = (first..start + CHUNK).step_by(step as usize).map(|i| ascending(i as u32)).collect();
        let mut y = vec![0.0; x.len()];
        (row.run)(level, &x, &mut y);
        let mut part = Part { worst: 0.0, at: 0.0, falls: 0, digest: 0xcbf2_9ce4_8422_2325, ends: None };
        for (&x, &y) in x.iter().zip(&y) {
            part.digest = digest(part.digest, y);
            if !(row.domain)(x) {
                continue;
            }
            let error = ulps(y, row.reference(x));
            if error > part.worst {
                (part.worst, part.at) = (error, x);
            }
            if y.is_nan() {
                continue;
            }
            if let Some((_, last)) = part.ends {
                part.falls += u64::from(y < last);
            }
            part.ends = Some((part.ends.map_or(y, |e| e.0), y));
        }
        part
    });
    let mut all = Part { worst: 0.0, at: 0.0, falls: 0, digest: 0, ends: None };
    for part in parts {
        if part.worst > all.worst {
            (all.worst, all.at) = (part.worst, part.at);
        }
        all.falls += part.falls;
        all.digest = (all.digest ^ part.digest).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        if let (Some((_, last)), Some((first, _))) = (all.ends, part.ends) {
            all.falls += u64::from(first < last);
        }
        all.ends = part.ends.or(all.ends);
    }
    all
}

fn main() -> ExitCode {
    let mut step = 251;
    let mut isa = "auto".to_owned();
    let mut names = Vec::new();
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "exhaustive" => step = 1,
            "--isa" => isa = arguments.next().unwrap_or_default(),
            name if rows().iter().any(|row| row.name == name) => names.push(argument),
            unknown => {
                eprintln!("unknown argument {unknown:?}: expected exhaustive, --isa LEVEL or names of functions");
                return ExitCode::from(2);
            }
        }
    }
    let level = match Level::named(&isa) {
        Ok(level) => level,
        Err(error) => {
            eprintln!("{error}");
            return ExitCode::from(2);
        }
    };
    println!("level {level}, every {step}. of 2^32 bit patterns");
    println!("| function | ulp | at | falls | digest |\n|---|---|---|---|---|");
    for row in rows().iter().filter(|row| names.is_empty() || names.iter().any(|name| name == row.name)) {
        let part = measure(row, level, step);
        let falls = if row.grows { part.falls.to_string() } else { "–".to_owned() };
        println!("| {} | {:.3} | {:e} | {falls} | {:016x} |", row.name, part.worst, part.at, part.digest);
    }
    ExitCode::SUCCESS
}

//! Measures the error of the binary32 functions of `math` against binary64.
//!
//! ```text
//! cargo run --release -p streamsplat-kernels --example ulp                        every 251st bit pattern
//! cargo run --release -p streamsplat-kernels --example ulp -- exhaustive [NAME…]  all 2³² of them
//! cargo run --release -p streamsplat-kernels --example ulp -- --isa scalar        on a lower level
//! ```
//!
//! A row per function: the largest error in units of the last place and where it is, how often a larger argument gave a
//! smaller value (of functions that only grow), and a digest of all result bits: equal on every level and machine.

use std::process::ExitCode;

use streamsplat_kernels::simd::{LANES, Operation, Simd, dispatch};
use streamsplat_kernels::{Level, math, parallel};

/// Patterns in one task.
const CHUNK: u64 = 1 << 18;

struct Row {
    name: &'static str,
    run: fn(Level, &[f32], &mut [f32]),
    exact: fn(f64) -> f64,
    /// Arguments it is defined for; others only enter the digest.
    domain: fn(f32) -> bool,
    grows: bool,
}

macro_rules! row {
    ($name:literal, $f:expr, $exact:expr, $domain:expr, $grows:expr) => {
        Row {
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
    (if e < 1e20 { e / (e + 2.0) } else { 0.0 * x.signum() + 1.0 }).copysign(x)
}

fn normal_cdf(x: f64) -> f64 {
    0.5 * math::f64::erfc(-x * std::f64::consts::FRAC_1_SQRT_2)
}

fn rows() -> Vec<Row> {
    let always: fn(f32) -> bool = |_| true;
    vec![
        row!("exp", math::exp, math::f64::exp, always, true),
        row!(
            "exp_nonpositive",
            math::exp_nonpositive,
            |x| if x < -126.5 * std::f64::consts::LN_2 { 0.0 } else { math::f64::exp(x) },
            |x| x <= 0.0,
            true
        ),
        row!("log", math::log, math::f64::ln, always, true),
        row!("softplus", math::softplus, |x| x.max(0.0) + math::f64::ln_1p(math::f64::exp(-x.abs())), always, true),
        row!("sigmoid", math::sigmoid, sigmoid, always, true),
        row!("silu", math::silu, |x| if x < -1000.0 { -0.0 } else { x * sigmoid(x) }, always, false),
        row!("tanh", math::tanh, tanh, always, true),
        row!("erf", math::erf, math::f64::erf, always, true),
        row!("erfc", math::erfc, math::f64::erfc, always, false),
        row!("erfinv", math::erfinv, math::f64::erfinv, always, true),
        row!("normal_cdf", math::normal_cdf, normal_cdf, always, true),
        row!("gelu", math::gelu, |x| if x < -1000.0 { -0.0 } else { x * normal_cdf(x) }, always, false),
        row!("sin", |s, x| math::sin_cos(s, x).0, math::f64::sin, always, false),
        row!("cos", |s, x| math::sin_cos(s, x).1, math::f64::cos, always, false),
    ]
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
    (got - exact).abs() / 2.0_f64.powi(exponent - 23)
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

fn measure(row: &Row, level: Level, step: u64) -> Part {
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
            let error = ulps(y, (row.exact)(f64::from(x)));
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

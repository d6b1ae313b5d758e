//! `kernels`: each kernel at the sizes of the published model and of the small one.

use anyhow::{Result, ensure};
use clap::{Args, ValueEnum};
use serde::Serialize;
use streamsplat_bench::Common;
use streamsplat_bench::machine::{Machine, peak};
use streamsplat_bench::table::{Column, Table};
use streamsplat_bench::timing::{Seconds, once};
use streamsplat_kernels::Level;
use streamsplat_kernels::attention::{self, Rows, Shape, Windows, attend_as};
use streamsplat_kernels::gemm::{self, Epilogue, Precision, Weights, linear};
use streamsplat_kernels::memory::Aligned;
use streamsplat_kernels::norm;

/// Options of `kernels`.
#[derive(Args)]
pub(crate) struct Options {
    #[command(flatten)]
    common: Common,
    /// The model whose sizes are measured.
    #[arg(long, value_enum, default_value_t = Size::All)]
    size: Size,
    /// Formats of the operands.
    #[arg(long, value_enum, num_args = 1.., default_values = ["f32", "bf16", "int8"])]
    precision: Vec<Format>,
    /// Only kernels whose name contains this.
    #[arg(long, default_value = "")]
    only: String,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Size {
    Paper,
    Small,
    All,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    F32,
    Bf16,
    Int8,
}

impl Format {
    fn precision(self) -> (&'static str, Precision) {
        match self {
            Format::F32 => ("f32", Precision::F32),
            Format::Bf16 => ("bf16", Precision::Bf16),
            Format::Int8 => ("int8", Precision::Int8),
        }
    }
}

const TABLE: Table<'_> = Table(&[
    Column::Text("kernel", 22),
    Column::Text("model", 6),
    Column::Text("type", 5),
    Column::Number("size", 20),
    Column::Number("ms (min)", 9),
    Column::Number("GFLOP/s", 9),
    Column::Number("of peak", 8),
]);

#[derive(Serialize)]
struct KernelTiming {
    kernel: String,
    model: &'static str,
    precision: &'static str,
    size: String,
    gflop: f64,
    seconds: Seconds,
    gflops: f64,
    fraction_of_peak: f64,
}

#[derive(Serialize)]
struct Results {
    machine: Machine,
    kernels: Vec<KernelTiming>,
}

/// One kernel at one size, already checked.
struct Case {
    kernel: String,
    model: &'static str,
    precision: (&'static str, Precision),
    size: String,
    flop: f64,
    work: Box<dyn FnMut() + Send>,
}

pub(crate) fn run(options: &Options) -> Result<()> {
    options.common.pool()?.install(|| measure(options))
}

fn measure(options: &Options) -> Result<()> {
    let level = options.common.isa;
    let mut cases = Vec::new();
    let wanted = |name: &str| name.contains(&options.only);
    for (model, products, attentions, norms) in [PAPER, SMALL] {
        if options.size != Size::All && (options.size == Size::Paper) != (model == "paper") {
            continue;
        }
        for precision in options.precision.iter().map(|f| f.precision()) {
            for &(name, m, n, k) in products.iter().filter(|p| wanted(p.0)) {
                cases.push(product(level, model, precision, name, m, n, k)?);
            }
            for &(name, queries, keys, heads, window) in attentions.iter().filter(|a| wanted(a.0)) {
                cases.push(attention(level, model, precision, name, queries, keys, heads, window)?);
            }
        }
        for &(rows, d) in norms.iter().filter(|_| wanted("rms_norm")) {
            cases.push(rms_norm(level, model, rows, d));
        }
    }
    // The best of each precision so far: clocks move, and other work can only slow a loop down.
    let mut peaks = [0.0_f64; 3];
    let mut rows = Vec::new();
    println!("{}", TABLE.heads());
    for mut case in cases {
        let mut times = Vec::new();
        for _ in 0..options.common.repeat.max(1) {
            // The peak is measured next to every run, as clock rates change.
            let best = &mut peaks[case.precision.1 as usize];
            *best = best.max(peak(level, case.precision.1));
            times.push(once(&mut case.work));
        }
        let seconds = Seconds::of(times);
        let gflops = case.flop / seconds.min / 1e9;
        let row = KernelTiming {
            kernel: case.kernel,
            model: case.model,
            precision: case.precision.0,
            size: case.size,
            gflop: case.flop / 1e9,
            seconds,
            gflops,
            fraction_of_peak: gflops / peaks[case.precision.1 as usize],
        };
        let [ms, peak] = [seconds.min * 1e3, row.fraction_of_peak * 100.0];
        let figures = [format!("{ms:.3}"), format!("{gflops:.1}"), format!("{peak:.1}%")];
        let [ms, gflops, peak] = &figures;
        println!("{}", TABLE.line(&[&row.kernel, row.model, row.precision, &row.size, ms, gflops, peak]));
        rows.push(row);
    }
    let machine = Machine::new(level, (Precision::F32, peaks[0]));
    println!("{machine}");
    options.common.write(&Results { machine, kernels: rows })
}

type Products = &'static [(&'static str, usize, usize, usize)];
type Attentions = &'static [(&'static str, usize, usize, usize, Option<usize>)];
type Norms = &'static [(usize, usize)];

/// The published model: 2304 tokens of 768 channels, 12 heads; the upsampler's stages; the decoder's two frames.
const PAPER: (&str, Products, Attentions, Norms) = (
    "paper",
    &[
        ("linear qkv", 2304, 2304, 768),
        ("linear out", 2304, 768, 768),
        ("linear mlp up", 2304, 3072, 768),
        ("linear mlp down", 2304, 768, 3072),
        ("linear decoder mlp", 4608, 3072, 768),
        ("linear upsample 1", 9216, 1152, 384),
        ("linear upsample 2", 36_864, 576, 192),
        ("linear embed", 2304, 768, 256),
    ],
    &[
        ("attention encoder", 2304, 2304, 12, None),
        ("attention decoder", 4608, 4608, 12, None),
        ("attention cross", 2304, 576, 12, None),
        ("attention window", 9216, 9216, 6, Some(2304)),
    ],
    &[(2304, 768), (36_864, 192)],
);

/// The small model: 576 tokens of 192 channels, 3 heads; its upsampler's stages of 64 channels in windows of 128.
const SMALL: (&str, Products, Attentions, Norms) = (
    "small",
    &[
        ("linear qkv", 576, 576, 192),
        ("linear out", 576, 192, 192),
        ("linear mlp up", 576, 768, 192),
        ("linear mlp down", 576, 192, 768),
        ("linear upsample 1", 2304, 192, 64),
        ("linear upsample 2", 9216, 192, 64),
        ("linear upsample mlp", 9216, 64, 256),
    ],
    &[("attention decoder", 1152, 1152, 3, None), ("attention window", 9216, 9216, 1, Some(128))],
    &[(576, 192), (9216, 64)],
);

/// Values between −1 and 1 that follow from `seed`.
fn noise(len: usize, seed: u32) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9e37_79b9) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        state as f32 / 2_147_483_648.0 - 1.0
    };
    (0..len).map(|_| next()).collect()
}

/// Zeros as the model holds its matrices: on cache lines.
fn zeros(len: usize) -> Aligned<f32> {
    Aligned::zeroed(len)
}

/// [`noise`] in aligned memory, as the model's matrices.
fn aligned_noise(len: usize, seed: u32) -> Aligned<f32> {
    let mut values = zeros(len);
    values.copy_from_slice(&noise(len, seed));
    values
}

fn product(
    level: Level,
    model: &'static str,
    precision: (&'static str, Precision),
    name: &str,
    m: usize,
    n: usize,
    k: usize,
) -> Result<Case> {
    let (x, w) = (aligned_noise(m * k, 1), noise(n * k, 2));
    let weights = Weights::pack_as(level, precision.1, &w, n, k);
    let mut out = zeros(m * n);
    linear(level, &x, m, &weights, &Epilogue::new(), &mut out);
    for i in 0..97 {
        let (row, column) = (i * 7919 % m, i * 104_729 % n);
        let (x, w) = (&x[row * k..][..k], &w[column * k..][..k]);
        let expected = gemm::reference::product_as(precision.1, x, w, 1, 1, k)[0];
        let found = out[row * n + column];
        ensure!(found.to_bits() == expected.to_bits(), "{name} at {row},{column}: {found}, expected {expected}");
    }
    Ok(Case {
        kernel: name.to_owned(),
        model,
        precision,
        size: format!("{m}x{n}x{k}"),
        flop: 2.0 * (m * n * k) as f64,
        work: Box::new(move || linear(level, &x, m, &weights, &Epilogue::new(), &mut out)),
    })
}

fn attention(
    level: Level,
    model: &'static str,
    precision: (&'static str, Precision),
    name: &str,
    queries: usize,
    keys: usize,
    heads: usize,
    window: Option<usize>,
) -> Result<Case> {
    let d = heads * 64;
    // As in the model: heads follow one another.
    let (q, k, v) = (aligned_noise(queries * d, 1), aligned_noise(keys * d, 2), aligned_noise(keys * d, 3));
    let windows = window.map_or(Windows::Full, |length| Windows::Runs { length, roll: 0 });
    let shape = Shape { heads, width: 64, windows };
    let mut out = zeros(queries * d);
    let seen = window.unwrap_or(keys);
    let first = |x: &[f32], rows: usize, count: usize| -> Vec<f32> {
        (0..count).flat_map(|row| x.chunks(rows * 64).flat_map(move |head| head[row * 64..][..64].to_vec())).collect()
    };
    let expected = attention::reference::attend(
        &first(&q, queries, 1),
        &first(&k, keys, seen),
        &first(&v, keys, seen),
        heads,
        64,
        |_, _| true,
    );
    let mut work = move || {
        let (q, k, v) =
            (Rows::of_heads(&q, queries, 64, 0), Rows::of_heads(&k, keys, 64, 0), Rows::of_heads(&v, keys, 64, 0));
        attend_as(precision.1, level, shape, q, k, v, &mut out);
        out[..d].to_vec()
    };
    let bound = if precision.1 == Precision::F32 { 1e-6 } else { 1e-2 };
    for (found, expected) in work().iter().zip(&expected) {
        let error = (f64::from(*found) - expected).abs();
        ensure!(error < bound, "{name}: {found}, expected {expected}");
    }
    Ok(Case {
        kernel: name.to_owned(),
        model,
        precision,
        size: format!("{queries}x{seen} {heads} heads"),
        flop: 4.0 * (queries * seen * d) as f64,
        work: Box::new(move || {
            work();
        }),
    })
}

fn rms_norm(level: Level, model: &'static str, rows: usize, d: usize) -> Case {
    let (x, w) = (aligned_noise(rows * d, 1), noise(d, 2));
    let mut out = zeros(rows * d);
    Case {
        kernel: "rms_norm".to_owned(),
        model,
        precision: ("f32", Precision::F32),
        size: format!("{rows}x{d}"),
        flop: 4.0 * (rows * d) as f64,
        work: Box::new(move || norm::rms_norm(level, &x, &w, 1e-5, &mut out)),
    }
}

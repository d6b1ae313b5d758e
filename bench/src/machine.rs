//! Peak of the machine, from loops of independent instructions.

use serde::Serialize;
use streamsplat_kernels::Level;
use streamsplat_kernels::gemm::Precision;
use streamsplat_kernels::simd::{Operation, Registers, Simd, dispatch};

use crate::timing::once;

/// The machine of a measurement.
#[derive(Serialize)]
pub struct Machine {
    cpu: String,
    threads: usize,
    isa: &'static str,
    peak_gflops: Peak,
}

/// Billions of operations a second on all threads, a multiplication and an addition counted as two.
#[derive(Serialize)]
pub struct Peak {
    f32: f64,
    bf16: f64,
    int8: f64,
}

impl Machine {
    /// This machine with the threads of the current pool. `seen` is a peak measured during the run: clock rates change,
    /// and the best counts.
    pub fn new(level: Level, seen: (Precision, f64)) -> Machine {
        let best = |precision| {
            let start = if seen.0 == precision { seen.1 } else { 0.0 };
            (0..5).fold(start, |best: f64, _| best.max(peak(level, precision)))
        };
        let peak_gflops = Peak { f32: best(Precision::F32), bf16: best(Precision::Bf16), int8: best(Precision::Int8) };
        Machine { cpu: cpu(), threads: rayon::current_num_threads(), isa: level.name(), peak_gflops }
    }
}

impl std::fmt::Display for Machine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Peak { f32, bf16, int8 } = self.peak_gflops;
        let Machine { cpu, threads, isa, .. } = self;
        write!(f, "peak {f32:.1} GFLOP/s f32, {bf16:.1} bf16, {int8:.1} int8: {threads} threads, {isa}, {cpu}")
    }
}

/// The processor's name.
pub fn cpu() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let line = info.lines().find(|l| l.starts_with("model name") || l.starts_with("CPU part"));
    line.and_then(|l| l.split_once(':')).map_or_else(|| std::env::consts::ARCH.to_owned(), |(_, n)| n.trim().to_owned())
}

/// Chains of a precision's multiply-add in as many accumulators as the level's register block has. Returns operations
/// done.
///
/// Where a level has no dot products of words, bf16 runs on f32's instruction and 8-bit integers on that of 16-bit
/// pairs.
struct Chains(Precision, usize);

impl Operation for Chains {
    const DOT_PRODUCTS: bool = true;
    type Output = f64;
    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> f64 {
        match S::REGISTERS {
            Registers::Avx512 => chains::<S, 24>(s, self.0, self.1),
            Registers::Avx2 | Registers::Neon => chains::<S, 6>(s, self.0, self.1),
            Registers::Scalar => chains::<S, 2>(s, self.0, self.1),
        }
    }
}

#[inline(always)]
fn chains<S: Simd, const N: usize>(s: S, precision: Precision, steps: usize) -> f64 {
    let lanes = (N * 16 * steps) as f64;
    let (a, b) = (s.splat(std::hint::black_box(0.999)), s.splat(std::hint::black_box(0.001)));
    let (i, j) = (s.splat_i32(std::hint::black_box(0x3f80_3f80)), s.splat_i32(std::hint::black_box(0x0102_0304)));
    if precision == Precision::Int8 {
        let mut acc = [j; N];
        for _ in 0..steps {
            for acc in &mut acc {
                *acc = if S::BYTE_DOT { s.dot_bytes(*acc, i, j) } else { s.add_i32(*acc, s.dot_i16(*acc, j)) };
            }
        }
        for acc in acc {
            std::hint::black_box(s.to_array_i32(acc));
        }
        return lanes * if S::BYTE_DOT { 8.0 } else { 4.0 };
    }
    let dot = S::BF16_DOT && precision == Precision::Bf16;
    let mut acc = [b; N];
    for _ in 0..steps {
        for acc in &mut acc {
            *acc = if dot { s.dot_bf16(*acc, i, j) } else { s.mul_add(*acc, a, b) };
        }
    }
    for acc in acc {
        std::hint::black_box(s.to_array(acc));
    }
    lanes * if dot { 4.0 } else { 2.0 }
}

/// Billions of a precision's operations a second on all threads of the current pool, measured once (some ten
/// milliseconds).
pub fn peak(level: Level, precision: Precision) -> f64 {
    let steps = if level == Level::scalar() { 10_000 } else { 200_000 };
    let mut done = 0.0;
    let seconds = once(|| {
        let each = rayon::broadcast(|_| std::hint::black_box(dispatch(level, Chains(precision, steps))));
        done = each.iter().sum();
    });
    done / seconds / 1e9
}

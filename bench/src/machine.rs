//! What the machine can do at most, from loops of independent instructions.

use serde::Serialize;
use streamsplat_kernels::Level;
use streamsplat_kernels::simd::{Operation, Simd, dispatch};

use crate::timing::once;

/// The machine of a measurement.
#[derive(Serialize)]
pub(crate) struct Machine {
    cpu: String,
    threads: usize,
    isa: &'static str,
    pub(crate) peak_gflops: Peak,
}

/// Billions of operations a second on all threads, a multiplication and an addition counted as two.
#[derive(Serialize)]
pub(crate) struct Peak {
    pub(crate) f32: f64,
}

impl Machine {
    /// This machine with the threads of the current pool; `peak_gflops` in f32.
    pub(crate) fn new(level: Level, f32: f64) -> Machine {
        Machine { cpu: cpu(), threads: rayon::current_num_threads(), isa: level.name(), peak_gflops: Peak { f32 } }
    }
}

fn cpu() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let line = info.lines().find(|l| l.starts_with("model name") || l.starts_with("CPU part"));
    line.and_then(|l| l.split_once(':')).map_or_else(|| std::env::consts::ARCH.to_owned(), |(_, n)| n.trim().to_owned())
}

/// A chain of fused multiply-adds in every accumulator of the level's register block.
struct Chains(usize);

impl Operation for Chains {
    type Output = f32;
    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> f32 {
        match (S::GEMM_ROWS, S::GEMM_PANELS) {
            (12, 2) => chains::<S, 24>(s, self.0),
            (6, 1) => chains::<S, 6>(s, self.0),
            _ => chains::<S, 2>(s, self.0),
        }
    }
}

#[inline(always)]
fn chains<S: Simd, const N: usize>(s: S, steps: usize) -> f32 {
    let (a, b) = (s.splat(std::hint::black_box(0.999)), s.splat(std::hint::black_box(0.001)));
    let mut acc: [S::F32; N] = std::array::from_fn(|i| s.splat(i as f32));
    for _ in 0..steps {
        for acc in &mut acc {
            *acc = s.mul_add(*acc, a, b);
        }
    }
    acc.iter().map(|&acc| s.sum(acc)).sum()
}

/// Fused multiply-adds a step of [`Chains`] does, times 2.
fn flops_of_a_step(level: Level) -> f64 {
    struct Count;
    impl Operation for Count {
        type Output = usize;
        fn run<S: Simd>(self, _: S) -> usize {
            match (S::GEMM_ROWS, S::GEMM_PANELS) {
                (12, 2) => 24,
                (6, 1) => 6,
                _ => 2,
            }
        }
    }
    (dispatch(level, Count) * 16 * 2) as f64
}

/// GFLOP/s of fused multiply-adds in f32 on all threads of the current pool, measured once (about 20 ms).
pub(crate) fn peak_f32(level: Level) -> f64 {
    let steps = if level == Level::scalar() { 20_000 } else { 400_000 };
    let seconds = once(|| {
        rayon::broadcast(|_| std::hint::black_box(dispatch(level, Chains(steps))));
    });
    flops_of_a_step(level) * steps as f64 * rayon::current_num_threads() as f64 / seconds / 1e9
}

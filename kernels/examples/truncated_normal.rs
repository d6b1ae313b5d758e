//! Kolmogorov–Smirnov test of the truncated normal at its extremes.
//!
//! ```text
//! cargo run --release -p streamsplat-kernels --example truncated_normal [-- DRAWS]     10,000,000 by default
//! ```
//!
//! A row per parameter pair: √n times the largest distance of the empirical from the exact distribution, and the
//! probability of a larger one by chance. Exits with 1 where that is under 1e-5.

use std::process::ExitCode;

use streamsplat_kernels::philox::Stream;
use streamsplat_kernels::truncated_normal::{BOUND, quantile, reference::distribution};

/// Kolmogorov's distribution: the probability that √n·D is above `x`.
fn exceeded(x: f64) -> f64 {
    let sum = |sum: f64, k: i32| {
        let k = f64::from(k);
        sum + (if k % 2.0 == 1.0 { 2.0 } else { -2.0 }) * (-2.0 * k * k * x * x).exp()
    };
    if x < 0.3 { 1.0 } else { (1..60).fold(0.0, sum).clamp(0.0, 1.0) }
}

fn main() -> ExitCode {
    let draws = match std::env::args().nth(1).map(|n| n.parse::<u64>()) {
        None => 10_000_000,
        Some(Ok(n)) if n > 0 => n,
        Some(_) => {
            eprintln!("expected a number of draws");
            return ExitCode::from(2);
        }
    };
    let mut good = true;
    println!("| mean | log scale | √n·D of {draws} draws | p |\n|---|---|---|---|");
    for (i, mean) in [-0.999, 0.0, 0.6, 0.999].into_iter().enumerate() {
        for (j, log_scale) in [-20.0, -5.0, -1.0, 0.0, 6.7, 60.0].into_iter().enumerate() {
            let stream = Stream { seed: 2026, frame: (100 * i + j) as u64 };
            // 53 bits, from two words.
            let uniform = |k| {
                let [a, b, ..] = stream.words(k);
                (f64::from(a >> 5) * 67_108_864.0 + f64::from(b >> 6) + 0.5) / 9_007_199_254_740_992.0
            };
            let mut values: Vec<f64> = (0..draws).map(|k| quantile(mean, log_scale, uniform(k))).collect();
            good &= values.iter().all(|x| x.abs() <= f64::from(BOUND));
            values.sort_unstable_by(f64::total_cmp);
            let n = draws as f64;
            let distance = values.iter().enumerate().fold(0.0_f64, |d, (k, &x)| {
                let f = distribution(mean, log_scale, x);
                d.max((f - k as f64 / n).abs()).max(((k + 1) as f64 / n - f).abs())
            });
            let p = exceeded(distance * n.sqrt());
            good &= p >= 1e-5;
            println!("| {mean} | {log_scale} | {:.3} | {p:.4} |", distance * n.sqrt());
        }
    }
    if good { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

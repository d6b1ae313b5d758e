//! Helpers that the kernels' tests share.

use std::io::Write;
use std::sync::Once;

use crate::Level;

/// `len` values between −1 and 1 that follow from `seed`.
pub(crate) fn noise(len: usize, seed: u32) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9e37_79b9) ^ 0x85eb_ca6b;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        state as f32 / 2_147_483_648.0 - 1.0
    };
    (0..len).map(|_| next()).collect()
}

/// The bits of values, with one pattern for all NaN.
pub(crate) fn bits(x: &[f32]) -> Vec<u32> {
    x.iter().map(|x| if x.is_nan() { f32::NAN.to_bits() } else { x.to_bits() }).collect()
}

/// Returns the levels of this machine. Prints once, past the test harness, which levels were skipped.
pub(crate) fn levels() -> Vec<Level> {
    static PRINTED: Once = Once::new();
    let levels = Level::available();
    PRINTED.call_once(|| {
        let has = |name: &&str| levels.iter().any(|level| level.name() == *name);
        let (tested, skipped): (Vec<_>, Vec<_>) = Level::NAMES.into_iter().partition(has);
        let line =
            format!("levels tested: {}; skipped, not on this machine: {}\n", tested.join(" "), skipped.join(" "));
        std::io::stderr().write_all(line.as_bytes()).expect("the standard error is open");
    });
    levels
}

/// Returns the result of `compute` on the scalar level with one thread. Checks that it writes the same bits on every
/// level with 1, 2, 3 and 8 threads. The output holds 0.5 before each call.
pub(crate) fn on_every_level_and_thread_count(len: usize, compute: impl Fn(Level, &mut [f32]) + Sync) -> Vec<f32> {
    let run = |level, threads| {
        let mut out = vec![0.5; len];
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
        pool.install(|| compute(level, &mut out));
        out
    };
    let expected = run(Level::scalar(), 1);
    for level in levels() {
        for threads in [1, 2, 3, 8] {
            assert!(bits(&run(level, threads)) == bits(&expected), "{level} with {threads} threads differs");
        }
    }
    expected
}

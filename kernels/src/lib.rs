//! Arithmetic of StreamSplat on CPUs. Knows nothing of models.
//!
//! Every operation lives in one folder: documentation with its formula and order of accumulation, a plain reference, the
//! generic body over a 16-lane vector, and overrides per instruction-set level. All of them keep the *bit contract*: the
//! output bits are the same on every [`Level`] and for any number of threads.
//!
//! An operation runs in a [`tracing`] span that is named after its folder (those of `raster` after its passes), at the level `DEBUG`. Where nobody
//! listens, that is one comparison a call.

#![deny(unsafe_code)]

pub mod activation;
pub mod attention;
pub mod change;
pub mod feed_forward;
#[expect(
    unsafe_code,
    reason = "taps and patches are read, and rows are written by several tasks, without a check for each value"
)]
pub mod flow;
pub mod gemm;
pub mod harmonics;
pub mod level;
pub mod math;
pub mod memory;
pub mod norm;
pub mod parallel;
pub mod patches;
pub mod philox;
pub mod pointwise;
pub mod raster;
pub mod resize;
pub mod simd;
mod size;
#[cfg(test)]
mod testing;
pub mod truncated_normal;

pub use level::{Level, LevelError};

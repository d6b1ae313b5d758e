//! Arithmetic of StreamSplat on CPUs, independent of models.
//!
//! An operation is a folder. It holds documentation with the formula and the order of accumulation, a body that is
//! generic over a vector of 16 lanes ([`simd`]), and tests. It has a plain reference where a formula in binary64 or
//! scalar code is clearer than the body. Elementary functions ([`math`]) have scalar twins. Levels differ only in
//! [`simd`] and in the sizes of register blocks. Everything keeps the *bit contract*: the output bits are the same on
//! every [`Level`] and for any number of threads.
//!
//! Operations run in [`tracing`] spans at the level `DEBUG`, named after the operation (those of `raster` after its
//! passes). Without a subscriber, that is one comparison a call.

#![deny(unsafe_code)]

pub mod activation;
pub mod attention;
pub mod change;
pub mod exposure;
pub mod feed_forward;
pub mod fill;
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

//! One vector of 16 lanes on every instruction-set level. All intrinsics are in this module.
//!
//! A kernel is written once, generic over [`Simd`], and entered through [`dispatch`]. Elementary functions need only
//! operations on each lane alone ([`Elementwise`]), and also run on a single value. Every operation is defined to the
//! bit, so a kernel that uses nothing else computes equal bits on every level:
//!
//! - arithmetic is IEEE 754 binary32, round to nearest even, denormals kept; [`Elementwise::mul_add`] rounds once
//!   everywhere, [`Elementwise::mul`] and [`Elementwise::add`] are never fused;
//! - [`Elementwise::min`] and [`Elementwise::max`] are comparisons followed by a selection: where either operand is
//!   NaN, or both are zeros, the *second* operand is the result;
//! - [`Simd::sum`] and [`Simd::max_lane`] fold lanes `i` and `i+8`, then `i` and `i+4`, `i+2`, `i+1`;
//! - only the bits of a NaN *result* are unspecified; kernels never store NaN.
//!
//! Inside a parallel task call [`dispatch`] again: a closure passed to another thread leaves the instruction-set
//! context.

#![expect(unsafe_code, reason = "the home of intrinsics")]

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod bf16;
mod detect;
mod dispatch;
mod elementwise;
mod magnitude;
#[cfg(target_arch = "aarch64")]
mod neon;
mod prefetch;
mod scalar;
mod transpose;
mod vector;

#[cfg(test)]
mod tests;

pub(crate) use bf16::{HIGH, pair_bf16, round_bf16};
pub use dispatch::dispatch;
pub use elementwise::Elementwise;
pub(crate) use elementwise::SHIFTER;
pub(crate) use magnitude::{larger, largest, largest_magnitude};
pub(crate) use prefetch::{again, prefetch, prefetch_near};
pub(crate) use scalar::One;
pub use scalar::fused_mul_add;
pub(crate) use transpose::{transpose2, transpose4};
pub use vector::{LANES, Operation, Registers, Simd};

//! Arithmetic of StreamSplat on CPUs. Knows nothing of models.
//!
//! Every operation lives in one folder: documentation with its formula and order of accumulation, a plain reference, the
//! generic body over a 16-lane vector, and overrides per instruction-set level. All of them keep the *bit contract*: the
//! output bits are the same on every [`Level`] and for any number of threads.

pub mod level;
pub mod math;
pub mod parallel;
pub mod simd;

pub use level::{Level, LevelError};

//! Contracts across crates: helpers of the integration tests.

pub mod digest;
pub mod extremes;
pub mod fuzz;
mod noise;
pub mod parity;
pub mod reference;
pub mod theatre;
pub mod turned;

//! Contracts across crates: helpers of the integration tests.

pub mod digest;
pub mod enlarging;
pub mod extremes;
pub mod forward;
pub mod fuzz;
mod noise;
pub mod parity;
pub mod reference;
pub mod splats;
pub mod theatre;
pub mod turned;

use std::sync::LazyLock;

use streamsplat::stream::{DynamicGaussians, Workers};
use streamsplat_kernels::Level;

/// Threads for tests that do not vary levels and threads.
pub fn workers() -> &'static Workers {
    static WORKERS: LazyLock<Workers> = LazyLock::new(|| Workers::new(Level::detect(), 2).expect("threads start"));
    &WORKERS
}

/// Every bit of the Gaussians.
pub fn bits(gaussians: &DynamicGaussians) -> Vec<u8> {
    gaussians.columns().iter().flat_map(|column| column.numbers.to_bytes()).collect()
}

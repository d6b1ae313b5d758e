//! The program `streamsplat-experiments` from the outside.

mod reuse;
mod soak;

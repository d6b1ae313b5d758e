//! The program `streamsplat-bench` from the outside.

mod compare;
mod fit;
mod tradeoff;

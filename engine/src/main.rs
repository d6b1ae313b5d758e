//! The `streamsplat` program.
fn main() {}

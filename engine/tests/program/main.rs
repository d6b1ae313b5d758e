//! The `streamsplat` program as a user runs it: results, exit codes, messages.

mod errors;
mod results;
mod support;
mod verify;

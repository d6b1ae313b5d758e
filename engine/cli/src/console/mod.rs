//! The user's terminal: flags of every command, messages, failures, progress, stops, traces.

pub mod failure;
mod flags;
mod print;
pub mod progress;
pub mod stop;
pub mod trace;
pub mod version;

pub use flags::{Console, Observer};
pub use print::{print, say, visible};

//! The user's terminal: flags of every command, messages, failures, progress, the page of a run, stops, traces.

pub mod failure;
mod flags;
pub mod opening;
mod print;
pub mod progress;
pub mod screen;
pub mod serving;
pub mod stop;
pub mod trace;
pub mod version;

pub use flags::Console;
pub use print::{count, print, say, visible};

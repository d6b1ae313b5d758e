//! The `streamsplat` program as a user runs it: results, exit codes, messages.

mod container;
mod docs;
mod errors;
mod export;
#[cfg(unix)]
mod hostile;
#[cfg(unix)]
mod killed;
mod manual;
#[cfg(unix)]
mod places;
mod results;
mod resume;
mod still;
mod support;
mod trace;
mod track;
mod trust;
mod verify;
mod view;

//! Tests of the `streamsplat` program from the outside: results, exit codes, messages.

mod cameras;
mod compare;
mod container;
mod docs;
mod errors;
#[cfg(target_os = "linux")]
mod expanding;
mod export;
mod first_look;
mod formats;
mod golden;
#[cfg(unix)]
mod hostile;
mod images;
#[cfg(unix)]
mod killed;
mod manual;
mod optics;
#[cfg(unix)]
mod places;
mod results;
mod resume;
mod splats;
mod still;
mod still_example;
mod support;
mod trace;
mod track;
mod trust;
mod turn;
mod verify;
mod view;
mod wrong_files;

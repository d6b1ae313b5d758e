//! The command line, and the library's settings that it stands for.

pub mod antialias;
pub mod args;
pub mod machine;
pub mod motion;
pub mod optics;
pub mod settings;
pub mod times;

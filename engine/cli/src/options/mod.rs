//! The command line: arguments of every command. Options of `run` are the library's ([`streamsplat::run::options`]).

pub mod antialias;
pub mod args;
pub mod optics;
pub mod times;

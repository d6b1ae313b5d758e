//! The `streamsplat` program of the wheel: the whole command line inside Python.

use std::ffi::OsString;

use pyo3::prelude::*;

/// Runs the program with these arguments, the first of which is its name, and returns its exit code.
#[pyfunction]
pub fn main(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| streamsplat_cli::run(arguments))
}

/// Returns the commit that the wheel was built from, if known.
pub fn commit() -> Option<&'static str> {
    streamsplat_cli::commit()
}

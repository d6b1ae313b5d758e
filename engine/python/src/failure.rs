//! Errors of the library as Python exceptions.

use pyo3::PyErr;
use pyo3::exceptions::{PyException, PyMemoryError, PyOSError, PyValueError};
use streamsplat::RenderError;

pyo3::create_exception!(
    streamsplat_cpu,
    Error,
    PyException,
    "What the engine cannot do: a broken file, a frame it cannot take, a time outside the scene. The message says what was expected and what was found."
);

/// The work failed.
pub fn failed(error: impl std::fmt::Display) -> PyErr {
    Error::new_err(error.to_string())
}

/// An image could not be drawn.
pub fn not_drawn(error: RenderError) -> PyErr {
    match error {
        RenderError::Memory { .. } => PyMemoryError::new_err(error.to_string()),
        RenderError::Size { .. } => wrong(error),
        _ => failed(error),
    }
}

/// An argument is not what it can be.
pub fn wrong(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// A file could not be written or read.
pub fn system(error: impl std::fmt::Display) -> PyErr {
    PyOSError::new_err(error.to_string())
}

//! Errors of the library as Python exceptions.

use std::io;
use std::path::Path;

use pyo3::exceptions::{PyException, PyMemoryError, PyOSError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use streamsplat::RenderError;
use streamsplat::formats::cameras::CameraFileError;
use streamsplat::output::OutputError;
use streamsplat::scene::SceneError;
use streamsplat::source::SourceError;

pyo3::create_exception!(
    streamsplat_cpu,
    Error,
    PyException,
    "What the engine cannot do: a broken file, a frame it cannot take, a time outside the scene. The message contains what was expected and what was found."
);

/// Returns the exception of failed work.
pub fn failed(error: impl std::fmt::Display) -> PyErr {
    Error::new_err(error.to_string())
}

/// Returns the exception of an image that could not be drawn.
pub fn not_drawn(error: RenderError) -> PyErr {
    match error {
        RenderError::Memory { .. } => PyMemoryError::new_err(error.to_string()),
        RenderError::Size { .. }
        | RenderError::Camera
        | RenderError::NoOwnCamera
        | RenderError::NoOwnSize
        | RenderError::Aperture { .. } => wrong(error),
        _ => failed(error),
    }
}

/// Returns the exception of an invalid value of an argument.
pub fn wrong(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// Returns the exception of an argument of a type that is not supported.
pub fn mistyped(error: impl std::fmt::Display) -> PyErr {
    PyTypeError::new_err(error.to_string())
}

/// Returns the system's error for a file, as Python's own functions raise it: `FileNotFoundError`, `PermissionError`, …
pub fn system(path: &Path, cause: &io::Error) -> PyErr {
    let Some(code) = cause.raw_os_error() else {
        return PyOSError::new_err(format!("{}: {cause}", path.display()));
    };
    Python::attach(|py| {
        let text = py.import("os")?.call_method1("strerror", (code,))?;
        py.get_type::<PyOSError>().call1((code, text, path)).map(PyErr::from_value)
    })
    .unwrap_or_else(|error| error)
}

/// Returns an error if the file or folder is missing or cannot be accessed.
pub fn present(path: &Path) -> PyResult<()> {
    std::fs::metadata(path).map(drop).map_err(|cause| system(path, &cause))
}

/// Returns the exception of a result that could not be written.
pub fn not_written(error: OutputError) -> PyErr {
    match error {
        OutputError::Write { path, cause } => system(&path, &cause),
        error => failed(error),
    }
}

/// Returns the exception of a scene that could not be read or written.
pub fn not_opened(error: SceneError) -> PyErr {
    match error {
        SceneError::Write(error) => not_written(error),
        SceneError::Read { path, cause } if cause.kind() != io::ErrorKind::NotFound => system(&path, &cause),
        error => failed(error),
    }
}

/// Returns the exception of frames that could not be read.
pub fn not_read(error: SourceError) -> PyErr {
    match error {
        SourceError::Read { path, cause } => system(&path, &cause),
        SourceError::FrameRate(_) => wrong(error),
        error => failed(error),
    }
}

/// Returns the exception of cameras that could not be read.
pub fn no_cameras(error: CameraFileError) -> PyErr {
    match error {
        CameraFileError::Read { path, cause } => system(&path, &cause),
        error => wrong(error),
    }
}

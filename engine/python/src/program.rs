//! The command line inside Python.

use std::ffi::OsString;
use std::sync::{Arc, Mutex, PoisonError};

use pyo3::prelude::*;
use streamsplat_cli::{Failure, Observer};

use crate::failure::{failed, wrong};

/// Runs the program with these arguments, the first of which is its name, and gives its exit code.
#[pyfunction]
pub fn main(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| streamsplat_cli::run(arguments))
}

/// Runs `streamsplat run` with these arguments and gives the record in JSON. `progress(done, total)` is called as frames are done; an exception in it, or
/// Ctrl-C, ends the run after the interval at hand and is raised here.
#[pyfunction]
pub fn run(py: Python<'_>, arguments: Vec<OsString>, progress: Option<Py<PyAny>>) -> PyResult<String> {
    let raised: Arc<Mutex<Option<PyErr>>> = Arc::default();
    let keep = raised.clone();
    let observer: Observer = Arc::new(move |done, total| {
        let told = Python::attach(|py| {
            py.check_signals()?;
            progress.as_ref().map_or(Ok(()), |progress| progress.call1(py, (done, total)).map(drop))
        });
        let goes_on = told.is_ok();
        if let Err(error) = told {
            *keep.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
        }
        goes_on
    });
    let record = py.detach(|| streamsplat_cli::reconstruct(arguments, observer));
    if let Some(error) = raised.lock().unwrap_or_else(PoisonError::into_inner).take() {
        return Err(error);
    }
    record.map_err(|failure| match failure {
        Failure::Usage(_) => wrong(failure.message()),
        Failure::Work(_) | Failure::Stopped(_) => failed(failure.message()),
    })
}

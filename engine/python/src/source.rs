//! Videos as NumPy arrays.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use numpy::{IntoPyArray, PyArrayMethods};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use streamsplat::source::{Options, Source};

use crate::failure::{not_read, present};

/// The frames of a video: pairs (frame, time), frame float32 [height, width, 3] in [0, 1], time in seconds.
///
/// `input` is a folder of images, an image, a .y4m file, or any video if an ffmpeg program is installed. Decoding is
/// the same as by the command line.
#[pyclass(frozen, module = "streamsplat_cpu")]
pub struct Frames {
    path: PathBuf,
    source: Mutex<Source>,
    fps: f64,
    count: Option<usize>,
}

impl Frames {
    /// Returns the frames per second.
    pub fn rate(&self) -> f64 {
        self.fps
    }

    /// Returns the number of frames, if known.
    pub fn frames(&self) -> Option<usize> {
        self.count
    }
}

#[pymethods]
impl Frames {
    #[new]
    #[pyo3(signature = (input, *, fps=None))]
    fn new(py: Python<'_>, input: PathBuf, fps: Option<f64>) -> PyResult<Self> {
        // Inputs other than files have their own errors.
        if input != *"-" && !input.to_string_lossy().contains("://") {
            present(&input)?;
        }
        let source = py.detach(|| Source::open(&input, &Options { fps, ..Options::default() })).map_err(not_read)?;
        let (fps, count) = (source.fps(), source.frames());
        Ok(Self { path: input, source: Mutex::new(source), fps, count })
    }

    /// Frames per second.
    #[getter]
    fn fps(&self) -> f64 {
        self.fps
    }

    /// Number of frames, if it is known beforehand.
    #[getter]
    fn count(&self) -> Option<usize> {
        self.count
    }

    fn __len__(&self) -> PyResult<usize> {
        self.count.ok_or_else(|| {
            PyTypeError::new_err("len(): expected a video whose number of frames is known beforehand, found one whose is not (`count` is None)")
        })
    }

    fn __repr__(&self) -> String {
        let count = self.count.map_or_else(|| "frames".to_owned(), |count| format!("{count} frames"));
        format!("Frames({}: {count}, {:.3} a second)", self.path.display(), self.fps)
    }

    fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    fn __next__<'py>(&self, py: Python<'py>) -> PyResult<Option<(Bound<'py, PyAny>, f64)>> {
        let next = py.detach(|| self.source.lock().unwrap_or_else(PoisonError::into_inner).next_frame());
        let Some(frame) = next.map_err(not_read)? else { return Ok(None) };
        let planes = frame.picture.rgb.into_pyarray(py).reshape([3, frame.picture.height, frame.picture.width])?;
        Ok(Some((planes.call_method1("transpose", (1, 2, 0))?, frame.timestamp)))
    }
}

//! Images that were drawn.

use std::path::PathBuf;

use numpy::ndarray::{ArrayView2, ArrayView3};
use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use streamsplat::output::{picture_png, write_file};
use streamsplat::picture::Picture;

use crate::arrays::borrowed;
use crate::failure::{failed, system, wrong};

/// A drawn image. Its arrays are read-only and show the engine's own memory.
#[pyclass(frozen, module = "streamsplat")]
pub struct Image {
    picture: Picture,
    depth: Option<Vec<f32>>,
    alpha: Option<Vec<f32>>,
    #[pyo3(get)]
    /// Gaussians left out because a number of theirs was not finite.
    dropped: u64,
}

impl From<streamsplat::Image> for Image {
    fn from(image: streamsplat::Image) -> Self {
        let streamsplat::Image { width, height, rgb, depth, alpha, dropped, .. } = image;
        Self { picture: Picture { width, height, rgb }, depth, alpha, dropped }
    }
}

impl Image {
    fn plane<'py>(this: &Bound<'py, Self>, plane: Option<&Vec<f32>>) -> PyResult<Option<Bound<'py, PyArray2<f32>>>> {
        let Picture { width, height, .. } = this.get().picture;
        let Some(plane) = plane else { return Ok(None) };
        let view = ArrayView2::from_shape((height, width), plane).map_err(failed)?;
        // SAFETY: the plane belongs to the image, which is frozen: nothing moves or writes it while it lives.
        unsafe { borrowed(&view, this.clone().into_any()) }.map(Some)
    }
}

#[pymethods]
impl Image {
    /// Pixels per row.
    #[getter]
    fn width(&self) -> usize {
        self.picture.width
    }

    /// Rows.
    #[getter]
    fn height(&self) -> usize {
        self.picture.height
    }

    /// Display-space colour, float32 [height, width, 3]: a view of three planes.
    #[getter]
    fn rgb<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let Picture { width, height, rgb } = &this.get().picture;
        let view = ArrayView3::from_shape((3, *height, *width), rgb).map_err(failed)?.permuted_axes([1, 2, 0]);
        // SAFETY: the planes belong to the image, which is frozen: nothing moves or writes them while it lives.
        unsafe { borrowed(&view, this.clone().into_any()) }
    }

    /// Σ z α T, float32 [height, width]; None unless it was asked for.
    #[getter]
    fn depth<'py>(this: &Bound<'py, Self>) -> PyResult<Option<Bound<'py, PyArray2<f32>>>> {
        Self::plane(this, this.get().depth.as_ref())
    }

    /// Σ α T, float32 [height, width]; None unless it was asked for.
    #[getter]
    fn alpha<'py>(this: &Bound<'py, Self>) -> PyResult<Option<Bound<'py, PyArray2<f32>>>> {
        Self::plane(this, this.get().alpha.as_ref())
    }

    /// The image as an 8-bit PNG file, the same bytes as the command line writes.
    fn png<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        let bytes = py.detach(|| picture_png(&self.picture));
        PyBytes::new(py, &bytes)
    }

    /// Writes the PNG file: whole or not at all. The name ends in .png.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        if !path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("png")) {
            return Err(wrong(format!("path: expected a name ending in .png, found {}", path.display())));
        }
        py.detach(|| write_file(&path, &picture_png(&self.picture))).map(drop).map_err(system)
    }

    fn __repr__(&self) -> String {
        format!("Image(width={}, height={})", self.picture.width, self.picture.height)
    }
}

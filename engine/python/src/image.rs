//! Images that were drawn.

use std::path::PathBuf;

use numpy::ndarray::{ArrayView2, ArrayView3};
use numpy::{IntoPyArray, PyArray2, PyArray3, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use streamsplat::output::{picture_png, write_file};
use streamsplat::picture::{Picture, size_is_allowed};

use crate::arrays::borrowed;
use crate::failure::{failed, system, wrong};

/// Width, height, colour, depth, alpha and what was left out.
type Parts<'py> = (usize, usize, Bound<'py, PyBytes>, Option<Bound<'py, PyBytes>>, Option<Bound<'py, PyBytes>>, u64);

/// A drawn image. Its arrays are read-only and show the engine's own memory.
#[pyclass(frozen, module = "streamsplat_cpu")]
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

/// One image, or a list.
#[derive(IntoPyObject)]
pub enum Drawn {
    One(Image),
    Many(Vec<Image>),
}

impl Drawn {
    /// The first of the images, or all.
    pub fn of(mut images: Vec<Image>, many: bool) -> PyResult<Drawn> {
        match images.pop() {
            Some(image) if !many => Ok(Drawn::One(image)),
            Some(image) => {
                images.push(image);
                Ok(Drawn::Many(images))
            }
            None => Ok(Drawn::Many(images)),
        }
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

    /// Display-space colour, float32 [height, width, 3]: a read-only view of three planes; `.copy()` gives an array that can be written to.
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

    /// The PNG file, by which notebooks show the image.
    fn _repr_png_<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        self.png(py)
    }

    /// The samples of the PNG file, uint8 [height, width, 3]: a copy.
    fn rgb8<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let bytes = py.detach(|| self.picture.to_rgb8());
        let samples = bytes.into_pyarray(py).reshape([self.picture.height, self.picture.width, 3])?;
        Ok(samples.into_any())
    }

    /// NumPy's view of the image: `rgb8`, or `rgb` where floats are asked for. Only float32 without a copy shows the engine's memory.
    #[pyo3(signature = (dtype=None, copy=None))]
    fn __array__<'py>(
        this: &Bound<'py, Self>,
        dtype: Option<Bound<'py, PyAny>>,
        copy: Option<bool>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let py = this.py();
        let dtype = dtype.map(|dtype| py.import("numpy")?.call_method1("dtype", (dtype,))).transpose()?;
        let (kind, size) = match &dtype {
            Some(dtype) => (dtype.getattr("kind")?.extract::<char>()?, dtype.getattr("itemsize")?.extract::<usize>()?),
            None => ('u', 1),
        };
        if copy == Some(false) && (kind, size) != ('f', 4) {
            return Err(wrong(
                "copy: expected True or None, as only float32 shows the image without a copy, found False",
            ));
        }
        let array = if kind == 'f' { Self::rgb(this)?.into_any() } else { this.get().rgb8(py)? };
        let Some(dtype) = dtype else { return Ok(array) };
        let options = PyDict::new(py);
        options.set_item("copy", copy == Some(true))?;
        array.call_method("astype", (dtype,), Some(&options))
    }

    /// Writes the image: whole or not at all. `.png` is written here, other endings (.jpg, .webp, …) by Pillow.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        if ending == "png" {
            return py.detach(|| write_file(&path, &picture_png(&self.picture))).map(drop).map_err(system);
        }
        let found =
            || format!("path: expected a name ending in .png, or one that Pillow writes, found {}", path.display());
        let pillow = py.import("PIL.Image").map_err(|_| wrong(format!("{}; Pillow is not installed", found())))?;
        let endings = pillow.call_method0("registered_extensions")?;
        if ending.is_empty() || !endings.contains(format!(".{ending}"))? {
            return Err(wrong(found()));
        }
        let image = pillow.call_method1("fromarray", (self.rgb8(py)?,))?;
        let form = endings.get_item(format!(".{ending}"))?;
        let memory = py.import("io")?.call_method0("BytesIO")?;
        image.call_method1("save", (&memory, form)).map_err(|e| wrong(format!("{}: {e}", path.display())))?;
        let bytes: Vec<u8> = memory.call_method0("getvalue")?.extract()?;
        py.detach(|| write_file(&path, &bytes)).map(drop).map_err(system)
    }

    /// Parts of the image for pickling.
    fn __reduce__<'py>(this: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, Parts<'py>)> {
        let image = this.get();
        let bytes = |plane: &[f32]| PyBytes::new(this.py(), bytemuck::cast_slice(plane));
        let planes = [&image.depth, &image.alpha].map(|plane| plane.as_deref().map(bytes));
        let [depth, alpha] = planes;
        let Picture { width, height, rgb } = &image.picture;
        let make = this.get_type().getattr("_of_parts")?;
        Ok((make, (*width, *height, bytes(rgb), depth, alpha, image.dropped)))
    }

    /// The image of these parts.
    #[staticmethod]
    fn _of_parts(
        width: usize,
        height: usize,
        rgb: &[u8],
        depth: Option<&[u8]>,
        alpha: Option<&[u8]>,
        dropped: u64,
    ) -> PyResult<Self> {
        let pixels = width.checked_mul(height).filter(|_| size_is_allowed(width, height));
        let pixels = pixels.ok_or_else(|| wrong(format!("size: found {width}×{height}")))?;
        let plane = |name: &str, bytes: &[u8], count: usize| -> PyResult<Vec<f32>> {
            if bytes.len() != 4 * count {
                return Err(wrong(format!("{name}: expected {} bytes, found {}", 4 * count, bytes.len())));
            }
            Ok(bytes.as_chunks::<4>().0.iter().map(|b| f32::from_ne_bytes(*b)).collect())
        };
        Ok(Self {
            picture: Picture { width, height, rgb: plane("rgb", rgb, 3 * pixels)? },
            depth: depth.map(|bytes| plane("depth", bytes, pixels)).transpose()?,
            alpha: alpha.map(|bytes| plane("alpha", bytes, pixels)).transpose()?,
            dropped,
        })
    }

    fn __repr__(&self) -> String {
        format!("Image(width={}, height={})", self.picture.width, self.picture.height)
    }
}

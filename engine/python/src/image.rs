//! Drawn images.

use std::path::PathBuf;

use numpy::ndarray::{ArrayView2, ArrayView3};
use numpy::{IntoPyArray, PyArray2, PyArray3, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use streamsplat::output::{image_exr, picture_png, picture_webp, write_file};
use streamsplat::picture::{Picture, size_is_allowed};

use crate::arrays::borrowed;
use crate::failure::{failed, not_written, wrong};

/// Width, height, colour, depth, alpha and the number of Gaussians left out.
type Parts<'py> = (usize, usize, Bound<'py, PyBytes>, Option<Bound<'py, PyBytes>>, Option<Bound<'py, PyBytes>>, u64);

/// A drawn image. Its arrays are read-only and share the engine's own memory.
#[pyclass(frozen, module = "streamsplat_cpu")]
pub struct Image {
    picture: Picture,
    depth: Option<Vec<f32>>,
    alpha: Option<Vec<f32>>,
    #[pyo3(get)]
    /// Number of Gaussians left out because of values that are not finite.
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
    /// Returns the first of the images, or all.
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
    /// Returns the library's image.
    fn drawn(&self) -> streamsplat::Image {
        let Picture { width, height, ref rgb } = self.picture;
        streamsplat::Image {
            width,
            height,
            rgb: rgb.clone(),
            depth: self.depth.clone(),
            alpha: self.alpha.clone(),
            final_t: None,
            blended: None,
            dropped: self.dropped,
        }
    }

    fn plane<'py>(this: &Bound<'py, Self>, plane: Option<&Vec<f32>>) -> PyResult<Option<Bound<'py, PyArray2<f32>>>> {
        let Picture { width, height, .. } = this.get().picture;
        let Some(plane) = plane else { return Ok(None) };
        let view = ArrayView2::from_shape((height, width), plane).map_err(failed)?;
        // SAFETY: the plane belongs to the image, which is frozen: it is neither moved nor written while it lives.
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

    /// Display-space colour, float32 [height, width, 3]: a read-only view of three planes; `.copy()` returns a writable
    /// array.
    #[getter]
    fn rgb<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let Picture { width, height, rgb } = &this.get().picture;
        let view = ArrayView3::from_shape((3, *height, *width), rgb).map_err(failed)?.permuted_axes([1, 2, 0]);
        // SAFETY: the planes belong to the image, which is frozen: they are neither moved nor written while it lives.
        unsafe { borrowed(&view, this.clone().into_any()) }
    }

    /// Σ z α T, float32 [height, width]; None unless requested.
    #[getter]
    fn depth<'py>(this: &Bound<'py, Self>) -> PyResult<Option<Bound<'py, PyArray2<f32>>>> {
        Self::plane(this, this.get().depth.as_ref())
    }

    /// Σ α T, float32 [height, width]; None unless requested.
    #[getter]
    fn alpha<'py>(this: &Bound<'py, Self>) -> PyResult<Option<Bound<'py, PyArray2<f32>>>> {
        Self::plane(this, this.get().alpha.as_ref())
    }

    /// Returns the image as an 8-bit PNG file, the same bytes as the command line writes.
    fn png<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        let bytes = py.detach(|| picture_png(&self.picture));
        PyBytes::new(py, &bytes)
    }

    /// Returns the PNG file, for notebooks.
    fn _repr_png_<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        self.png(py)
    }

    /// Returns the samples of the PNG file, uint8 [height, width, 3]: a copy.
    fn rgb8<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let bytes = py.detach(|| self.picture.to_rgb8());
        let samples = bytes.into_pyarray(py).reshape([self.picture.height, self.picture.width, 3])?;
        Ok(samples.into_any())
    }

    /// The samples of the PNG file, for NumPy and Pillow: uint8 [height, width, 3], a new copy each time.
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let samples = self.rgb8(py)?;
        let interface = PyDict::new(py);
        interface.set_item("shape", (self.picture.height, self.picture.width, 3))?;
        interface.set_item("typestr", "|u1")?;
        // Set explicitly, so that Pillow uses `tobytes`.
        interface.set_item("strides", (3 * self.picture.width, 3, 1))?;
        interface.set_item("data", samples)?;
        interface.set_item("version", 3)?;
        Ok(interface)
    }

    /// Number of rows, as of its array.
    fn __len__(&self) -> usize {
        self.picture.height
    }

    /// Returns the bytes of `rgb8`, row by row.
    fn tobytes<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        let bytes = py.detach(|| self.picture.to_rgb8());
        PyBytes::new(py, &bytes)
    }

    /// Writes the image, completely or not at all. `.png`, `.webp` (both lossless) and `.exr` (32-bit floats, with
    /// depth and alpha if the image has them) are written here, other endings (.jpg, .tif, …) by Pillow.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        let own = py.detach(|| match ending.as_str() {
            "png" => Ok(Some(picture_png(&self.picture))),
            "webp" => picture_webp(&self.picture, None).map(Some),
            "exr" => image_exr(&self.drawn()).map(Some),
            _ => Ok(None),
        });
        if let Some(bytes) = own.map_err(wrong)? {
            return py.detach(|| write_file(&path, &bytes)).map(drop).map_err(not_written);
        }
        let found = || {
            let expected = "a name ending in .png, .webp or .exr, or one that Pillow writes";
            format!("path: expected {expected}, found {}", path.display())
        };
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
        py.detach(|| write_file(&path, &bytes)).map(drop).map_err(not_written)
    }

    /// Returns the parts of the image for pickling.
    fn __reduce__<'py>(this: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, Parts<'py>)> {
        let image = this.get();
        let bytes = |plane: &[f32]| PyBytes::new(this.py(), bytemuck::cast_slice(plane));
        let planes = [&image.depth, &image.alpha].map(|plane| plane.as_deref().map(bytes));
        let [depth, alpha] = planes;
        let Picture { width, height, rgb } = &image.picture;
        let make = this.get_type().getattr("_of_parts")?;
        Ok((make, (*width, *height, bytes(rgb), depth, alpha, image.dropped)))
    }

    /// Returns the image of these parts.
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
        let Picture { width, height, .. } = self.picture;
        let planes = [("depth", self.depth.is_some()), ("alpha", self.alpha.is_some())];
        let planes: String = planes.iter().filter(|(_, has)| *has).map(|(name, _)| format!(", {name}")).collect();
        format!("Image({width}×{height}, rgb{planes})")
    }
}

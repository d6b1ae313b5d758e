//! Intervals and their Gaussians.

use std::path::PathBuf;
use std::sync::OnceLock;

use numpy::PyArray1;
use numpy::ndarray::{ArrayView1, ArrayView2};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use streamsplat::fit::Placement;
use streamsplat::formats::Options;
use streamsplat::output::{picture_png, write_file};
use streamsplat::picture::Picture;
use streamsplat::render::Renderer;
use streamsplat::scene::{from_safetensors, to_safetensors};
use streamsplat::still::Still;
use streamsplat::stream::{DynamicGaussians, Numbers, Snapshot, Value, Workers};
use streamsplat_kernels::Level;

use crate::arguments::{self, Place};
use crate::arrays::borrowed;
use crate::failure::{failed, not_drawn, not_written};
use crate::image::{Drawn, Image};
use crate::splats::{Splats, format_of, warn};

/// The scene from one key frame to the next. It does not change and is independent of the engine that made it.
#[pyclass(frozen, module = "streamsplat_cpu")]
pub struct Interval {
    pub inner: streamsplat::Interval,
    /// Threads that draw it: those of its engine or scene. A copy has its own from its first image on.
    workers: OnceLock<Workers>,
}

impl Interval {
    /// Returns an interval that `workers` draw.
    pub fn new(inner: streamsplat::Interval, workers: &Workers) -> Self {
        Self { inner, workers: OnceLock::from(workers.clone()) }
    }

    fn workers(&self) -> PyResult<&Workers> {
        if let Some(workers) = self.workers.get() {
            return Ok(workers);
        }
        let workers = Workers::new(Level::detect(), 0).map_err(failed)?;
        Ok(self.workers.get_or_init(|| workers))
    }

    /// Draws a PNG of the interval's middle, in the source's own view.
    pub fn picture<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let streamsplat::Interval { start, end, .. } = self.inner;
        let (workers, options) = (self.workers()?, streamsplat::RenderOptions::default());
        let middle = 0.5 * start + 0.5 * end;
        let image = py.detach(|| self.inner.render(middle, &streamsplat::Camera::Canonical, &options, workers));
        let streamsplat::Image { width, height, rgb, .. } = image.map_err(not_drawn)?;
        Ok(PyBytes::new(py, &picture_png(&Picture { width, height, rgb })))
    }
}

#[pymethods]
impl Interval {
    /// The key frame at its end, from 0.
    #[getter]
    fn index(&self) -> u64 {
        self.inner.index
    }

    /// Time of the key frame at its start, in seconds.
    #[getter]
    fn start(&self) -> f64 {
        self.inner.start
    }

    /// Time of the key frame at its end, in seconds; equal to `start` for the first frame's static scene.
    #[getter]
    fn end(&self) -> f64 {
        self.inner.end
    }

    /// Number of Gaussians left out because of values that are not finite.
    #[getter]
    fn dropped(&self) -> u64 {
        self.inner.dropped
    }

    /// Identities that ended in others: pairs (identity, the one that replaces it).
    #[getter]
    fn merges(&self) -> Vec<(u64, u64)> {
        self.inner.merges.iter().map(|m| (m.identity, m.into)).collect()
    }

    /// Its Gaussians.
    #[getter]
    fn gaussians(this: Bound<'_, Self>) -> Gaussians {
        Gaussians { interval: this.unbind() }
    }

    fn __len__(&self) -> usize {
        self.inner.gaussians.len()
    }

    fn __repr__(&self) -> String {
        let streamsplat::Interval { index, start, end, gaussians, .. } = &self.inner;
        format!("Interval({index}: {start:.3} s to {end:.3} s, {} Gaussians)", gaussians.len())
    }

    /// Writes the Gaussians at `time`, by default the interval's end, as a still scene, in the format by the name's
    /// ending: `.ply`, `.compressed.ply`, `.spz`, `.sog`, `.glb` or `.splat`.
    #[pyo3(signature = (path, time=None))]
    fn save(&self, py: Python<'_>, path: PathBuf, time: Option<f64>) -> PyResult<()> {
        let format = format_of(&path)?;
        let notes = py.detach(|| {
            let time = time.unwrap_or(self.inner.end);
            let snapshot = Snapshot::square(&self.inner, time, self.workers()?).map_err(failed)?;
            let written = (format.snapshot)(&snapshot, &Options::default());
            write_file(&path, &written.bytes).map_err(not_written)?;
            PyResult::Ok(written.notes)
        })?;
        warn(py, &notes)
    }

    /// Returns the Gaussians at `time`, by default the interval's end, in the world: the values in the file that `save`
    /// writes.
    #[pyo3(signature = (time=None))]
    pub fn at(&self, py: Python<'_>, time: Option<f64>) -> PyResult<Splats> {
        let workers = self.workers()?;
        let (still, identities) = py.detach(|| {
            let snapshot = Snapshot::square(&self.inner, time.unwrap_or(self.inner.end), workers).map_err(failed)?;
            let identity = |i: &u32| self.inner.gaussians.identity[*i as usize];
            PyResult::Ok((Still::of(&snapshot), snapshot.index.iter().map(identity).collect()))
        })?;
        Splats::new(still, Some(identities), workers)
    }

    /// Returns a PNG of the interval's middle, for notebooks.
    fn _repr_png_<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        self.picture(py)
    }

    /// Returns the parts of the interval for pickling.
    fn __reduce__<'py>(
        this: &Bound<'py, Self>,
    ) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>, [[usize; 2]; 4]))> {
        let interval = &this.get().inner;
        let bytes = this.py().detach(|| to_safetensors(interval)).map_err(failed)?;
        let Placement { source, model, offset, content } = interval.placement;
        let make = this.get_type().getattr("_of_parts")?;
        Ok((make, (PyBytes::new(this.py(), &bytes), [source, model, offset, content])))
    }

    /// Returns the interval of these parts.
    #[staticmethod]
    fn _of_parts(py: Python<'_>, bytes: &[u8], placement: [[usize; 2]; 4]) -> PyResult<Self> {
        let [source, model, offset, content] = placement;
        let placement = Placement { source, model, offset, content };
        let inner = py.detach(|| from_safetensors(bytes, placement)).map_err(failed)?;
        Ok(Self { inner, workers: OnceLock::new() })
    }

    /// Draws the scene at `time` seconds: an image, or a list of images if `time` or `camera` is a list.
    ///
    /// `camera` is None (the source's own view), a Camera, a dictionary in the JSON form of cameras, or the path of a
    /// file with one. `size` is 'model' (the default, if the camera has none), 'source', 'WIDTHxHEIGHT' or (width,
    /// height). `background` is a grey or a colour in [0, 1].
    #[pyo3(signature = (time, camera=None, *, size=None, background=None, depth=false, alpha=false, antialias=false))]
    pub fn render(
        &self,
        py: Python<'_>,
        time: &Bound<'_, PyAny>,
        camera: Option<&Bound<'_, PyAny>>,
        size: Option<&Bound<'_, PyAny>>,
        background: Option<&Bound<'_, PyAny>>,
        depth: bool,
        alpha: bool,
        antialias: bool,
    ) -> PyResult<Drawn> {
        let (places, many) = arguments::places(time, camera)?;
        let options = arguments::options(size, background, depth, alpha)?;
        let options = streamsplat::RenderOptions { antialias, ..options };
        let given = size.is_some();
        let images = py.detach(|| {
            let mut renderer = Renderer::new(self.workers()?);
            let mut draw = |place: &Place| {
                let options = place.options(&options, given);
                let image = renderer.render(&self.inner, place.time, &place.camera, &options).map_err(not_drawn)?;
                Ok(Image::from(image.clone()))
            };
            places.iter().map(&mut draw).collect::<PyResult<Vec<_>>>()
        })?;
        Drawn::of(images, many)
    }

    /// Returns the most visible Gaussian at a pixel (column, row) of the source's frame: (identity, index, weight,
    /// world position), or None if nothing is drawn there.
    fn pick(&self, py: Python<'_>, time: f64, pixel: [f64; 2]) -> PyResult<Option<(u64, usize, f64, [f32; 3])>> {
        let picked = py.detach(|| self.inner.pick(time, pixel, self.workers()?).map_err(failed))?;
        Ok(picked.map(|p| (p.identity, p.index, p.weight, p.position)))
    }
}

/// The Gaussians of an interval, one read-only array per property, in drawing order. The arrays share the interval's
/// own memory.
#[pyclass(frozen, module = "streamsplat_cpu")]
pub struct Gaussians {
    interval: Py<Interval>,
}

impl Gaussians {
    fn records(&self) -> &DynamicGaussians {
        &self.interval.get().inner.gaussians
    }

    /// Shows the values of a property of the interval.
    fn array<'py, T: Value>(&self, py: Python<'py>, values: &[T]) -> PyResult<Bound<'py, PyAny>> {
        let owner = self.interval.bind(py).clone().into_any();
        let rows = |numbers| ArrayView2::from_shape((values.len(), T::WIDTH), numbers).map_err(failed);
        // SAFETY: the numbers belong to the interval, which is frozen: they are neither moved nor written while it
        // lives.
        unsafe {
            Ok(match T::numbers(values) {
                Numbers::Floats(numbers) if T::WIDTH == 1 => borrowed(&ArrayView1::from(numbers), owner)?.into_any(),
                Numbers::Floats(numbers) => borrowed(&rows(numbers)?, owner)?.into_any(),
                Numbers::Words(numbers) => borrowed(&ArrayView1::from(numbers), owner)?.into_any(),
                Numbers::Codes(numbers) => PyArray1::from_vec(py, numbers).into_any(),
            })
        }
    }
}

/// Kind and shape of the array of a property.
macro_rules! shape {
    ([f32; $width:literal]) => {
        concat!("float32 [N, ", $width, "].")
    };
    (f32) => {
        "float32 [N]."
    };
    (u64) => {
        "uint64 [N]."
    };
    ($Choice:ident) => {
        "uint8 [N]: a copy."
    };
}

/// Defines getters that show one array each.
macro_rules! arrays {
    ($($(#[doc = $meaning:literal])+ $name:ident: $Type:tt $(= $default:expr)?;)+) => {
        #[pymethods]
        impl Gaussians {
            fn __len__(&self) -> usize {
                self.records().len()
            }

            fn __repr__(&self) -> String {
                let index = self.interval.get().inner.index;
                format!("Gaussians({} of interval {index}: arrays mean, velocity, opacity, scale, rgb, identity, …)", self.__len__())
            }

            $($(#[doc = $meaning])+
            #[doc = ""]
            #[doc = shape!($Type)]
            #[getter]
            fn $name<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
                self.array(py, &self.records().$name)
            })+
        }
    };
}

streamsplat::gaussian_properties!(arrays);

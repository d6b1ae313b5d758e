//! Intervals and their Gaussians.

use std::path::PathBuf;
use std::sync::OnceLock;

use numpy::ndarray::{ArrayView1, ArrayView2};
use numpy::{Element, PyArray1, PyArray2};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use streamsplat::fit::Placement;
use streamsplat::formats::Options;
use streamsplat::output::{picture_png, write_file};
use streamsplat::picture::Picture;
use streamsplat::render::Renderer;
use streamsplat::scene::{from_safetensors, to_safetensors};
use streamsplat::still::Still;
use streamsplat::stream::Snapshot;
use streamsplat::stream::{DynamicGaussians, Workers};
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

    fn column<'py, T: Element>(&self, py: Python<'py>, values: &[T]) -> PyResult<Bound<'py, PyArray1<T>>> {
        // SAFETY: `values` belongs to the interval, which is frozen: they are neither moved nor written while it lives.
        unsafe { borrowed(&ArrayView1::from(values), self.interval.bind(py).clone().into_any()) }
    }

    fn table<'py, T: Element, const K: usize>(
        &self,
        py: Python<'py>,
        values: &[[T; K]],
    ) -> PyResult<Bound<'py, PyArray2<T>>> {
        // SAFETY: as in `column`.
        unsafe { borrowed(&ArrayView2::from(values), self.interval.bind(py).clone().into_any()) }
    }
}

/// Defines getters that show one array each.
macro_rules! arrays {
    ($($(#[doc = $doc:literal])+ $name:ident: $how:ident -> $kind:ty;)+) => {
        #[pymethods]
        impl Gaussians {
            fn __len__(&self) -> usize {
                self.records().len()
            }

            fn __repr__(&self) -> String {
                let index = self.interval.get().inner.index;
                format!("Gaussians({} of interval {index}: arrays mean, velocity, opacity, scale, rgb, identity, …)", self.__len__())
            }

            /// The end of the interval that `mean`, `opacity` and `rgb` belong to, uint8 [N]: 0 its start, 1 its end. A
            /// copy.
            #[getter]
            fn reference<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u8>> {
                PyArray1::from_iter(py, self.records().reference.iter().map(|&r| r as u8))
            }

            /// uint8 [N]: 0 stays, 1 fades in after the start, 2 fades out before the end. A copy.
            #[getter]
            fn handover<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u8>> {
                PyArray1::from_iter(py, self.records().handover.iter().map(|&h| h as u8))
            }

            $($(#[doc = $doc])+
            #[getter]
            fn $name<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, $kind>> {
                self.$how(py, &self.records().$name)
            })+
        }
    };
}

arrays! {
    /// Position at the reference time, float32 [N, 3]: x right, y normalised inverse depth, z up.
    mean: table -> PyArray2<f32>;
    /// World units per interval, float32 [N, 3].
    velocity: table -> PyArray2<f32>;
    /// The opacity's window in time, float32 [N, 2].
    gamma: table -> PyArray2<f32>;
    /// Opacity at the reference time, float32 [N].
    opacity: column -> PyArray1<f32>;
    /// Standard deviations along x and z, float32 [N, 2].
    scale: table -> PyArray2<f32>;
    /// Standard deviation along y, in scene space, over the mean of the two, float32 [N].
    thickness: column -> PyArray1<f32>;
    /// Display-space colour at the reference time, float32 [N, 3].
    rgb: table -> PyArray2<f32>;
    /// Change of colour per interval, float32 [N, 3].
    rgb_rate: table -> PyArray2<f32>;
    /// Identity, uint64 [N]: never reused within a stream.
    identity: column -> PyArray1<u64>;
    /// The key frame in which the identity first appeared, uint64 [N].
    birth: column -> PyArray1<u64>;
    /// The key frame that reconstructed the record, uint64 [N].
    frame: column -> PyArray1<u64>;
    /// Vector from `mean` to the identity's tracked point, float32 [N, 3].
    offset: table -> PyArray2<f32>;
}

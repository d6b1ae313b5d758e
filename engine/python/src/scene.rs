//! Scenes on disk.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use streamsplat::camera::Camera;
use streamsplat::render::Renderer;
use streamsplat::scene;
use streamsplat::stream::Workers;
use streamsplat_kernels::Level;

use crate::arguments;
use crate::failure::{failed, not_drawn, system, wrong};
use crate::image::{Drawn, Image};
use crate::interval::Interval;

/// A scene that the command line or a SceneWriter wrote. Its intervals are read when they are asked for.
#[pyclass(frozen, module = "streamsplat_cpu")]
pub struct Scene {
    inner: scene::Scene,
    workers: Workers,
}

impl Scene {
    fn interval(&self, py: Python<'_>, place: usize) -> PyResult<Interval> {
        let inner = py.detach(|| self.inner.interval(place)).map_err(failed)?;
        Ok(Interval::new(inner, &self.workers))
    }
}

#[pymethods]
impl Scene {
    #[new]
    #[pyo3(signature = (path, *, isa="auto", threads=0))]
    fn new(py: Python<'_>, path: PathBuf, isa: &str, threads: usize) -> PyResult<Self> {
        let level = Level::named(isa).map_err(|e| wrong(format!("isa: {e}")))?;
        let inner = py.detach(|| scene::Scene::open(&path)).map_err(failed)?;
        Ok(Self { inner, workers: Workers::new(level, threads).map_err(failed)? })
    }

    /// Frames per second of the source.
    #[getter]
    fn fps(&self) -> f64 {
        self.inner.index().fps
    }

    /// First and last time in seconds.
    #[getter]
    fn span(&self) -> (f64, f64) {
        self.inner.span()
    }

    /// Start and end of each interval in seconds.
    #[getter]
    fn times(&self) -> Vec<(f64, f64)> {
        self.inner.index().intervals.iter().map(|i| (i.start, i.end)).collect()
    }

    fn __len__(&self) -> usize {
        self.inner.index().intervals.len()
    }

    /// Interval `i`, read from its file and checked against its digest.
    fn __getitem__(&self, py: Python<'_>, i: isize) -> PyResult<Interval> {
        let count = self.__len__();
        let place = if i < 0 { i.checked_add_unsigned(count) } else { Some(i) };
        let Some(place) = place.and_then(|i| usize::try_from(i).ok()).filter(|i| *i < count) else {
            return Err(PyIndexError::new_err(format!("interval {i}: the scene has {count}")));
        };
        self.interval(py, place)
    }

    /// The interval that shows `time`.
    fn at(&self, py: Python<'_>, time: f64) -> PyResult<Interval> {
        let place = self.inner.find(time).map_err(failed)?;
        self.interval(py, place)
    }

    /// The scene at `time` seconds; arguments as Interval.render.
    #[pyo3(signature = (time, camera=None, *, size=None, background=None, depth=false, alpha=false))]
    fn render(
        &self,
        py: Python<'_>,
        time: &Bound<'_, PyAny>,
        camera: Option<&Bound<'_, PyAny>>,
        size: Option<&Bound<'_, PyAny>>,
        background: Option<&Bound<'_, PyAny>>,
        depth: bool,
        alpha: bool,
    ) -> PyResult<Drawn> {
        let (places, many) = arguments::places(time, camera)?;
        let options = arguments::options(size, background, depth, alpha)?;
        let images = py.detach(|| {
            let mut current: Option<(usize, streamsplat::Interval)> = None;
            let mut renderer = Renderer::new(&self.workers);
            let draw = |(time, camera): &(f64, Camera)| {
                let place = self.inner.find(*time).map_err(failed)?;
                let interval = match current.take().filter(|(at, _)| *at == place) {
                    Some((_, interval)) => interval,
                    None => self.inner.interval(place).map_err(failed)?,
                };
                let image = renderer.render(&interval, *time, camera, &options).map_err(not_drawn);
                let image = image.map(|image| Image::from(image.clone()));
                current = Some((place, interval));
                image
            };
            places.iter().map(draw).collect::<PyResult<Vec<_>>>()
        })?;
        Drawn::of(images, many)
    }
}

/// Writes a scene while it grows; a context manager. What is on disk is a valid scene at any moment.
#[pyclass(frozen, module = "streamsplat_cpu")]
pub struct SceneWriter {
    inner: Mutex<Option<scene::SceneWriter>>,
}

#[pymethods]
impl SceneWriter {
    #[new]
    fn new(path: PathBuf, fps: f64) -> PyResult<Self> {
        if !(fps.is_finite() && fps > 0.0) {
            return Err(wrong(format!("fps: expected a number above 0, found {fps}")));
        }
        Ok(Self { inner: Mutex::new(Some(scene::SceneWriter::create(&path, fps).map_err(system)?)) })
    }

    /// Writes the next interval.
    fn push(&self, py: Python<'_>, interval: &Interval) -> PyResult<()> {
        py.detach(|| match &mut *self.inner.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(writer) => writer.push(&interval.inner).map(drop).map_err(failed),
            None => Err(failed("the scene is finished")),
        })
    }

    /// Writes the index of all intervals.
    fn finish(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| match self.inner.lock().unwrap_or_else(PoisonError::into_inner).take() {
            Some(writer) => writer.finish().map(drop).map_err(failed),
            None => Ok(()),
        })
    }

    fn __enter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    #[pyo3(signature = (*_exception))]
    fn __exit__(&self, py: Python<'_>, _exception: &Bound<'_, pyo3::types::PyTuple>) -> PyResult<bool> {
        self.finish(py)?;
        Ok(false)
    }
}

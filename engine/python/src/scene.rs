//! Scenes: in time, and still ones.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use pyo3::IntoPyObjectExt;
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PySlice};
use streamsplat::Size;
use streamsplat::formats::Limits;
use streamsplat::formats::spacetime::Spacetime;
use streamsplat::open::{self, Opened, StillFile};
use streamsplat::render::Renderer;
use streamsplat::scene;
use streamsplat::stream::Workers;
use streamsplat_kernels::Level;

use crate::arguments::{self, Place};
use crate::failure::{failed, mistyped, not_drawn, not_opened, not_written, present, wrong};
use crate::image::{Drawn, Image};
use crate::interval::Interval;
use crate::splats::{Splats, warn};
use crate::view::Viewer;

/// A scene on disk. A scene in time is one that the command line or a SceneWriter wrote; its intervals are read when
/// needed. A still scene is a splat file in any supported format (docs/formats.md), which is read as a whole.
#[pyclass(frozen, module = "streamsplat_cpu")]
pub struct Scene {
    path: PathBuf,
    kind: Kind,
    workers: Workers,
}

enum Kind {
    Moving(scene::Scene),
    /// A still scene, with the name of its format, and its Gaussians over time if they change.
    Still {
        splats: Py<Splats>,
        format: &'static str,
        in_time: Option<Spacetime>,
    },
}

impl Scene {
    fn read(&self, py: Python<'_>, scene: &scene::Scene, place: usize) -> PyResult<Interval> {
        let inner = py.detach(|| scene.interval(place)).map_err(not_opened)?;
        Ok(Interval::new(inner, &self.workers))
    }

    /// Returns the scene in time.
    fn moving(&self) -> PyResult<&scene::Scene> {
        match &self.kind {
            Kind::Moving(scene) => Ok(scene),
            Kind::Still { format, .. } => Err(mistyped(format!(
                "{}: expected a scene in time, found a still one ({format}): at() and render(camera) take no time",
                self.path.display()
            ))),
        }
    }

    /// Returns the Gaussians of a still scene at a time.
    fn still_at<'py>(
        &self,
        py: Python<'py>,
        time: f64,
        splats: &Py<Splats>,
        in_time: Option<&Spacetime>,
    ) -> PyResult<Bound<'py, Splats>> {
        match in_time {
            Some(scene) if time != 0.0 => {
                let still = py.detach(|| scene.at(time));
                Bound::new(py, Splats::new(still, None, &self.workers)?)
            }
            _ => Ok(splats.bind(py).clone()),
        }
    }

    /// Draws images of a scene in time.
    fn draw(
        &self,
        py: Python<'_>,
        scene: &scene::Scene,
        places: &[Place],
        options: &streamsplat::RenderOptions,
        given: bool,
    ) -> PyResult<Vec<Image>> {
        py.detach(|| {
            let mut current: Option<(usize, streamsplat::Interval)> = None;
            let mut renderer = Renderer::new(&self.workers);
            let draw = |seen: &Place| {
                let place = scene.find(seen.time).map_err(failed)?;
                let interval = match current.take().filter(|(at, _)| *at == place) {
                    Some((_, interval)) => interval,
                    None => scene.interval(place).map_err(not_opened)?,
                };
                let options = seen.options(options, given);
                let image = renderer.render(&interval, seen.time, &seen.camera, &options).map_err(not_drawn);
                let image = image.map(|image| Image::from(image.clone()));
                current = Some((place, interval));
                image
            };
            places.iter().map(draw).collect::<PyResult<Vec<_>>>()
        })
    }
}

#[pymethods]
impl Scene {
    #[new]
    #[pyo3(signature = (path, *, isa="auto", threads=0))]
    fn new(py: Python<'_>, path: PathBuf, isa: &str, threads: usize) -> PyResult<Self> {
        let level = Level::named(isa).map_err(|e| wrong(format!("isa: {e}")))?;
        present(&path)?;
        let workers = Workers::new(level, threads).map_err(failed)?;
        let opened = py.detach(|| workers.install(|| open::scene(&path, &Limits::default()))).map_err(not_opened)?;
        let kind = match opened {
            Opened::Moving(scene) => Kind::Moving(scene),
            Opened::Still(StillFile { still, in_time, format, notes, .. }) => {
                warn(py, &[notes, still.about.lines()].concat())?;
                Kind::Still { splats: Py::new(py, Splats::new(still, None, &workers)?)?, format, in_time }
            }
        };
        Ok(Self { path, kind, workers })
    }

    /// True for a still scene, which has no times.
    #[getter]
    fn is_still(&self) -> bool {
        matches!(self.kind, Kind::Still { .. })
    }

    /// Frames per second of the source.
    #[getter]
    fn fps(&self) -> PyResult<f64> {
        Ok(self.moving()?.index().fps)
    }

    /// First and last time in seconds.
    #[getter]
    fn span(&self) -> PyResult<(f64, f64)> {
        Ok(self.moving()?.span())
    }

    /// Start and end of each interval in seconds; empty for a still scene.
    #[getter]
    fn times(&self) -> Vec<(f64, f64)> {
        match &self.kind {
            Kind::Moving(scene) => scene.index().intervals.iter().map(|i| (i.start, i.end)).collect(),
            Kind::Still { .. } => Vec::new(),
        }
    }

    /// Number of intervals; 0 for a still scene.
    fn __len__(&self) -> usize {
        match &self.kind {
            Kind::Moving(scene) => scene.index().intervals.len(),
            Kind::Still { .. } => 0,
        }
    }

    fn __bool__(&self) -> bool {
        true
    }

    /// Returns interval `i`, read from its file and checked against its digest; a list of intervals for a slice.
    fn __getitem__<'py>(&self, py: Python<'py>, i: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let scene = self.moving()?;
        let count = self.__len__();
        if let Ok(slice) = i.cast::<PySlice>() {
            let of = slice.indices(isize::try_from(count).unwrap_or(isize::MAX))?;
            let places = (0..of.slicelength as isize).map(|k| (of.start + k * of.step) as usize);
            let intervals: Vec<Interval> = places.map(|place| self.read(py, scene, place)).collect::<PyResult<_>>()?;
            return intervals.into_bound_py_any(py);
        }
        let i: isize = i.extract().map_err(|_| mistyped(format!("index: expected a number or a slice, found {i}")))?;
        let place = if i < 0 { i.checked_add_unsigned(count) } else { Some(i) };
        let Some(place) = place.and_then(|i| usize::try_from(i).ok()).filter(|i| *i < count) else {
            return Err(PyIndexError::new_err(format!("interval {i}: the scene has {count}")));
        };
        self.read(py, scene, place)?.into_bound_py_any(py)
    }

    /// Returns the interval that shows `time`.
    fn interval(&self, py: Python<'_>, time: f64) -> PyResult<Interval> {
        let scene = self.moving()?;
        let place = scene.find(time).map_err(failed)?;
        self.read(py, scene, place)
    }

    /// Returns the Gaussians at `time` seconds, in the world; for a still scene, without a time.
    #[pyo3(signature = (time=None))]
    fn at<'py>(&self, py: Python<'py>, time: Option<f64>) -> PyResult<Bound<'py, Splats>> {
        match (&self.kind, time) {
            (Kind::Still { splats, in_time, .. }, time) => {
                self.still_at(py, time.unwrap_or(0.0), splats, in_time.as_ref())
            }
            (Kind::Moving(scene), Some(time)) => {
                let place = scene.find(time).map_err(failed)?;
                Bound::new(py, self.read(py, scene, place)?.at(py, Some(time))?)
            }
            (Kind::Moving(scene), None) => {
                let (start, end) = scene.span();
                Err(mistyped(format!(
                    "time: expected seconds from {start} to {end}, found none: the scene changes in time"
                )))
            }
        }
    }

    /// Draws an image, or a list of images if `time` or `camera` is a list.
    ///
    /// A scene in time has `render(time, camera)`, as in Interval.render; a still scene has `render(camera)`, as in
    /// Splats.render.
    #[pyo3(signature = (time=None, camera=None, *, size=None, background=None, depth=false, alpha=false, antialias=None))]
    fn render(
        &self,
        py: Python<'_>,
        time: Option<&Bound<'_, PyAny>>,
        camera: Option<&Bound<'_, PyAny>>,
        size: Option<&Bound<'_, PyAny>>,
        background: Option<&Bound<'_, PyAny>>,
        depth: bool,
        alpha: bool,
        antialias: Option<bool>,
    ) -> PyResult<Drawn> {
        let mut options = arguments::options(size, background, depth, alpha)?;
        match &self.kind {
            Kind::Moving(scene) => {
                let Some(time) = time.filter(|time| !arguments::is_camera(time)) else {
                    let (start, end) = scene.span();
                    let expected = format!("time: expected seconds from {start} to {end}, or a list of them");
                    return Err(mistyped(format!("{expected}, found none: the scene changes in time")));
                };
                options.antialias = antialias.unwrap_or(false);
                let (places, many) = arguments::places(time, camera)?;
                Drawn::of(self.draw(py, scene, &places, &options, size.is_some())?, many)
            }
            Kind::Still { splats, in_time, .. } => {
                if matches!(options.size, Size::Source) {
                    return Err(wrong("size: expected WIDTHxHEIGHT, found source: a still scene has none"));
                }
                let (time, camera) = match (time, camera) {
                    (Some(first), None) if arguments::is_camera(first) => (None, Some(first)),
                    (time, camera) => (time, camera),
                };
                let (places, many) = match time {
                    None => arguments::cameras(camera)?,
                    Some(time) => arguments::places(time, camera)?,
                };
                let given = size.is_some() && options.size != Size::Model;
                // If it changes, each time has its own Gaussians.
                if in_time.is_some() && time.is_some() {
                    let mut images = Vec::with_capacity(places.len());
                    for place in &places {
                        let splats = self.still_at(py, place.time, splats, in_time.as_ref())?;
                        let place = std::slice::from_ref(place);
                        images.extend(splats.get().draw(py, place, camera.is_none(), &options, given, antialias)?);
                    }
                    return Drawn::of(images, many);
                }
                let images = splats.get().draw(py, &places, camera.is_none(), &options, given, antialias)?;
                Drawn::of(images, many)
            }
        }
    }

    /// Opens the page of `streamsplat view` in the browser (unless `open` is False). It is served on the loopback
    /// address until the Viewer is closed.
    #[pyo3(signature = (*, port=0, open=true))]
    fn view(&self, py: Python<'_>, port: u16, open: bool) -> PyResult<Viewer> {
        let title = self.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let viewer = match &self.kind {
            Kind::Moving(scene) => Viewer::moving(title, scene.clone(), &self.workers, port)?,
            Kind::Still { splats, format, .. } => {
                let still = splats.get().scene.still().clone();
                py.detach(|| Viewer::still(title, still, format, &self.workers, port))?
            }
        };
        if open {
            py.import("webbrowser")?.call_method1("open", (viewer.url(),))?;
        }
        Ok(viewer)
    }

    /// Returns a PNG of the scene's first picture, for notebooks.
    fn _repr_png_<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        match &self.kind {
            Kind::Moving(scene) => self.read(py, scene, scene.index().intervals.len().min(2) - 1)?.picture(py),
            Kind::Still { splats, .. } => splats.get().picture(py),
        }
    }

    fn __repr__(&self) -> String {
        let path = self.path.display();
        match &self.kind {
            Kind::Moving(scene) => {
                let ((start, end), [height, width]) = (scene.span(), scene.placement().source);
                let (count, fps) = (scene.index().intervals.len(), scene.index().fps);
                let size = format!("{width}×{height}");
                format!(
                    "Scene({path}: {count} intervals, {start:.3} s to {end:.3} s, {fps:.3} frames a second, {size})"
                )
            }
            Kind::Still { splats, format, .. } => {
                let still = splats.get().scene.still();
                format!("Scene({path}: {format}, {} Gaussians, sh_degree={})", still.len(), still.degree)
            }
        }
    }
}

/// Writes a scene while it grows; a context manager. The files on disk are a valid scene at any moment.
#[pyclass(frozen, module = "streamsplat_cpu")]
pub struct SceneWriter {
    inner: Mutex<Option<scene::SceneWriter>>,
    path: PathBuf,
}

#[pymethods]
impl SceneWriter {
    #[new]
    fn new(path: PathBuf, fps: f64) -> PyResult<Self> {
        if !(fps.is_finite() && fps > 0.0) {
            return Err(wrong(format!("fps: expected a number above 0, found {fps}")));
        }
        let writer = scene::SceneWriter::create(&path, fps).map_err(not_written)?;
        Ok(Self { inner: Mutex::new(Some(writer)), path })
    }

    /// Writes the next interval.
    fn push(&self, py: Python<'_>, interval: &Interval) -> PyResult<()> {
        py.detach(|| match &mut *self.inner.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(writer) => writer.push(&interval.inner).map(drop).map_err(not_opened),
            None => Err(failed("the scene is finished")),
        })
    }

    /// Writes the index of all intervals.
    fn finish(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| match self.inner.lock().unwrap_or_else(PoisonError::into_inner).take() {
            Some(writer) => writer.finish().map(drop).map_err(not_opened),
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

    fn __repr__(&self) -> String {
        let state =
            if self.inner.lock().unwrap_or_else(PoisonError::into_inner).is_some() { "open" } else { "finished" };
        format!("SceneWriter({}: {state})", self.path.display())
    }
}

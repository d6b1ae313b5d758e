//! The online loop for Python.

use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use pyo3::prelude::*;
use pyo3::types::PyDict;
use streamsplat::stream::{Decibels, MaxAge, ModelSource};
use streamsplat::{Frame, Settings};
use streamsplat_kernels::Level;

use crate::arguments::choice;
use crate::arrays;
use crate::failure::{failed, present, wrong};
use crate::interval::Interval;

/// Turns key frames into a dynamic scene, one interval per key frame.
///
/// The state between key frames is bounded and independent of the stream's length. The arguments are the options of the
/// command line under the same names; `threads` and `isa` change no bit of any result.
#[pyclass(frozen, module = "streamsplat_cpu")]
pub struct Engine {
    inner: Mutex<streamsplat::Engine>,
}

impl Engine {
    fn lock(&self) -> MutexGuard<'_, streamsplat::Engine> {
        // A panic during a frame leaves the stream as it was before the frame.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl Engine {
    #[new]
    #[pyo3(signature = (model=None, *, dinov2=None, fusion="persistent", max_age=None, fit="letterbox", depth_range="frame",
        sampling="mean", seed=0, reuse=None, precision=None, isa="auto", threads=0, resolution=None, motion=None, refine=None, flow=None,
        fade=None, refine_every=None, quality=None, find_depth=None, guess_depth=None,
        refine_to=None, detail=None, still=None, behind=None))]
    fn new(
        py: Python<'_>,
        model: Option<PathBuf>,
        dinov2: Option<PathBuf>,
        fusion: &str,
        max_age: Option<u32>,
        fit: &str,
        depth_range: &str,
        sampling: &str,
        seed: u64,
        reuse: Option<&str>,
        precision: Option<&str>,
        isa: &str,
        threads: usize,
        resolution: Option<&str>,
        motion: Option<&str>,
        refine: Option<u32>,
        flow: Option<&str>,
        fade: Option<&str>,
        refine_every: Option<u32>,
        quality: Option<&str>,
        find_depth: Option<bool>,
        guess_depth: Option<bool>,
        refine_to: Option<f32>,
        detail: Option<u32>,
        still: Option<&str>,
        behind: Option<&str>,
    ) -> PyResult<Self> {
        model.iter().chain(&dinov2).try_for_each(|path| present(path))?;
        let model = match (model, dinov2) {
            (Some(checkpoint), dinov2) => ModelSource::File { checkpoint, dinov2 },
            (None, None) => ModelSource::Embedded,
            (None, Some(_)) => {
                return Err(wrong("dinov2: expected a model beside it; the embedded one does not use it"));
            }
        };
        let mut settings = match quality {
            Some(name) => Settings { model, ..Settings::of_quality(choice("quality", name)?) },
            None => Settings::with_model(model),
        };
        settings.fusion = choice("fusion", fusion)?;
        settings.max_age = max_age.map_or_else(MaxAge::default, MaxAge);
        settings.fit = choice("fit", fit)?;
        settings.depth_range = choice("depth_range", depth_range)?;
        settings.sampling = choice("sampling", sampling)?;
        settings.seed = seed;
        settings.level = Some(Level::named(isa).map_err(|e| wrong(format!("isa: {e}")))?);
        settings.threads = threads;
        if let Some(text) = motion {
            settings.motion = Some(choice("motion", text)?);
            // A request for the network's motion implies its fading.
            settings.fade = None;
        }
        if let Some(text) = reuse {
            settings.reuse = choice("reuse", text)?;
        }
        if let Some(text) = precision {
            settings.precision = Some(choice("precision", text)?);
        }
        if let Some(text) = resolution {
            settings.resolution = Some(choice("resolution", text)?);
        }
        if let Some(text) = flow {
            settings.flow = choice("flow", text)?;
        }
        if let Some(text) = fade {
            settings.fade = Some(choice("fade", text)?);
        }
        if refine_every == Some(0) {
            return Err(wrong("refine_every: expected a whole number from 1 on, found 0"));
        }
        if let Some(decibels) = refine_to {
            let found = Decibels::new(decibels);
            let wrong = || wrong(format!("refine_to: expected 20 to 100 dB, found {decibels}"));
            settings.refine_to = Some(found.ok_or_else(wrong)?);
        }
        if let Some(text) = still {
            settings.still = Some(choice("still", text)?);
        }
        if let Some(text) = behind {
            settings.behind = choice("behind", text)?;
        }
        let guesses = guess_depth == Some(true);
        settings.find_depth = find_depth.or(guesses.then_some(true)).or(settings.find_depth);
        settings.guess_depth = guess_depth.or(settings.guess_depth);
        settings.refine = refine.or(settings.refine);
        if let Some(share) = detail.filter(|share| *share > 1000) {
            return Err(wrong(format!("detail: expected 0 to 1000 for each 1000 pixels, found {share}")));
        }
        settings.detail = detail.or(settings.detail);
        settings.refine_every = refine_every.or(settings.refine_every);
        let engine = py.detach(|| streamsplat::Engine::new(settings)).map_err(failed)?;
        if guesses && !engine.finds_depth() {
            let expected = "expected find_depth, a model that ignores depth, and motion from frames";
            return Err(wrong(format!("guess_depth: {expected}")));
        }
        Ok(Self { inner: Mutex::new(engine) })
    }

    /// Processes the next key frame, `time` seconds into the video, and returns the interval that it ends.
    ///
    /// `frame` is `[height, width, 3]`, uint8 or floats in [0, 1]; grey is `[height, width]`, and alpha a fourth
    /// channel, composited over mid grey. `depth` is `[height, width]` float32, inverse depth of any scale. The first
    /// frame returns its static scene, an interval of no length. After an error the stream is as it was before.
    ///
    /// `between` holds the frames since the previous key frame with their times, `[(frame, time), …]`, ascending:
    /// motion and colours are computed from them (`motion="between"`).
    #[pyo3(signature = (frame, time, depth=None, *, between=None))]
    fn push(
        &self,
        py: Python<'_>,
        frame: &Bound<'_, PyAny>,
        time: f64,
        depth: Option<&Bound<'_, PyAny>>,
        between: Option<Vec<(Bound<'_, PyAny>, f64)>>,
    ) -> PyResult<Interval> {
        let (rgb, [height, width]) = arrays::planes(frame)?;
        let depth = depth.map(|map| arrays::depth(map, [height, width])).transpose()?;
        let frame = Frame { width, height, rgb, depth };
        let seen = between.unwrap_or_default();
        let seen = seen.iter().map(|(frame, time)| {
            let (rgb, [height, width]) = arrays::planes(frame)?;
            Ok((Frame { width, height, rgb, depth: None }, *time))
        });
        let seen = seen.collect::<PyResult<Vec<_>>>()?;
        py.detach(|| {
            let mut engine = self.lock();
            let interval = engine.push_with(seen, frame, time).map_err(failed)?;
            Ok(Interval::new(interval, engine.workers()))
        })
    }

    /// Work done and work avoided so far: `{stage: {"done", "avoided", "unit", "seconds"}}`.
    #[getter]
    fn work<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let work = py.detach(|| self.lock().work().clone());
        let all = PyDict::new(py);
        for stage in work.stages() {
            let one = PyDict::new(py);
            one.set_item("done", stage.done)?;
            one.set_item("avoided", stage.avoided)?;
            one.set_item("unit", stage.unit)?;
            one.set_item("seconds", stage.time.as_secs_f64())?;
            all.set_item(stage.stage, one)?;
        }
        Ok(all)
    }

    /// The instruction-set level in use.
    #[getter]
    fn isa(&self, py: Python<'_>) -> &'static str {
        py.detach(|| self.lock().workers().level().name())
    }

    /// The number of threads in use.
    #[getter]
    fn threads(&self, py: Python<'_>) -> usize {
        py.detach(|| self.lock().workers().threads())
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let (isa, threads) = (self.isa(py), self.threads(py));
        format!("Engine({isa}, {threads} thread{})", if threads == 1 { "" } else { "s" })
    }
}

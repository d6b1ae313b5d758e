//! Runs over whole clips.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use pyo3::prelude::*;
use pyo3::types::PyTuple;
use streamsplat::picture::Picture;
use streamsplat::run::options::Motion;
use streamsplat::run::{Error, Machine, Observer, Run, RunOptions, Stop};
use streamsplat::source::{FrameInMemory, Source};

use crate::arrays;
use crate::failure::{failed, mistyped, no_cameras, not_opened, not_read, not_written, present, wrong};
use crate::program;
use crate::source::Frames;

/// Calls `progress(done, total)`; an exception in it, or Ctrl-C, requests a stop and is kept.
struct Caller {
    progress: Option<Py<PyAny>>,
    raised: Arc<Mutex<Option<PyErr>>>,
    stop: Stop,
}

impl Observer for Caller {
    fn progress(&mut self, done: usize, total: Option<usize>) {
        let called = Python::attach(|py| {
            py.check_signals()?;
            self.progress.as_ref().map_or(Ok(()), |progress| progress.call1(py, (done, total)).map(drop))
        });
        if let Err(error) = called {
            *self.raised.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
            self.stop.ask();
        }
    }
}

/// Reconstructs `input`, a path or an iterable of frames, into `out` and returns the record in JSON. `options` are
/// names and texts of the options of `run`. `progress(done, total)` is called as frames are done; an exception in it,
/// or Ctrl-C, ends the run after the current interval and is raised here.
#[pyfunction]
pub fn run(
    py: Python<'_>,
    input: Bound<'_, PyAny>,
    out: PathBuf,
    options: Vec<(String, String)>,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    let raised: Arc<Mutex<Option<PyErr>>> = Arc::default();
    let stop = Stop::default();
    let run = match input.extract::<PathBuf>() {
        Ok(path) => {
            // Inputs other than files have their own errors.
            if path != *"-" && !path.to_string_lossy().contains("://") {
                present(&path)?;
            }
            assembled(|all| Run::new(path, all), options)
        }
        Err(_) => {
            let rate = options.iter().find(|(name, _)| name == "fps").map(|(_, text)| text.parse());
            let rate = rate.transpose().map_err(|e| wrong(format!("fps: expected a number, {e}")))?;
            let (rate, count) = match input.cast::<Frames>() {
                Ok(frames) => (rate.or(Some(frames.get().rate())), frames.get().frames()),
                Err(_) => (rate, input.len().ok()),
            };
            let frames = Given { iterator: input.try_iter()?.into_any().unbind(), raised: raised.clone() };
            let source = py.detach(|| Source::of_frames(frames, rate, count));
            if let Some(error) = raised.lock().unwrap_or_else(PoisonError::into_inner).take() {
                return Err(error);
            }
            let source = source.map_err(not_read)?;
            assembled(|all| Run::of_frames(source, all), options)
        }
    };
    let run = run.map_err(raise)?.out(out).program(program::commit()).stop(stop.clone());
    let run = run.observe(Caller { progress, raised: raised.clone(), stop });
    let record = py.detach(|| run.finish());
    if let Some(error) = raised.lock().unwrap_or_else(PoisonError::into_inner).take() {
        return Err(error);
    }
    let record = record.map_err(raise)?;
    if let Some(damage) = &record.input.damage {
        return Err(failed(damage));
    }
    record.to_json().map_err(raise)
}

/// Frames of an iterator: arrays, or pairs of an array and its time. An exception ends them and is kept.
struct Given {
    iterator: Py<PyAny>,
    raised: Arc<Mutex<Option<PyErr>>>,
}

impl Given {
    fn frame(&self, py: Python<'_>) -> PyResult<Option<(Picture, Option<f64>)>> {
        let Some(next) = self.iterator.bind(py).try_iter()?.next().transpose()? else { return Ok(None) };
        let (frame, time) = match next.cast::<PyTuple>() {
            Ok(pair) => {
                let (frame, time): (Bound<'_, PyAny>, f64) = pair.extract().map_err(|_| {
                    mistyped(format!("input: expected frames, or pairs of a frame and its time, found {}", pair.len()))
                })?;
                (frame, Some(time))
            }
            Err(_) => (next, None),
        };
        let (rgb, [height, width]) = arrays::planes(&frame)?;
        Ok(Some((Picture { width, height, rgb }, time)))
    }
}

impl Iterator for Given {
    type Item = FrameInMemory;

    fn next(&mut self) -> Option<FrameInMemory> {
        let frame = Python::attach(|py| self.frame(py));
        frame.transpose().map(|frame| {
            frame.map_err(|error| {
                let text = error.to_string();
                *self.raised.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                text
            })
        })
    }
}

/// Builds the run with these options.
fn assembled(run: impl FnOnce(RunOptions) -> Run, options: Vec<(String, String)>) -> Result<Run, Error> {
    let (mut all, mut machine) = (RunOptions::default(), Machine::default());
    let (mut resume, mut overwrite, mut json) = (false, false, None);
    for (name, text) in options {
        let flag =
            || text.parse().map_err(|_| Error::usage(format!("--{name}: expected true or false, found {text:?}")));
        match name.as_str() {
            "resume" => resume = flag()?,
            "overwrite" => overwrite = flag()?,
            "json" => json = Some(PathBuf::from(text)),
            // The default circle of a flag without a value.
            "sway" if text == "true" => _ = all.set("sway", Motion::SWAY)?,
            _ if all.set(&name, &text)? || machine.set(&name, &text)? => {}
            _ => return Err(Error::usage(format!("{name}: expected an option of `streamsplat run`"))),
        }
    }
    Ok(run(all).machine(machine).resume(resume).overwrite(overwrite).json(json))
}

fn raise(error: Error) -> PyErr {
    match error {
        Error::Usage(message) => wrong(message),
        Error::Output(error) => not_written(error),
        Error::Scene(error) => not_opened(error),
        Error::Source(error) => not_read(error),
        Error::Camera(error) => no_cameras(error),
        error => failed(error),
    }
}

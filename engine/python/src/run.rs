//! Whole clips.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use pyo3::prelude::*;
use streamsplat::run::options::Motion;
use streamsplat::run::{Error, Machine, Observer, Run, RunOptions, Stop};

use crate::failure::{failed, wrong};
use crate::program;

/// Calls `progress(done, total)`; an exception in it, or Ctrl-C, asks to stop and is kept.
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

/// Reconstructs `input` into `out` and returns the record in JSON. `options` are names and texts of the options of `run`. `progress(done, total)` is called as frames are
/// done; an exception in it, or Ctrl-C, ends the run after the interval at hand and is raised here.
#[pyfunction]
pub fn run(
    py: Python<'_>,
    input: PathBuf,
    out: PathBuf,
    options: Vec<(String, String)>,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    let raised: Arc<Mutex<Option<PyErr>>> = Arc::default();
    let stop = Stop::default();
    let run = assembled(input, options).map_err(raise)?.out(out).program(program::commit()).stop(stop.clone());
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

/// The run of these options.
fn assembled(input: PathBuf, options: Vec<(String, String)>) -> Result<Run, Error> {
    let (mut all, mut machine) = (RunOptions::default(), Machine::default());
    let (mut resume, mut overwrite, mut json) = (false, false, None);
    for (name, text) in options {
        let flag =
            || text.parse().map_err(|_| Error::usage(format!("--{name}: expected true or false, found {text:?}")));
        match name.as_str() {
            "resume" => resume = flag()?,
            "overwrite" => overwrite = flag()?,
            "json" => json = Some(PathBuf::from(text)),
            // The circle of a flag without a value.
            "sway" if text == "true" => _ = all.set("sway", Motion::SWAY)?,
            _ if all.set(&name, &text)? || machine.set(&name, &text)? => {}
            _ => return Err(Error::usage(format!("{name}: expected an option of `streamsplat run`"))),
        }
    }
    Ok(Run::new(input, all).machine(machine).resume(resume).overwrite(overwrite).json(json))
}

fn raise(error: Error) -> PyErr {
    if error.is_usage() { wrong(error) } else { failed(error) }
}

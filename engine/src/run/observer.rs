//! Messages of a run under way, and requests to stop it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::Error;
use crate::stream::Interval;

/// Receives what a run reports on its way. All methods do nothing unless they are implemented.
pub trait Observer: Send {
    /// Lines about the input or the output: what was assumed, converted or left out.
    fn notes(&mut self, _lines: &[String]) {}

    /// The input is open and has `fps` frames a second; nothing is written yet.
    ///
    /// # Errors
    /// An error ends the run.
    fn opened(&mut self, _fps: f64) -> Result<(), Error> {
        Ok(())
    }

    /// Frames are read from now on, `total` of them where that is known.
    fn started(&mut self, _total: Option<usize>) {}

    /// `done` of `total` frames are done; `total` is `None` where it is not known.
    fn progress(&mut self, _done: usize, _total: Option<usize>) {}

    /// An interval is computed; its images are not drawn yet.
    fn interval(&mut self, _interval: &Interval) {}

    /// All frames are done; the files are being completed.
    fn finishing(&mut self) {}

    /// The files are complete.
    fn finished(&mut self) {}
}

/// An observer that ignores everything.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Observer for Silent {}

/// A request to stop, shared by its clones. A run stops after the interval at hand, and what it wrote is valid.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Requests it; returns true if it was requested before.
    pub fn ask(&self) -> bool {
        self.0.swap(true, Ordering::SeqCst)
    }

    /// Returns true once it was requested.
    pub fn asked(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

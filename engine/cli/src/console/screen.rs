//! A run under way on the user's terminal, and on the page where that is asked for.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use streamsplat::run::{Error, Observer};
use streamsplat::stream::Interval;

use super::Console;
use super::progress::Progress;
use super::serving::Serving;

/// The page of a run, which outlives it.
pub type Page = Arc<Mutex<Option<Serving>>>;

/// Shows a run.
pub struct Screen {
    /// Its input.
    pub input: PathBuf,
    /// The port of the page, if there is one.
    pub serve: Option<u16>,
    /// The terminal.
    pub console: Console,
    /// The page, once it is there.
    pub page: Page,
    /// Frames done, once there are any.
    pub progress: Option<Progress>,
}

impl Screen {
    fn on_page(&self, show: impl FnMut(&Serving)) {
        self.page.lock().unwrap_or_else(PoisonError::into_inner).iter().for_each(show);
    }
}

impl Observer for Screen {
    fn notes(&mut self, lines: &[String]) {
        self.console.note(lines);
    }

    fn opened(&mut self, fps: f64) -> Result<(), Error> {
        let Some(port) = self.serve else { return Ok(()) };
        let page = Serving::start(port, &self.input, fps, &self.console).map_err(|e| Error::work(e.message()))?;
        *self.page.lock().unwrap_or_else(PoisonError::into_inner) = Some(page);
        Ok(())
    }

    fn started(&mut self, total: Option<usize>) {
        self.progress = Some(Progress::new("frames", total, &self.console));
    }

    fn progress(&mut self, _: usize, _: Option<usize>) {
        self.progress.iter_mut().for_each(Progress::step);
    }

    fn interval(&mut self, interval: &Interval) {
        self.on_page(|page| page.push(interval));
    }

    fn finishing(&mut self) {
        self.progress.iter_mut().for_each(|progress| progress.phase("frames; finishing the files"));
    }

    fn finished(&mut self) {
        self.progress.take().into_iter().for_each(Progress::finish);
        self.on_page(Serving::complete);
    }
}

//! Display of a run: on the user's terminal and, if requested, on its page.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use streamsplat::run::{Error, Observer};
use streamsplat::stream::Interval;

use super::Console;
use super::progress::Progress;
use super::serving::Serving;

/// The page of a run, which stays open after the run.
pub type Page = Arc<Mutex<Option<Serving>>>;

/// Display of a run.
pub struct Screen {
    /// Its input.
    pub input: PathBuf,
    /// The port of the page, if requested.
    pub serve: Option<u16>,
    /// The terminal.
    pub console: Console,
    /// The page, once it exists.
    pub page: Page,
    /// Progress of frames, once the first is done.
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

//! A run under way: key frames through the engine, results to where they go.

use std::path::Path;

use streamsplat::picture::Picture;
use streamsplat::render::Snapshot;
use streamsplat::stream::{Interval, ResumePoint};
use streamsplat::{Engine, Image};

use crate::console::failure::Failure;
use crate::console::progress::Progress;
use crate::console::stop::Stop;
use crate::options::settings::Views;
use crate::output::outputs::{Emit, Outputs};
use crate::output::record::Account;
use crate::output::resume_state::Point;
use crate::output::terms::Terms;

use super::ahead::Ahead;
use super::closeness::{Closeness, Whole};
use super::drawing::Drawing;
use super::serving::Serving;

/// A run under way.
pub struct Stream<'a> {
    pub keys: Ahead,
    pub engine: Engine,
    pub outputs: Outputs,
    pub drawing: &'a mut Drawing,
    /// Where key frames depend on it.
    pub closeness: Option<Closeness>,
    /// Where images of the source's size are compared with the frames.
    pub whole: Option<Whole>,
    pub progress: Progress,
    /// Request to stop after the interval at hand.
    pub stop: Stop,
    pub page: Option<Serving>,
    pub account: Account,
    pub emit: Emit,
    /// Gaussians left out by the engine.
    pub dropped: u64,
    /// First and last time seen.
    pub span: Option<(f64, f64)>,
    /// The next key frame.
    pub key: u64,
}

/// Input and terms of a run under way.
pub struct RunOrigin<'a> {
    /// Program version, options and model, which determine the output together with the input.
    pub terms: &'a Terms,
    /// Where frames come from.
    pub input: &'a Path,
    /// True if the run was resumed and has intervals of an earlier process.
    pub resumed: bool,
}

impl Stream<'_> {
    /// Takes the rest of the video through the engine; false when the user stopped it. Where depth is found, the first key frame's results are
    /// drawn from the interval after it, as from the scene; until then there is nothing to resume from, and the run does not stop.
    pub fn pass(&mut self, times: &mut Times<'_>, views: &Views, origin: &RunOrigin<'_>) -> Result<bool, Failure> {
        if origin.resumed && self.stop.asked() {
            return Ok(false);
        }
        let mut first = None;
        while let Some(mut key) = self.keys.next()? {
            let Some(timestamp) = key.shown.last().map(|frame| frame.timestamp) else { continue };
            let resume = self.engine.resume_point().filter(|_| self.outputs.can_resume());
            let interval = self.engine.push_with(key.take_between(), key.frame, timestamp)?;
            self.dropped += interval.dropped;
            self.span = Some((self.span.map_or(interval.start, |(first, _)| first), interval.end));
            if let Some(page) = &self.page {
                page.push(&interval);
            }
            let shown: Vec<f64> = key.shown.iter().map(|frame| frame.timestamp).collect();
            let frames = key.shown.iter().map(|frame| (frame.index, frame.timestamp));
            let mut due = if self.emit.draws() || self.emit.ply { times.of(&interval, frames) } else { Vec::new() };
            if let Some(whole) = &mut self.whole {
                let truths = key.shown.iter().zip(&mut key.truths);
                truths.for_each(|(frame, truth)| whole.expect(frame.index, truth.samples.take().unwrap_or_default()));
            }
            let waits = interval.index == 0 && self.engine.finds_depth() && !due.is_empty();
            self.drawing.writing(|| self.outputs.interval(&interval, &shown, self.engine.workers()))?;
            if !waits {
                if let Some((_, of_first)) = first.take() {
                    due.splice(0..0, of_first);
                }
                self.draw(&interval, &due, views)?;
            }
            if let Some(closeness) = &mut self.closeness
                && let Some(found) = closeness.of(&interval, &key.truths)?
            {
                self.keys.tell(&found, closeness);
            }
            if waits {
                first = Some((interval, due));
            } else {
                self.commit(origin, times.next, resume.as_ref())?;
            }
            self.key += 1;
            key.shown.iter().for_each(|_| self.progress.step());
            if self.stop.asked() && first.is_none() {
                return Ok(false);
            }
        }
        // It was the only one.
        if let Some((interval, due)) = first {
            self.draw(&interval, &due, views)?;
        }
        Ok(true)
    }

    /// Draws and writes what is due in an interval.
    fn draw(&mut self, interval: &Interval, due: &[(usize, f64)], views: &Views) -> Result<(), Failure> {
        let Stream { outputs, drawing, emit, keys, whole, .. } = self;
        let emit = *emit;
        // With `--times`, images follow each other at a constant rate.
        let rate = views.times.as_ref().map(|_| keys.fps());
        drawing.pass(
            due.iter(),
            |drawing, &(index, time)| {
                Ok(Some((index, time, Drawn::of(drawing, interval, (index, time), emit, views)?)))
            },
            |(index, time, drawn)| {
                drawn.write(outputs, index, rate.map_or(time, |fps| index as f64 / fps), whole.as_mut())
            },
        )
    }

    /// Makes the interval just written one to go on from.
    fn commit(&mut self, origin: &RunOrigin<'_>, times: usize, resume: Option<&ResumePoint>) -> Result<(), Failure> {
        if !self.outputs.can_resume() {
            return Ok(());
        }
        let point = Point {
            terms: origin.terms.clone(),
            input: self.keys.input(origin.input),
            key: self.key,
            span: self.span.unwrap_or_default(),
            times,
            choices: self.keys.choices().cloned(),
            whole: self.whole.as_ref().map(Whole::compared),
            work: self.account.of(self.engine.work()),
            dropped: self.dropped,
            drawn: self.drawing.counts.clone(),
            anchor: self.drawing.anchor,
            ledger: 0,
            video: None,
        };
        let Stream { outputs, drawing, .. } = self;
        drawing.writing(|| outputs.commit(point, resume))
    }
}

/// Results at one time, not yet written.
struct Drawn {
    image: Option<Image>,
    snapshot: Option<Snapshot>,
}

impl Drawn {
    /// Those of `interval` at `time` that `emit` asks for.
    fn of(
        drawing: &mut Drawing,
        interval: &Interval,
        (index, time): (usize, f64),
        emit: Emit,
        views: &Views,
    ) -> Result<Self, Failure> {
        let image = emit.draws().then(|| drawing.draw(interval, index, time, views)).transpose()?;
        let snapshot = emit.ply.then(|| Snapshot::square(interval, time, drawing.workers())).transpose()?;
        if let Some(snapshot) = &snapshot {
            // Where an image is drawn as well, they are counted with it.
            drawing.counts.dropped += if emit.draws() { 0 } else { snapshot.dropped };
        }
        Ok(Self { image, snapshot })
    }

    /// Writes them under the number `index`; a video shows the image at `time`.
    fn write(self, outputs: &mut Outputs, index: usize, time: f64, whole: Option<&mut Whole>) -> Result<(), Failure> {
        if let Some(image) = self.image {
            let image = match whole {
                Some(whole) => compared(whole, index, image),
                None => image,
            };
            outputs.image(index, time, image)?;
        }
        self.snapshot.map_or(Ok(()), |snapshot| outputs.snapshot(index, &snapshot))
    }
}

/// The image, once it is compared with its frame.
fn compared(whole: &mut Whole, index: usize, image: Image) -> Image {
    let Image { width, height, .. } = image;
    let picture = Picture { width, height, rgb: image.rgb };
    whole.compare(index, &picture);
    Image { rgb: picture.rgb, ..image }
}

/// The times at which images are due.
pub struct Times<'a> {
    /// Those asked for.
    pub asked: Option<&'a [f64]>,
    /// The next of them.
    pub next: usize,
}

impl Times<'_> {
    /// Numbers and times of the images of `interval`: the input frames' own, or what of the times asked for it holds.
    fn of(&mut self, interval: &Interval, frames: impl Iterator<Item = (usize, f64)>) -> Vec<(usize, f64)> {
        let Some(asked) = self.asked else { return frames.collect() };
        let mut due = Vec::new();
        while let Some(&time) = asked.get(self.next).filter(|time| **time <= interval.end) {
            if time < interval.start {
                break;
            }
            due.push((self.next, time));
            self.next += 1;
        }
        due
    }

    /// The first time asked for that no interval held.
    pub fn left(&self) -> Option<f64> {
        self.asked?.get(self.next).copied()
    }
}

//! From an interval to its images and files.

use std::collections::BTreeMap;
use std::path::PathBuf;

use super::ahead::Ahead;
use super::closeness::{Closeness, Truth, Whole};
use super::drawing::Drawing;
use super::outputs::{Emit, Outputs};
use super::record::WorkRecord;
use super::resume_state::Point;
use super::terms::Terms;
use super::views::Views;
use super::{Error, Shown};
use crate::Image;
use crate::picture::Picture;
use crate::stream::{Interval, ResumePoint, Snapshot};

/// What the images of a run are drawn, compared and written with.
pub(super) struct Delivery {
    pub keys: Ahead,
    /// Destination of the results; `None` where only the caller receives them, and after a failure.
    pub outputs: Option<Outputs>,
    pub drawing: Drawing,
    /// PSNR at the size at which the model sees the video, where key frames depend on it.
    pub closeness: Option<Closeness>,
    /// PSNR at the source's size, where the images have that size and the model sees another one.
    pub whole: Option<Whole>,
    pub emit: Emit,
    pub views: Views,
    /// Gaussians left out by the engine.
    pub dropped: u64,
    /// First and last time so far.
    pub span: Option<(f64, f64)>,
    /// The next key frame.
    pub key: u64,
    /// Number of requested times that are done.
    pub times: usize,
    pub terms: Terms,
    /// The input's path.
    pub input: PathBuf,
}

/// A computed interval whose images are not drawn yet.
pub(super) struct Pending {
    pub interval: Interval,
    /// Numbers and times of the images, those of the first interval included where they waited.
    pub due: Vec<(usize, f64)>,
    pub truths: Vec<Truth>,
    /// Number of input frames.
    pub frames: usize,
    /// True if its images are drawn with the next interval.
    pub waits: bool,
    /// The first interval where it waited, and the number of its images.
    pub first: Option<(Interval, usize)>,
    /// State of the engine before it.
    pub resume: Option<ResumePoint>,
    /// Work up to it.
    pub work: BTreeMap<String, WorkRecord>,
}

/// A delivered interval and the images that are kept.
pub(super) struct Delivered {
    pub pending: Pending,
    pub images: Vec<Shown>,
}

impl Delivery {
    /// Draws and writes the images of an interval, reports how close they are to the frames, and makes the interval a
    /// point to resume from. It may run while the engine computes the next interval.
    pub(super) fn deliver(&mut self, pending: Pending, keep: bool) -> Result<Delivered, Error> {
        self.keys.take_up();
        let Pending { interval, due, truths, waits, resume, work, .. } = &pending;
        let images = if *waits { Vec::new() } else { self.draw(interval, due, truths, keep)? };
        if let Some(closeness) = &mut self.closeness
            && let Some(found) = closeness.of(interval, truths)?
        {
            self.keys.tell(&found, closeness);
        }
        if !waits {
            self.commit(resume.as_ref(), work.clone())?;
        }
        self.key += 1;
        Ok(Delivered { pending, images })
    }

    pub(super) fn can_resume(&self) -> bool {
        self.outputs.as_ref().is_some_and(Outputs::can_resume)
    }

    /// Numbers and times of the images of `interval`: the input frames' own, or those of the requested times that are
    /// in it.
    pub(super) fn due(&mut self, interval: &Interval, frames: impl Iterator<Item = (usize, f64)>) -> Vec<(usize, f64)> {
        let Some(asked) = &self.views.times else { return frames.collect() };
        let mut due = Vec::new();
        while let Some(&time) = asked.get(self.times).filter(|time| **time <= interval.end) {
            if time < interval.start {
                break;
            }
            due.push((self.times, time));
            self.times += 1;
        }
        due
    }

    /// Draws and writes the images that are due in an interval.
    pub(super) fn draw(
        &mut self,
        interval: &Interval,
        due: &[(usize, f64)],
        truths: &[Truth],
        keep: bool,
    ) -> Result<Vec<Shown>, Error> {
        let Self { outputs, drawing, emit, keys, whole, closeness, views, .. } = self;
        let (emit, views, mut kept) = (*emit, &*views, Vec::new());
        // With `--times`, images have a constant rate.
        let rate = views.times.as_ref().map(|_| keys.fps());
        drawing.pass(
            due.iter(),
            |drawing, &(index, time)| {
                Ok(Some((index, time, Drawn::of(drawing, interval, (index, time), emit, views)?)))
            },
            |(index, time, Drawn { image, snapshot })| {
                if let Some(image) = image {
                    let Image { width, height, .. } = image;
                    let picture = Picture { width, height, rgb: image.rgb };
                    if let Some(whole) = whole {
                        whole.compare(index, &picture);
                    }
                    if let Some(closeness) = closeness {
                        closeness.take(interval, (time, &picture), views, truths)?;
                    }
                    let image = Image { rgb: picture.rgb, ..image };
                    kept.extend(keep.then(|| Shown { index, time, image: image.clone() }));
                    if let Some(outputs) = outputs.as_mut() {
                        outputs.image(index, rate.map_or(time, |fps| index as f64 / fps), image)?;
                    }
                }
                match (snapshot, outputs.as_mut()) {
                    (Some(snapshot), Some(outputs)) => outputs.snapshot(index, &snapshot),
                    _ => Ok(()),
                }
            },
        )?;
        Ok(kept)
    }

    /// Makes the interval just written a point to resume from.
    fn commit(&mut self, resume: Option<&ResumePoint>, work: BTreeMap<String, WorkRecord>) -> Result<(), Error> {
        if !self.can_resume() {
            return Ok(());
        }
        let point = Point {
            terms: self.terms.clone(),
            input: self.keys.input(&self.input),
            key: self.key,
            span: self.span.unwrap_or_default(),
            times: self.times,
            choices: self.keys.choices().cloned(),
            whole: self.whole.as_ref().map(|whole| whole.total.stored()),
            work,
            dropped: self.dropped,
            drawn: self.drawing.counts.clone(),
            anchor: self.drawing.anchor,
            ledger: 0,
            video: None,
        };
        let Self { outputs, drawing, .. } = self;
        outputs.as_mut().map_or(Ok(()), |outputs| drawing.writing(|| outputs.commit(point, resume)))
    }
}

/// Results at one time, not yet written.
struct Drawn {
    image: Option<Image>,
    snapshot: Option<Snapshot>,
}

impl Drawn {
    /// The results of `interval` at `time` that `emit` selects.
    fn of(
        drawing: &mut Drawing,
        interval: &Interval,
        (index, time): (usize, f64),
        emit: Emit,
        views: &Views,
    ) -> Result<Self, Error> {
        let image = emit.draws().then(|| drawing.draw(interval, index, time, views)).transpose()?;
        let snapshot = emit.ply.then(|| Snapshot::square(interval, time, drawing.workers())).transpose()?;
        if let Some(snapshot) = &snapshot {
            // Where an image is drawn as well, its count includes them.
            drawing.counts.dropped += if emit.draws() { 0 } else { snapshot.dropped };
        }
        Ok(Self { image, snapshot })
    }
}

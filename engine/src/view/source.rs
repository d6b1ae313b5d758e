//! Sources of the page's intervals.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use serde::Serialize;

use super::packet::packet;
use super::page::{PageError, Whole};
use super::still::StillDescription;
use crate::camera::Camera;
use crate::fit::Placement;
use crate::picture::Picture;
use crate::render::RenderOptions;
use crate::scene::{ImageChunks, PlacementRecord, Scene, SceneError};
use crate::stream::{Interval, Workers};

/// Description of a scene, sent to the page as JSON.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Description {
    /// Title of the scene on the page.
    pub title: String,
    /// Frames per second of the source.
    pub fps: f64,
    /// Placement of the source's frame in the model's input; unknown before a stream's first interval.
    pub placement: Option<PlacementRecord>,
    /// Description of a still scene, which has one interval: an instant.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub still: Option<StillDescription>,
    /// True if this is a live stream, false if it is a recording.
    pub live: bool,
    /// True if no more intervals will come.
    pub complete: bool,
    /// Number of the first interval that is still available.
    pub first: usize,
    /// The number of the first listed interval.
    pub from: usize,
    /// The intervals from that number on.
    pub intervals: Vec<IntervalTimes>,
}

/// One interval of the list.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct IntervalTimes {
    /// Start in seconds.
    pub start: f64,
    /// End in seconds.
    pub end: f64,
    /// Gaussians.
    pub gaussians: usize,
}

/// Source of the scene that a page shows.
pub trait Source: Send + Sync {
    /// Describes the scene, with its intervals from number `from` on.
    fn describe(&self, from: usize) -> Description;

    /// Interval `i` as a [`packet`](mod@super::packet); `None` if there is none of that number, no longer or not yet.
    ///
    /// # Errors
    /// A scene that cannot be read.
    fn packet(&self, i: usize) -> Result<Option<Arc<[u8]>>, SceneError>;
}

/// A scene on disk, its intervals read on demand.
#[derive(Clone, Debug)]
pub struct Recorded {
    title: String,
    scene: Scene,
    workers: Workers,
}

impl Recorded {
    /// A scene under the name `title`.
    pub fn new(title: impl Into<String>, scene: Scene, workers: Workers) -> Recorded {
        Recorded { title: title.into(), scene, workers }
    }

    /// Interval `i`, which must exist.
    fn interval(&self, i: usize) -> Result<Interval, SceneError> {
        self.scene.interval(i)
    }
}

impl Source for Recorded {
    fn describe(&self, from: usize) -> Description {
        let index = self.scene.index();
        let intervals = index.intervals.iter().skip(from);
        let intervals = intervals.map(|e| IntervalTimes { start: e.start, end: e.end, gaussians: e.gaussians });
        Description {
            title: self.title.clone(),
            fps: index.fps,
            placement: Some(index.placement),
            still: None,
            live: false,
            complete: true,
            first: 0,
            from,
            intervals: intervals.collect(),
        }
    }

    fn packet(&self, i: usize) -> Result<Option<Arc<[u8]>>, SceneError> {
        if i >= self.scene.index().intervals.len() {
            return Ok(None);
        }
        Ok(Some(packet(&self.scene.interval(i)?).into()))
    }
}

impl Whole for Recorded {
    const ABOUT: &str = "A video as a scene that can be turned: dynamic 3D Gaussians";

    /// An image of the model's input size.
    fn poster(&self) -> Result<Picture, PageError> {
        let interval = self.interval(0)?;
        let image = interval.render(interval.start, &Camera::Canonical, &RenderOptions::default(), &self.workers)?;
        Ok(Picture { width: image.width, height: image.height, rgb: image.rgb })
    }

    /// Each part is the key frame at its end, a byte that is 1 for an independent chunk, and the chunk.
    fn parts(&self, put: &mut dyn FnMut(&[u8]) -> Result<(), PageError>) -> Result<(), PageError> {
        let mut chunks = ImageChunks::default();
        for i in 0..self.scene.index().intervals.len() {
            let interval = self.interval(i)?;
            let (chunk, alone) = chunks.next(&interval, &self.workers);
            put(&[&interval.index.to_le_bytes()[..], &[u8::from(alone)], &chunk].concat())?;
        }
        Ok(())
    }
}

/// A stream under way. The newest intervals are kept, up to a number of bytes.
#[derive(Debug)]
pub struct Live {
    title: String,
    fps: f64,
    most: usize,
    state: Mutex<Stream>,
}

/// The part of a stream that has arrived so far.
#[derive(Debug, Default)]
struct Stream {
    placement: Option<Placement>,
    complete: bool,
    first: usize,
    bytes: usize,
    kept: VecDeque<(IntervalTimes, Arc<[u8]>)>,
}

impl Live {
    /// A stream that has not begun. At most `most` bytes of its packets are kept, but always the last packet.
    pub fn new(title: impl Into<String>, fps: f64, most: usize) -> Live {
        Live { title: title.into(), fps, most, state: Mutex::default() }
    }

    /// Appends an interval.
    ///
    /// # Panics
    /// As [`packet`](fn@super::packet::packet).
    pub fn push(&self, interval: &Interval) {
        let bytes: Arc<[u8]> = packet(interval).into();
        let times = IntervalTimes { start: interval.start, end: interval.end, gaussians: interval.gaussians.len() };
        let mut stream = self.lock();
        stream.placement = Some(interval.placement);
        stream.bytes += bytes.len();
        stream.kept.push_back((times, bytes));
        while stream.bytes > self.most
            && stream.kept.len() > 1
            && let Some((_, oldest)) = stream.kept.pop_front()
        {
            stream.bytes -= oldest.len();
            stream.first += 1;
        }
    }

    /// Marks the end: no more intervals will come.
    pub fn complete(&self) {
        self.lock().complete = true;
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Stream> {
        // Each change leaves a valid state, so that a panic elsewhere leaves one too.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Source for Live {
    fn describe(&self, from: usize) -> Description {
        let stream = self.lock();
        let from = from.max(stream.first);
        Description {
            title: self.title.clone(),
            fps: self.fps,
            placement: stream.placement.map(PlacementRecord::from),
            still: None,
            live: true,
            complete: stream.complete,
            first: stream.first,
            from,
            intervals: stream.kept.iter().skip(from - stream.first).map(|(times, _)| *times).collect(),
        }
    }

    fn packet(&self, i: usize) -> Result<Option<Arc<[u8]>>, SceneError> {
        let stream = self.lock();
        let place = i.checked_sub(stream.first);
        Ok(place.and_then(|place| stream.kept.get(place)).map(|(_, bytes)| bytes.clone()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::Fit;
    use crate::stream::{DynamicGaussians, Record};

    fn interval(index: u64, gaussians: usize) -> Interval {
        let record = Record { mean: [0.0, 0.5, 0.0], opacity: 1.0, ..Record::default() };
        let gaussians: DynamicGaussians = (0..gaussians).map(|_| record).collect();
        let placement = Placement::new(Fit::Letterbox, [24, 40], [24, 40]).expect("sizes");
        let (start, end) = (index as f64, index as f64 + 1.0);
        Interval { index, start, end, gaussians, placement, merges: Vec::new(), dropped: 0 }
    }

    #[test]
    fn a_stream_keeps_its_newest_intervals_within_its_bytes() {
        let live = Live::new("a", 10.0, 5000);
        assert_eq!((live.describe(0).placement, live.describe(7).from), (None, 7));
        for index in 0..20 {
            live.push(&interval(index, 30));
        }
        let all = live.describe(0);
        // 96 + 30·34 bytes each: four fit.
        assert_eq!((all.first, all.from, all.intervals.len()), (16, 16, 4));
        assert_eq!(all.intervals[0].start, 16.0);
        assert_eq!(live.describe(19).intervals.len(), 1);
        assert_eq!(live.describe(usize::MAX).intervals.len(), 0);
        assert!(live.packet(15).expect("memory").is_none() && live.packet(20).expect("memory").is_none());
        assert_eq!(live.packet(16).expect("memory").expect("kept")[8], 16);
        assert!(!all.complete);
        live.complete();
        assert!(live.describe(20).complete);
        live.push(&interval(20, 1000));
        assert_eq!(live.describe(0).intervals.len(), 1, "the last one stays, whatever its size");
    }
}

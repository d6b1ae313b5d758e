//! Input frames to key frames, with their depth maps, and the frames in between.

use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use crate::Frame;
use crate::gap::{self, ControlState, Found, Gap, Group};
use crate::picture::Picture;
use crate::source::{Source, SourceError, TimedPicture};

use crate::run::choices::Choices;
use crate::run::closeness::Truth;
use crate::run::digest::InputDigest;
use crate::run::keydepth::{KeyDepth, NetworkAccount};
use crate::run::{Error, Stop};

/// A key frame and the frames since the one before.
pub struct KeyFrame {
    /// The key frame's picture and depth.
    pub frame: Frame,
    /// Input frames after the key frame before, this one last. Their pictures are empty unless they are kept
    /// ([`Keep`]).
    pub shown: Vec<TimedPicture>,
    /// The same frames in the form in which they are compared, where the choice of key frames requires it.
    pub truths: Vec<Truth>,
}

/// Account of the input read.
#[derive(Clone, Debug)]
pub struct Reading {
    /// Frames.
    pub frames: usize,
    /// Their digest.
    pub blake3: String,
    /// Width and height of a frame.
    pub size: [usize; 2],
    /// Time spent reading.
    pub time: Duration,
    /// Work done by the depth network, if there is one.
    pub network: Option<NetworkAccount>,
    /// Why the input ended early or what was irregular in it; the frames before are kept.
    pub damage: Option<String>,
    /// Conversions of the pictures and files left out, one per line: first those known when the source was opened.
    pub notes: Vec<String>,
}

impl KeyFrame {
    /// The frames in between with their times, where their pictures were kept; they are taken out of `shown`.
    pub fn take_between(&mut self) -> Vec<(Frame, f64)> {
        let between = self.shown.len().saturating_sub(1);
        let taken = self.shown[..between].iter_mut().map(|frame| {
            let Picture { width, height, rgb } = std::mem::replace(&mut frame.picture, empty());
            (Frame { width, height, rgb, depth: None }, frame.timestamp)
        });
        taken.filter(|(frame, _)| frame.width > 0).collect()
    }

    /// Copies of the frames in between with their times, where their pictures were kept.
    pub fn between(&self) -> Vec<(Frame, f64)> {
        let between = self.shown.len().saturating_sub(1);
        let copy = |frame: &TimedPicture| {
            let Picture { width, height, rgb } = frame.picture.clone();
            (Frame { width, height, rgb, depth: None }, frame.timestamp)
        };
        self.shown[..between].iter().map(copy).collect()
    }
}

/// Pictures kept in addition to the key frame's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Keep {
    /// None.
    Nothing,
    /// Those of the frames in between.
    Between,
    /// Those of the frames in between and of the key frame, for comparisons. Frames after the last whole fixed gap are
    /// left out.
    Everything,
}

/// A width and height for frames of a width and height.
pub type Placing = Box<dyn Fn([usize; 2]) -> [usize; 2] + Send>;

/// Reads key frames one at a time.
pub struct KeyFrames {
    source: Source,
    depth: KeyDepth,
    groups: gap::KeyFrames<TimedPicture>,
    keep: Keep,
    /// True if frames after the last key frame are left out.
    whole_gaps: bool,
    limit: usize,
    digest: InputDigest,
    size: [usize; 2],
    /// Number of frames that arrived.
    arrived: usize,
    /// Index of the latest frame and its map, where it has a file.
    latest: (usize, Option<Vec<f32>>),
    /// Number of maps without depth to use.
    flat: usize,
    /// All frames since the key frame before in the form in which they are compared, where the choice of key frames
    /// requires it.
    truths: Option<Vec<Truth>>,
    /// Width and height at which frames are compared, from their own; a frame's own where there is none.
    placing: Option<Placing>,
    /// True if frames are also compared at their own size.
    whole: bool,
    /// PSNR of the images of earlier key frames' intervals.
    told: Option<Receiver<Found>>,
    /// Why the input ended early.
    damage: Option<String>,
    /// Number of key frames returned.
    given: usize,
    time: Duration,
    stop: Stop,
}

impl KeyFrames {
    /// The key frames of `source` that `gap` chooses, from at most `limit` frames. The last frame is a key frame,
    /// except with [`Keep::Everything`].
    pub fn new(source: Source, depth: KeyDepth, gap: Gap, keep: Keep, limit: Option<usize>, stop: &Stop) -> Self {
        let limit = limit.unwrap_or(usize::MAX);
        KeyFrames {
            source,
            damage: None,
            depth,
            groups: gap::KeyFrames::new(gap),
            keep,
            whole_gaps: keep == Keep::Everything && matches!(gap, Gap::Every(_)),
            limit,
            digest: InputDigest::default(),
            size: [0, 0],
            arrived: 0,
            latest: (0, None),
            flat: 0,
            truths: gap.depends_on_images().then(Vec::new),
            placing: None,
            whole: false,
            told: None,
            given: 0,
            time: Duration::ZERO,
            stop: stop.clone(),
        }
    }

    /// Compares images with frames, if at all, at the size that `placing` returns for frames of a width and height, and
    /// with `whole` at the frames' own size as well.
    pub fn compare_at(&mut self, placing: Placing, whole: bool) {
        (self.placing, self.whole) = (Some(placing), whole);
    }

    /// Repeats the choices of a stopped run, then continues.
    pub fn replay(&mut self, choices: &Choices) {
        self.groups.chooser().replay(choices.gaps.iter().copied(), choices.state.clone());
    }

    /// Sets the channel of measured PSNR, one message per key frame; returns whether it is used. The choice of a key
    /// frame uses the results up to the last key frame but one, and waits for them. So it does not depend on whether
    /// frames are read ahead.
    pub fn listen(&mut self, told: Receiver<Found>) -> bool {
        let wanted = self.truths.is_some();
        self.told = Some(told).filter(|_| wanted);
        wanted
    }

    /// State of the controller at the latest choice.
    pub fn state(&mut self) -> ControlState {
        self.groups.chooser().state()
    }

    /// Number of frames that can be expected, where it is known.
    pub fn total(&self) -> Option<usize> {
        match self.source.expected_frames() {
            Some(frames) => Some(frames.min(self.limit)),
            None => (self.limit != usize::MAX).then_some(self.limit),
        }
    }

    /// Frames per second.
    pub fn fps(&self) -> f64 {
        self.source.fps()
    }

    /// Account of the input read so far.
    pub fn account(&self) -> Reading {
        let network = self.depth.account();
        let mut notes = self.source.notes().to_vec();
        if self.flat > 0 {
            let (flat, frames) = (self.flat, self.digest.frames());
            notes.push(format!(
                "{flat} of {frames} depth maps hold no depth: nothing measured, or one value everywhere"
            ));
        }
        let looking = network.as_ref().map_or(Duration::ZERO, |network| network.time);
        Reading {
            frames: self.digest.frames(),
            blake3: self.digest.finish(),
            size: self.size,
            time: self.time.saturating_sub(looking),
            network,
            damage: self.damage.clone(),
            notes,
        }
    }

    /// Returns the next key frame.
    pub fn next_key(&mut self) -> Result<Option<KeyFrame>, Error> {
        if let Some(told) = &self.told
            && self.given >= 2
            && !self.groups.chooser().is_replaying()
        {
            // The sender is dropped once the consumer stops.
            told.recv().iter().for_each(|found| self.groups.chooser().learn(found));
        }
        let start = Instant::now();
        let _span = tracing::info_span!("decode").entered();
        let result = self.read();
        self.time += start.elapsed();
        self.given += 1;
        result
    }

    fn read(&mut self) -> Result<Option<KeyFrame>, Error> {
        let KeyFrames {
            source,
            depth,
            digest,
            size,
            truths,
            placing,
            whole,
            latest,
            flat,
            arrived,
            keep,
            limit,
            stop,
            damage,
            ..
        } = self;
        let arrive = || {
            if arrived == limit || damage.is_some() {
                return Ok(None);
            }
            *arrived += 1;
            match source.next_frame() {
                // The process that feeds us is stopped by the same Ctrl-C; its stream may end anywhere.
                Err(SourceError::Y4m { .. }) if stop.asked() => Ok(None),
                // The frames before are complete and are kept, except for comparisons. A stream that broke off may be
                // sent again, to resume.
                Err(e @ (SourceError::Y4m { .. } | SourceError::Damaged { .. }))
                    if *arrived > 1 && *keep != Keep::Everything && !source.is_stream() =>
                {
                    *damage = Some(e.to_string());
                    Ok(None)
                }
                Ok(None) if !stop.asked() => depth.ended(source, *arrived - 1).map(|()| None),
                next => Ok(next?),
            }
        };
        let taken = |waiting: &mut [TimedPicture]| {
            let [before @ .., frame] = waiting else { return Ok(()) };
            *size = [frame.picture.width, frame.picture.height];
            *latest = (frame.index, depth.of_file(frame.index, &frame.picture)?);
            *flat += usize::from(latest.1.as_ref().is_some_and(|map| depth.is_flat(map)));
            digest.add(&frame.picture, frame.timestamp, latest.1.as_deref());
            if let Some(truths) = truths {
                let compared = placing.as_ref().map_or(*size, |placing| placing(*size));
                truths.push(Truth::new(&frame.picture, frame.timestamp, compared, *whole));
            }
            // Only the last of them can still become a key frame.
            if *keep == Keep::Nothing
                && let Some(before) = before.last_mut()
            {
                before.picture = empty();
            }
            Ok::<_, Error>(())
        };
        match self.groups.next(arrive, taken)? {
            Some(group) if group.whole || !self.whole_gaps => self.key(group),
            _ => Ok(None),
        }
    }

    fn key(&mut self, Group { frames: mut shown, .. }: Group<TimedPicture>) -> Result<Option<KeyFrame>, Error> {
        let Some(frame) = shown.last_mut() else { return Ok(None) };
        let (width, height) = (frame.picture.width, frame.picture.height);
        let of_file = match self.latest.1.take() {
            Some(depth) if self.latest.0 == frame.index => Some(depth),
            _ => self.depth.of_file(frame.index, &frame.picture)?,
        };
        let depth = match of_file {
            Some(depth) => Some(depth),
            None => self.depth.of_network(&frame.picture)?,
        };
        let rgb = match self.keep {
            Keep::Everything => frame.picture.rgb.clone(),
            Keep::Nothing | Keep::Between => std::mem::replace(&mut frame.picture, empty()).rgb,
        };
        let truths = self.truths.as_mut().map(std::mem::take).unwrap_or_default();
        Ok(Some(KeyFrame { frame: Frame { width, height, rgb, depth }, shown, truths }))
    }
}

fn empty() -> Picture {
    Picture { width: 0, height: 0, rgb: Vec::new() }
}

//! Input frames to key frames: every gap-th frame, with its depth map, and the frames in between.

use std::path::Path;
use std::time::{Duration, Instant};

use streamsplat::Frame;
use streamsplat::depth::DepthMaps;
use streamsplat::picture::Picture;
use streamsplat::source::{Source, SourceError, TimedPicture};

use super::digest::InputDigest;
use super::failure::Failure;
use super::record::{InputRecord, absolute};
use super::settings::DepthFrom;

/// A key frame and what came since the one before.
pub struct KeyFrame {
    /// The key frame's picture and depth.
    pub frame: Frame,
    /// Input frames after the key frame before, this one last. Their pictures are empty unless they were asked for.
    pub shown: Vec<TimedPicture>,
}

/// Reads key frames one at a time.
pub struct KeyFrames {
    source: Source,
    depth: Option<DepthMaps>,
    gap: usize,
    keep_pictures: bool,
    limit: usize,
    digest: InputDigest,
    size: [usize; 2],
    pending: Vec<TimedPicture>,
    time: Duration,
    ended: bool,
}

impl KeyFrames {
    /// Every `gap`-th frame of `source`, at most `limit` frames in all. With `keep_pictures` the frames in between come with
    /// their pictures, and frames after the last whole gap are left out; otherwise the last frame is a key frame.
    pub fn new(
        source: Source,
        depth: &DepthFrom,
        gap: usize,
        keep_pictures: bool,
        limit: Option<usize>,
    ) -> Result<Self, Failure> {
        let limit = limit.unwrap_or(usize::MAX);
        let depth = match depth {
            DepthFrom::None => None,
            DepthFrom::Folder(folder, range) => Some(DepthMaps::open(folder, source.files(), *range)?),
        };
        Ok(KeyFrames {
            source,
            depth,
            gap,
            keep_pictures,
            limit,
            digest: InputDigest::default(),
            size: [0, 0],
            pending: Vec::new(),
            time: Duration::ZERO,
            ended: false,
        })
    }

    /// Frames there will be, where that is known.
    pub fn total(&self) -> Option<usize> {
        match self.source.frames() {
            Some(frames) => Some(frames.min(self.limit)),
            None => (self.limit != usize::MAX).then_some(self.limit),
        }
    }

    /// Frames per second.
    pub fn fps(&self) -> f64 {
        self.source.fps()
    }

    /// The digest of the frames read so far.
    pub fn digest(&self) -> &InputDigest {
        &self.digest
    }

    /// What was read so far, from `path`.
    pub fn input(&self, path: &Path) -> InputRecord {
        let (blake3, count) = (self.digest.finish(), self.digest.frames());
        InputRecord { path: absolute(path), blake3, count, size: self.size, fps: self.fps() }
    }

    /// Time spent reading.
    pub fn time(&self) -> Duration {
        self.time
    }

    /// The next key frame.
    pub fn next(&mut self) -> Result<Option<KeyFrame>, Failure> {
        let start = Instant::now();
        let _span = tracing::info_span!("stage", name = "decode").entered();
        let result = self.read();
        self.time += start.elapsed();
        result
    }

    fn read(&mut self) -> Result<Option<KeyFrame>, Failure> {
        while !self.ended && self.digest.frames() < self.limit {
            let next = match self.source.next_frame() {
                Ok(next) => next,
                // What feeds us is stopped by the same Ctrl-C; its stream may end anywhere.
                Err(SourceError::Y4m { .. }) if super::stop::asked() => None,
                Err(e) => return Err(e.into()),
            };
            let Some(frame) = next else { break };
            let (width, height) = (frame.picture.width, frame.picture.height);
            self.size = [width, height];
            let depth = self.depth.as_ref().map(|maps| maps.map(frame.index, width, height)).transpose()?;
            self.digest.add(&frame.picture, frame.timestamp, depth.as_deref());
            let is_key = frame.index % self.gap == 0;
            if is_key {
                return Ok(Some(self.key(frame, depth)));
            }
            // Only the last of them may still become a key frame.
            if !self.keep_pictures
                && let Some(before) = self.pending.last_mut()
            {
                before.picture = empty();
            }
            self.pending.push(frame);
        }
        self.ended = true;
        if self.keep_pictures {
            return Ok(None);
        }
        let Some(last) = self.pending.pop() else { return Ok(None) };
        let (width, height) = (last.picture.width, last.picture.height);
        let depth = self.depth.as_ref().map(|maps| maps.map(last.index, width, height)).transpose()?;
        Ok(Some(self.key(last, depth)))
    }

    fn key(&mut self, mut frame: TimedPicture, depth: Option<Vec<f32>>) -> KeyFrame {
        let (width, height) = (frame.picture.width, frame.picture.height);
        let mut shown = std::mem::take(&mut self.pending);
        let rgb = if self.keep_pictures {
            frame.picture.rgb.clone()
        } else {
            shown.iter_mut().for_each(|before| before.picture = empty());
            std::mem::replace(&mut frame.picture, empty()).rgb
        };
        shown.push(frame);
        KeyFrame { frame: Frame { width, height, rgb, depth }, shown }
    }
}

fn empty() -> Picture {
    Picture { width: 0, height: 0, rgb: Vec::new() }
}

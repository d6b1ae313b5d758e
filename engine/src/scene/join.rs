//! Scenes in time, joined one after another.
//!
//! A following scene keeps its own times if they begin after the end of the scenes before; otherwise it begins one
//! frame after that end. Its identities and key frames are numbered on from theirs.

use super::{Scene, SceneError};
use crate::stream::Interval;

/// State after the scenes so far, which the next one continues.
#[derive(Clone, Debug, Default)]
pub struct Join {
    end: Option<f64>,
    identities: u64,
    key_frames: u64,
}

/// Offsets of a scene's times, identities and key frames.
#[derive(Clone, Copy, Debug)]
struct Shift {
    time: f64,
    identities: u64,
    key_frames: u64,
}

/// The intervals of a scene, moved after those before, with the times of their frames where the index of the whole has
/// to list them.
pub struct Joined<'a> {
    join: &'a mut Join,
    scene: &'a Scene,
    shift: Shift,
    frames: std::iter::Peekable<std::vec::IntoIter<f64>>,
    next: usize,
}

impl Join {
    /// The intervals of the following scene, in a whole with `fps` frames per second. Intervals that are not taken from
    /// the iterator do not become part of it.
    pub fn follow<'a>(&'a mut self, scene: &'a Scene, fps: f64) -> Joined<'a> {
        let start = scene.span().0;
        let time = self.end.filter(|end| start <= *end).map_or(0.0, |end| end + 1.0 / fps - start);
        let shift = Shift { time, identities: self.identities, key_frames: self.key_frames };
        let frames = scene.index().frames().unwrap_or_default().into_iter().peekable();
        Joined { join: self, scene, shift, frames, next: 0 }
    }

    /// Moves an interval to its place, and counts its identities and key frames.
    fn moved(&mut self, interval: &mut Interval, shift: Shift) {
        interval.start += shift.time;
        interval.end += shift.time;
        interval.index += shift.key_frames;
        let gaussians = &mut interval.gaussians;
        let merged = interval.merges.iter_mut().flat_map(|merge| [&mut merge.identity, &mut merge.into]);
        for identity in gaussians.identity.iter_mut().chain(merged) {
            *identity += shift.identities;
            self.identities = self.identities.max(*identity + 1);
        }
        gaussians.birth.iter_mut().chain(&mut gaussians.frame).for_each(|frame| *frame += shift.key_frames);
        (self.end, self.key_frames) = (Some(interval.end), interval.index + 1);
    }
}

impl Iterator for Joined<'_> {
    /// An interval, and the times of its frames.
    type Item = Result<(Interval, Vec<f64>), SceneError>;

    fn next(&mut self) -> Option<Self::Item> {
        let entry = self.scene.index().intervals.get(self.next)?;
        let mut interval = match self.scene.interval(self.next) {
            Ok(interval) => interval,
            Err(error) => return Some(Err(error)),
        };
        self.next += 1;
        self.join.moved(&mut interval, self.shift);
        let own = std::iter::from_fn(|| self.frames.next_if(|time| *time <= entry.end));
        let frames = own.map(|time| time + self.shift.time).collect();
        Some(Ok((interval, frames)))
    }
}

//! State that a stream needs to resume.
//!
//! Embedding, tokens, condition and Gaussians of the last key frame are functions of that frame: they are computed
//! again, to the same bits. A [`ResumePoint`] holds the rest: the canonical set, which is the survivors and the
//! identities of the frame's Gaussians, and what earlier frames determine: depth, colours of covered surfaces, and
//! static blocks, for which the frame's picture and Gaussians are stored. Without static blocks it is small compared
//! with the results that need not be stored.

use std::sync::Arc;

use super::canonical::{CanonicalSet, Current};
use super::engine::State;
use super::identities::Identities;
use super::keep::KeptState;
use super::lift::{Covered, contradiction};
use super::{Engine, EngineError, Frame, Record, Reuse};
use crate::parallax::{Found, Window};

/// State of a stream at a key frame. With that frame it suffices to resume the stream ([`Engine::resume`]).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ResumePoint {
    /// The key frame.
    pub frame: u64,
    /// Its time, in seconds.
    pub timestamp: f64,
    /// Seconds of the interval that the key frame ends.
    pub length: f64,
    /// Older Gaussians that no frame continues, as they are at the key frame, oldest first.
    pub survivors: Vec<Record>,
    /// The frame's own Gaussians in the order in which they are drawn: ascending in `cell`, those that are kept first.
    pub current: Vec<Current>,
    /// The next unused identity.
    pub next_identity: u64,
    /// Factor and offset that bring the frame's depth map to the scale of the stream; `None` where it is not
    /// lifted.
    pub depth: Option<[f32; 2]>,
    /// Depth found by parallax for the frame; `None` where none was.
    pub found: Option<Found>,
    /// Where the frame's parts were in the key frames before, if depth is searched by parallax.
    pub window: Window,
    /// Colours of surfaces that earlier frames saw and that are now covered, ascending in `cell`.
    pub covered: Vec<Covered>,
    /// State kept from earlier key frames; `None` where there is none.
    pub kept: Option<Box<KeptState>>,
}

impl Engine {
    /// State at the last key frame; `None` before the first one, and where later results depend on more than that frame
    /// ([`Reuse::forgets`]).
    pub fn resume_point(&self) -> Option<ResumePoint> {
        self.state().filter(|_| self.settings().reuse.forgets()).map(|state| {
            let CanonicalSet { length, survivors, current, identities, .. } = &state.set;
            ResumePoint {
                frame: state.frame,
                timestamp: state.timestamp,
                length: *length,
                survivors: survivors.clone(),
                current: current.clone(),
                next_identity: identities.next(),
                depth: state.view.map.as_ref().map(|map| map.alignment.into()),
                found: state.found.clone(),
                window: state.window.clone(),
                covered: state.view.added.covered.clone(),
                kept: KeptState::of(&state.view).map(Box::new),
            }
        })
    }

    /// Resumes from `point`, whose key frame was `frame`. The intervals of later frames are bit for bit those of the
    /// engine that returned this point, as long as settings and model are the same.
    ///
    /// # Errors
    /// As [`Engine::push`]; and a point that does not fit the frame's Gaussians. The stream is then as it was before.
    pub fn resume(&mut self, point: &ResumePoint, frame: Frame) -> Result<(), EngineError> {
        let workers = self.workers().clone();
        workers.install(|| {
            let (placement, view) = self.see(frame, point)?;
            let kept = point.kept.as_ref().and_then(|kept| kept.contradiction(placement.model));
            let (gaussians, layers) = (Arc::clone(&view.gaussians), view.layers());
            let found = point.found.as_ref().and_then(|found| found.contradiction(placement.model));
            let window = point.window.contradiction(placement.model);
            let covered = contradiction(&point.covered, placement.model);
            if let Some(reason) =
                kept.or(found).or(window).or(covered).or_else(|| point.contradiction(gaussians.position.len()))
            {
                return Err(EngineError::ResumePoint { index: point.frame, reason });
            }
            let set = CanonicalSet {
                frame: point.frame,
                length: point.length,
                survivors: point.survivors.clone(),
                current: point.current.clone(),
                gaussians,
                layers,
                identities: Identities::from(point.next_identity),
            };
            let (frame, timestamp) = (point.frame, point.timestamp);
            let (found, window) = (point.found.clone(), point.window.clone());
            self.set_state(State { frame, timestamp, placement, view, pair: None, set, found, window });
            Ok(())
        })
    }
}

impl ResumePoint {
    /// Returns true if no index occurs twice.
    fn each_once(&self, gaussians: usize) -> bool {
        let mut taken = vec![false; gaussians];
        self.current.iter().all(|current| !std::mem::replace(&mut taken[current.cell as usize], true))
    }

    /// Returns why this cannot be the state at a frame with this number of Gaussians.
    fn contradiction(&self, gaussians: usize) -> Option<String> {
        if !(self.length.is_finite() && self.length >= 0.0) {
            return Some(format!("expected an interval of some length, found {} s", self.length));
        }
        if let Some(depth) = self.depth.filter(|depth| !depth.iter().all(|x| x.is_finite())) {
            return Some(format!("expected a finite scale and shift of depth, found {depth:?}"));
        }
        if let Some(survivor) = self.survivors.iter().find(|r| !r.is_sound() || r.frame > self.frame) {
            return Some(format!("expected survivors with finite numbers from earlier frames, found {survivor:?}"));
        }
        let ascending = self.current.windows(2).all(|pair| pair[0].cell < pair[1].cell);
        let inside = self.current.iter().all(|current| (current.cell as usize) < gaussians);
        if !inside || !(ascending || self.kept.is_some() && self.each_once(gaussians)) {
            return Some(format!("expected ascending places among {gaussians} Gaussians"));
        }
        let unsound = |current: &&Current| self.kept.as_ref().is_some_and(|kept| !kept.is_sound(current.cell as usize));
        if let Some(current) = self.current.iter().find(unsound) {
            return Some(format!("expected finite numbers of kept Gaussians, found others in place {}", current.cell));
        }
        let identities = self.survivors.iter().map(|r| r.identity).chain(self.current.iter().map(|c| c.identity));
        let newest = identities.max();
        newest
            .filter(|newest| *newest >= self.next_identity)
            .map(|newest| format!("expected identities under {}, found {newest}", self.next_identity))
    }
}

impl Reuse {
    /// Returns true if results computed from a key frame depend only on that frame and a [`ResumePoint`].
    pub fn forgets(self) -> bool {
        match self {
            Reuse::Off | Reuse::Exact => true,
            Reuse::Within(_) => false,
        }
    }
}

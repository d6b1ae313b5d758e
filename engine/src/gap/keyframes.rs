//! Grouping of input frames that ends each group at a key frame.

use std::convert::Infallible;
use std::mem::take;

use super::{Choice, Chooser, Gap};
use crate::picture::Picture;

/// Groups frames as they arrive: each group holds the frames since the key frame before, the next key frame last.
///
/// A frame may be anything that has a picture. The caller may empty the pictures of waiting frames, except for that of
/// the last one.
pub struct KeyFrames<F> {
    chooser: Chooser,
    waiting: Vec<F>,
    /// A frame whose arrival made the one before it a key frame.
    ahead: Option<F>,
    ended: bool,
}

/// Frames up to a key frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Group<F> {
    /// The frames in order, at least one.
    pub frames: Vec<F>,
    /// False for the rest at the end of the input, whose last frame is a key frame only because no other follows.
    pub whole: bool,
}

impl<F: AsRef<Picture>> KeyFrames<F> {
    /// Groups that end at the key frames of `gap`.
    pub fn new(gap: Gap) -> Self {
        KeyFrames { chooser: Chooser::new(gap), waiting: Vec::new(), ahead: None, ended: false }
    }

    /// The chooser of key frames.
    pub fn chooser(&mut self) -> &mut Chooser {
        &mut self.chooser
    }

    /// Returns the next group. `arrive` returns the input's next frame. `taken` is called with the waiting frames each
    /// time a frame joins the group, as the last of them.
    ///
    /// # Errors
    /// Those of `arrive` and `taken`.
    pub fn next<E>(
        &mut self,
        mut arrive: impl FnMut() -> Result<Option<F>, E>,
        mut taken: impl FnMut(&mut [F]) -> Result<(), E>,
    ) -> Result<Option<Group<F>>, E> {
        while !self.ended {
            let (frame, choice) = match self.ahead.take() {
                Some(frame) => (frame, Choice::Wait),
                None => match arrive()? {
                    Some(frame) => {
                        let choice = self.chooser.next(frame.as_ref());
                        (frame, choice)
                    }
                    None => {
                        self.ended = true;
                        break;
                    }
                },
            };
            if choice == Choice::Before {
                self.ahead = Some(frame);
                return Ok(Some(Group { frames: take(&mut self.waiting), whole: true }));
            }
            self.waiting.push(frame);
            taken(&mut self.waiting)?;
            if choice == Choice::This {
                return Ok(Some(Group { frames: take(&mut self.waiting), whole: true }));
            }
        }
        let frames = take(&mut self.waiting);
        Ok((!frames.is_empty()).then_some(Group { frames, whole: false }))
    }
}

/// Groups of frames that are all available.
pub fn grouped<F: AsRef<Picture>>(gap: Gap, frames: impl IntoIterator<Item = F>) -> impl Iterator<Item = Group<F>> {
    let (mut keys, mut frames) = (KeyFrames::new(gap), frames.into_iter());
    std::iter::from_fn(move || {
        let Ok(group) = keys.next(|| Ok::<_, Infallible>(frames.next()), |_| Ok(()));
        group
    })
}

//! Key frames read on demand, or one ahead on a separate thread.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::mpsc::{Receiver, Sender, channel, sync_channel};

use crate::gap::{ControlState, Found};

use crate::run::Error;
use crate::run::choices::Choices;
use crate::run::closeness::Closeness;
use crate::run::keyframes::{KeyFrame, KeyFrames, Reading};
use crate::run::record::{InputRecord, absolute};

type Message = Result<(Option<KeyFrame>, Reading, ControlState), Error>;

/// Reader of key frames. They are the same on demand and ahead.
pub struct Ahead {
    from: From,
    total: Option<usize>,
    fps: f64,
    account: Reading,
    /// Key frames returned but not taken up: account of the input up to them, frames since the key frame before, and
    /// state of the controller.
    returned: VecDeque<(Reading, Option<usize>, ControlState)>,
    /// Account of the whole input, once it has ended.
    last: Option<Reading>,
    /// PSNR sender and choices so far, where key frames depend on the PSNR; `None` for fixed gaps.
    choices: Option<(Sender<Found>, Choices)>,
    /// True if a key frame has been returned.
    started: bool,
}

enum From {
    /// Read on demand.
    Here(Box<KeyFrames>),
    /// The next one is read, and its depth computed, while the one before is processed.
    Thread(Receiver<Message>),
    /// There are none left.
    Ended,
}

impl Ahead {
    /// Frames are read ahead if there is more than one thread.
    pub fn new(keys: KeyFrames, threads: usize) -> Ahead {
        Ahead::resume(keys, threads, None)
    }

    /// [`Ahead::new`] after these choices, which are repeated first.
    pub fn resume(mut keys: KeyFrames, threads: usize, choices: Option<&Choices>) -> Ahead {
        let (total, fps, account) = (keys.total(), keys.fps(), keys.account());
        let (teller, told) = channel();
        if let Some(choices) = choices {
            keys.replay(choices);
            // The receiver still exists here.
            choices.recent().for_each(|found| _ = teller.send(found));
        }
        let before = choices.map(Choices::replayed).unwrap_or_default();
        let choices = keys.listen(told).then_some((teller, before));
        let from = match threads > 1 {
            false => From::Here(Box::new(keys)),
            true => From::Thread(start(keys)),
        };
        Ahead { from, total, fps, account, returned: VecDeque::new(), last: None, choices, started: false }
    }

    /// Sends how close the images of the latest key frame's interval are to its frames.
    pub fn tell(&mut self, found: &Found, closeness: &Closeness) {
        if let Some((teller, choices)) = &mut self.choices {
            choices.found(found, closeness.total());
            // Once the reader has ended there is nothing left to choose.
            let _ = teller.send(*found);
        }
    }

    /// Enters the earliest key frame that was returned and not taken up yet in the account and the choices.
    pub fn take_up(&mut self) {
        let Some((account, gap, state)) = self.returned.pop_front() else { return };
        self.account = account;
        if let Some((_, choices)) = &mut self.choices {
            choices.add(gap, state);
        }
    }

    /// Enters what was read after the last key frame in the account.
    pub fn end(&mut self) {
        if let Some(account) = self.last.take() {
            self.account = account;
        }
    }

    /// Key frames taken up so far, where the choice depends on the PSNR of the images.
    pub fn choices(&self) -> Option<&Choices> {
        self.choices.as_ref().map(|(_, choices)| choices)
    }

    /// Number of frames, where it is known.
    pub fn total(&self) -> Option<usize> {
        self.total
    }

    /// Frames per second.
    pub fn fps(&self) -> f64 {
        self.fps
    }

    /// Input read up to the latest key frame that was taken up, or all of it after [`Ahead::end`].
    pub fn account(&self) -> &Reading {
        &self.account
    }

    /// The input's record; `path` is where it was read.
    pub fn input(&self, path: &Path) -> InputRecord {
        let Reading { frames, blake3, size, damage, .. } = &self.account;
        let (path, blake3, damage) = (absolute(path), blake3.clone(), damage.clone());
        InputRecord { path, blake3, count: *frames, size: *size, fps: self.fps, damage }
    }

    /// Returns the next key frame.
    pub fn next_key(&mut self) -> Result<Option<KeyFrame>, Error> {
        let message = match &mut self.from {
            From::Here(keys) => keys.next_key().map(|key| (key, keys.account(), keys.state())),
            From::Thread(receiver) => {
                receiver.recv().unwrap_or_else(|_| Err(Error::work("the thread that reads frames has ended early")))
            }
            From::Ended => return Ok(None),
        };
        let (key, account, state) = message?;
        match &key {
            Some(key) => {
                let gap = self.started.then_some(key.shown.len());
                self.returned.push_back((account, gap, state));
                self.started = true;
            }
            None => {
                self.from = From::Ended;
                self.last = Some(account);
            }
        }
        Ok(key)
    }
}

/// Starts the reader thread. It holds at most one undelivered key frame, and exits at the end of the input or when the
/// receiver is dropped.
fn start(mut keys: KeyFrames) -> Receiver<Message> {
    let (sender, receiver) = sync_channel(0);
    std::thread::spawn(move || {
        loop {
            let message = keys.next_key().map(|key| (key, keys.account(), keys.state()));
            let last = !matches!(message, Ok((Some(_), ..)));
            if sender.send(message).is_err() || last {
                return;
            }
        }
    });
    receiver
}

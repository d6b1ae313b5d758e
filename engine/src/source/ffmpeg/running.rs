//! A running ffmpeg process: pictures from its standard output, their times and properties from its standard error.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, ChildStderr, ChildStdout};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use super::program::Decoding;
use super::shown::{self, Look, Message};

/// Longest line of messages read, in bytes.
const MAX_LINE: u64 = 1 << 16;
/// Number of error messages that are kept.
const KEPT: usize = 16;
/// Time limit for the message on a frame's colours, which versions before 4.1 do not print.
const PATIENCE: Duration = Duration::from_secs(10);

/// The process and its messages.
pub(super) struct Running {
    child: Child,
    messages: Receiver<Message>,
    numbers: Numbers,
    /// Number and time stamp of a later frame, received because an earlier frame's message is missing.
    early: Option<(usize, Option<i64>)>,
    complaints: Option<JoinHandle<Complaints>>,
    first: First,
    /// Names of properties whose changes are told already, or do not matter.
    pub(super) told: Vec<&'static str>,
    /// Notes on frames that differ from the first.
    pub(super) notes: Vec<String>,
}

/// Frame numbers since the start. ffmpeg restarts its count when it rebuilds its filters, for example for frames of
/// another size.
#[derive(Clone, Copy, Debug, Default)]
struct Numbers {
    /// The number of the first frame since the last restart.
    base: usize,
    /// The last number that ffmpeg printed.
    last: Option<usize>,
}

impl Numbers {
    fn since_the_start(&mut self, number: usize) -> usize {
        if let Some(last) = self.last.filter(|last| number <= *last) {
            self.base += last + 1;
        }
        self.last = Some(number);
        self.base + number
    }
}

/// Error messages of ffmpeg.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Complaints {
    /// The first messages, at most [`KEPT`].
    pub(super) first: Vec<String>,
    pub(super) count: usize,
}

/// Values known after the first frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct First {
    /// Seconds per tick; `rate`: frames per second.
    pub(super) tick: Option<(u32, u32)>,
    pub(super) rate: Option<(u32, u32)>,
    /// The first frame's time stamp, if it has one.
    pub(super) time: Option<i64>,
    pub(super) size: (usize, usize),
    pub(super) look: Look,
}

impl Running {
    /// Starts the process and waits for the first frame. The caller reads the pictures from the returned pipe.
    pub(super) fn start(decoding: &Decoding, path: &Path) -> std::io::Result<(Running, ChildStdout, Option<First>)> {
        let mut child = decoding.start(path)?;
        let no_pipe = || std::io::Error::other("no pipe to it");
        let stdout = child.stdout.take().ok_or_else(no_pipe)?;
        let stderr = child.stderr.take().ok_or_else(no_pipe)?;
        let (sender, messages) = channel();
        // A separate thread reads the messages: a full pipe of messages would block the frames as well.
        let complaints = Some(std::thread::spawn(move || listen(stderr, &sender)));
        let mut running = Running {
            child,
            messages,
            numbers: Numbers::default(),
            early: None,
            complaints,
            first: First::default(),
            told: Vec::new(),
            notes: Vec::new(),
        };
        let first = running.first();
        running.first = first.clone().unwrap_or_default();
        Ok((running, stdout, first))
    }

    /// Returns the properties of the first frame; `None` if there is no frame.
    fn first(&mut self) -> Option<First> {
        let mut first = First::default();
        loop {
            match self.messages.recv().ok()? {
                Message::Config { tick, rate } => (first.tick, first.rate) = (Some(tick), rate),
                Message::Frame { number, time, size, look } => {
                    self.numbers.since_the_start(number);
                    (first.time, first.size, first.look) = (time, size, look);
                    break;
                }
                _ => {}
            }
        }
        if let Ok(Message::Colours(tags)) = self.messages.recv_timeout(PATIENCE) {
            first.look.tags = tags;
        }
        Some(first)
    }

    /// Returns the time stamp of the frame with this number, whose picture has been read; `None` if it has no message.
    /// Notes properties of frames that differ from the first's. Frames are read as the first; newer versions of ffmpeg
    /// convert their matrix and range to the first's.
    pub(super) fn frame(&mut self, wanted: usize) -> Option<Option<i64>> {
        loop {
            let (number, time) = match self.early.take() {
                Some(early) => early,
                None => match self.messages.recv().ok()? {
                    Message::Frame { number, time, size, look } => {
                        let number = self.numbers.since_the_start(number);
                        if size != self.first.size && self.is_news("the size") {
                            self.notes.push(format!(
                                "frames have another size from frame {number} on; they were brought to that of the first"
                            ));
                        }
                        self.compare(&Look { tags: self.first.look.tags.clone(), ..look });
                        (number, time)
                    }
                    Message::Colours(tags) => {
                        self.compare(&Look { tags, ..self.first.look.clone() });
                        continue;
                    }
                    _ => continue,
                },
            };
            if number > wanted {
                self.early = Some((number, time));
                return None;
            }
            if number == wanted {
                return Some(time);
            }
        }
    }

    /// Notes what differs between the latest frame and the first.
    fn compare(&mut self, look: &Look) {
        let number = self.numbers.base + self.numbers.last.unwrap_or_default();
        let mut found = look.differing(&self.first.look);
        found.retain(|(name, ..)| self.is_news(name));
        let found: Vec<String> =
            found.into_iter().map(|(name, here, first)| format!("{name} {here} instead of {first}")).collect();
        if !found.is_empty() {
            let found = found.join(", ");
            self.notes
                .push(format!("from frame {number} on: {found}; only newer versions of ffmpeg convert these frames"));
        }
    }

    fn is_news(&mut self, name: &'static str) -> bool {
        let news = !self.told.contains(&name);
        self.told.extend(news.then_some(name));
        news
    }

    /// Waits for the process to end; returns whether it succeeded, and its messages.
    pub(super) fn end(&mut self) -> std::io::Result<(bool, Complaints)> {
        let status = self.child.wait()?;
        let complaints = self.complaints.take().and_then(|thread| thread.join().ok()).unwrap_or_default();
        // The colours of the last frame are printed after it.
        self.frame(usize::MAX);
        Ok((status.success(), complaints))
    }

    /// Stops the process.
    pub(super) fn kill(&mut self) {
        let _ = self.child.kill();
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // A process that is still writing would wait forever on a full pipe.
        self.kill();
        let _ = self.child.wait();
    }
}

/// Sends the messages on frames to `sender` and collects the errors.
fn listen(stderr: ChildStderr, sender: &Sender<Message>) -> Complaints {
    let mut found = Complaints::default();
    let mut input = BufReader::new(stderr);
    let mut line = Vec::new();
    while let Ok(1..) = Read::by_ref(&mut input).take(MAX_LINE).read_until(b'\n', &mut line) {
        let text = String::from_utf8_lossy(&line).into_owned();
        line.clear();
        for message in shown::messages(text.trim_end()).into_iter().map(Message::parse) {
            match message {
                Message::Complaint(text) => {
                    found.count += 1;
                    if found.first.len() < KEPT {
                        found.first.push(text);
                    }
                }
                Message::Other => {}
                // The receiver may be gone; errors still count.
                message => _ = sender.send(message),
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_numbered_on_where_filters_are_set_up_again() {
        let mut numbers = Numbers::default();
        let found = [0, 1, 3, 0, 1, 0].map(|number| numbers.since_the_start(number));
        // One message is missing.
        assert_eq!(found, [0, 1, 3, 4, 5, 6]);
    }
}

//! Resuming: from the start of the input to the point at which a run was stopped.

use crate::Frame;
use crate::stream::{Interval, ResumePoint};

use crate::run::Error;
use crate::run::record::InputRecord;
use crate::run::resume_state::Point;
use crate::run::session::Session;

/// Brings a new session to `point`. Reads the input up to there and computes the last whole interval again. Also draws
/// its last image again, without writing it, so that the next image finds the same tiles to reuse.
pub fn catch_up(stream: &mut Session, point: &Point, resume: Option<&ResumePoint>) -> Result<(), Error> {
    let mut before: Option<Frame> = None;
    let mut last = None;
    for index in 0..=point.key {
        let Some(mut key) = stream.delivery.keys.next_key()? else {
            stream.delivery.keys.end();
            let (expected, found) = (point.input.count, stream.delivery.keys.account().frames);
            let name = point.input.path.display();
            return Err(Error::work(format!(
                "--resume: the input: recorded {expected} frames of {name}, found {found}"
            )));
        };
        stream.delivery.keys.take_up();
        key.shown.iter().for_each(|_| stream.progress());
        let Some(timestamp) = key.shown.last().map(|frame| frame.timestamp) else { continue };
        if index == point.key {
            check_input(stream, point)?;
        }
        match resume {
            Some(resume) if index < resume.frame => {}
            Some(resume) if index == resume.frame => before = Some(key.frame),
            _ => {
                if let Some((resume, frame)) = resume.zip(before.take()) {
                    stream.engine.resume(resume, frame)?;
                }
                let between = key.take_between();
                last = Some((stream.engine.push_with(between, key.frame, timestamp)?, key.shown));
            }
        }
    }
    let Some((interval, shown)) = last else {
        return Err(Error::work("--resume: state.safetensors: expected a resume point before the last whole interval"));
    };
    if let Some(outputs) = &mut stream.delivery.outputs {
        outputs.take_up(stream.delivery.keys.fps(), &interval, point.video.as_ref())?;
    }
    stream.delivery.times = point.times;
    let drawn = match &stream.delivery.views.times {
        None => shown.last().map(|frame| (frame.index, frame.timestamp)),
        Some(asked) => point.times.checked_sub(1).and_then(|i| Some((i, *asked.get(i)?))),
    };
    stream.delivery.drawing.anchor = point.anchor;
    if stream.delivery.emit.draws()
        && let Some((index, time)) = drawn.filter(|(_, time)| holds(&interval, *time))
    {
        stream.delivery.drawing.draw(&interval, index, time, &stream.delivery.views)?;
    }
    stream.delivery.drawing.counts = point.drawn.clone();
    stream.account.restart(point.work.clone(), stream.engine.work());
    stream.delivery.dropped = point.dropped;
    stream.delivery.span = Some(point.span);
    stream.delivery.key = point.key + 1;
    Ok(())
}

fn holds(interval: &Interval, time: f64) -> bool {
    interval.relative(time).is_some()
}

/// Returns an error unless the frames read so far are those of the stopped run.
fn check_input(stream: &Session, point: &Point) -> Result<(), Error> {
    let (expected, found) = (&point.input, stream.delivery.keys.input(&point.input.path));
    if expected.blake3 == found.blake3 && expected.count == found.count && expected.fps == found.fps {
        return Ok(());
    }
    let of = |input: &InputRecord| format!("{} frames with the digest {}", input.count, input.blake3);
    let name = point.input.path.display();
    let message = format!("--resume: the input: recorded {} from {name}, found {}", of(expected), of(&found));
    Err(Error::work(message))
}

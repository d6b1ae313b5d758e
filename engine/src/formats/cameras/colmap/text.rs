//! The text form of a model: a line per record; `#` starts a comment.

use std::collections::BTreeMap;
use std::str::{FromStr, SplitWhitespace};

use super::rigs::{Frame, Rig, Rigs};
use super::{Extrinsics, Intrinsics, Rigid};
use crate::formats::FormatError;

/// Returns the error of a line; `expected` is the expected record.
fn line(file: &str, at: usize, expected: &str) -> FormatError {
    FormatError::new(format!("{file}, line {}", at + 1), expected, "another")
}

fn utf8<'a>(file: &str, bytes: &'a [u8]) -> Result<&'a str, FormatError> {
    let text =
        std::str::from_utf8(bytes).map_err(|_| FormatError::new(file.to_owned(), "text in UTF-8", "other bytes"))?;
    Ok(text.strip_prefix('\u{feff}').unwrap_or(text))
}

fn holds_something(line: &str) -> bool {
    let line = line.trim();
    !line.is_empty() && !line.starts_with('#')
}

fn number<T: FromStr>(word: Option<&str>) -> Option<T> {
    word?.parse().ok()
}

fn rigid(words: &mut SplitWhitespace<'_>) -> Option<Rigid> {
    let mut numbers = [0.0; 7];
    for value in &mut numbers {
        *value = number(words.next())?;
    }
    Some(Rigid::new(numbers))
}

pub(super) fn cameras(bytes: &[u8]) -> Result<BTreeMap<u32, Intrinsics>, FormatError> {
    let text = utf8("cameras.txt", bytes)?;
    let mut cameras = BTreeMap::new();
    for (at, own) in text.lines().enumerate().filter(|(_, line)| holds_something(line)) {
        let fail = || line("cameras.txt", at, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]");
        let mut words = own.split_whitespace();
        let id: u32 = number(words.next()).ok_or_else(fail)?;
        let model = words.next().ok_or_else(fail)?.to_owned();
        let size = [number(words.next()).ok_or_else(fail)?, number(words.next()).ok_or_else(fail)?];
        let parameters: Option<Vec<f64>> = words.map(|word| number(Some(word))).collect();
        cameras.insert(id, Intrinsics { model, size, parameters: parameters.ok_or_else(fail)? });
    }
    Ok(cameras)
}

pub(super) fn images(bytes: &[u8]) -> Result<Vec<Extrinsics>, FormatError> {
    let text = utf8("images.txt", bytes)?;
    let mut images = Vec::new();
    let mut lines = text.lines().enumerate();
    while let Some((at, own)) = lines.next() {
        if !holds_something(own) {
            continue;
        }
        let fail = || line("images.txt", at, "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME");
        let mut rest = own.trim();
        let mut word = || {
            let (word, after) = rest.split_once(char::is_whitespace)?;
            rest = after.trim_start();
            Some(word)
        };
        let id: u32 = number(word()).ok_or_else(fail)?;
        let mut numbers = [0.0; 7];
        for value in &mut numbers {
            *value = number(word()).ok_or_else(fail)?;
        }
        let camera = number(word()).ok_or_else(fail)?;
        images.push(Extrinsics { id, name: rest.to_owned(), pose: Rigid::new(numbers), camera });
        // The points seen in the image; this line may be empty.
        lines.next();
    }
    Ok(images)
}

pub(super) fn rigs([rigs, frames]: [&[u8]; 2]) -> Result<Rigs, FormatError> {
    let (rigs, frames) = (utf8("rigs.txt", rigs)?, utf8("frames.txt", frames)?);
    let mut all = BTreeMap::new();
    for (at, own) in rigs.lines().enumerate().filter(|(_, line)| holds_something(line)) {
        let expected =
            "RIG_ID NUM_SENSORS REF_SENSOR_TYPE REF_SENSOR_ID SENSORS[] as SENSOR_TYPE SENSOR_ID HAS_POSE [POSE]";
        let (id, rig) = rig(own).ok_or_else(|| line("rigs.txt", at, expected))?;
        all.insert(id, rig);
    }
    let mut moments = Vec::new();
    for (at, own) in frames.lines().enumerate().filter(|(_, line)| holds_something(line)) {
        let expected = "FRAME_ID RIG_ID QW QX QY QZ TX TY TZ NUM_DATA_IDS DATA_IDS[] as SENSOR_TYPE SENSOR_ID DATA_ID";
        moments.push(frame(own).ok_or_else(|| line("frames.txt", at, expected))?);
    }
    Ok(Rigs::new(all, moments))
}

/// Reads a sensor; returns the number of a camera, `Some(None)` for another sensor.
fn sensor(words: &mut SplitWhitespace<'_>) -> Option<Option<u32>> {
    let kind = words.next()?;
    let id = number(words.next())?;
    Some((kind == "CAMERA").then_some(id))
}

fn rig(line: &str) -> Option<(u32, Rig)> {
    let mut words = line.split_whitespace();
    let id = number(words.next())?;
    let count: u32 = number(words.next())?;
    let mut rig = Rig::default();
    for i in 0..count {
        let sensor = sensor(&mut words)?;
        if i == 0 {
            rig.reference = sensor;
            continue;
        }
        let pose = match words.next()? {
            "0" => None,
            _ => Some(rigid(&mut words)?),
        };
        rig.others.extend(sensor.map(|camera| (camera, pose)));
    }
    Some((id, rig))
}

fn frame(line: &str) -> Option<Frame> {
    let mut words = line.split_whitespace();
    let _id: u32 = number(words.next())?;
    let rig = number(words.next())?;
    let pose = rigid(&mut words)?;
    let count: u32 = number(words.next())?;
    let mut images = Vec::new();
    for _ in 0..count {
        let sensor = sensor(&mut words)?;
        let image = number(words.next())?;
        images.extend(sensor.map(|camera| (camera, image)));
    }
    Some(Frame { rig, pose, images })
}

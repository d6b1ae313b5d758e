//! OpenEXR: every part, every channel and every resolution level, with their windows.

use std::io::Cursor;
use std::path::Path;

use ::exr::prelude::*;

use super::{Channel, Part, Parts, Samples, Windows};
use crate::picture::{MAX_PIXELS, size_is_allowed};
use crate::source::SourceError;
use crate::source::decode::decode_error;

/// Most samples of all channels of all parts.
const MAX_SAMPLES: usize = 4 * MAX_PIXELS;

pub(super) fn read(bytes: Vec<u8>, path: &Path) -> std::result::Result<Parts, SourceError> {
    let broken = |e: ::exr::error::Error| decode_error(path, format!("not a readable EXR file: {e}"));
    let meta = MetaData::read_from_buffered(Cursor::new(&bytes), false).map_err(broken)?;
    let mut sum = 0_usize;
    for header in &meta.headers {
        let Vec2(width, height) = header.layer_size;
        if !size_is_allowed(width, height) {
            return Err(SourceError::TooLarge { path: path.to_owned(), width, height });
        }
        if header.deep {
            return Err(decode_error(path, "expected flat EXR parts, found one of deep samples"));
        }
        // Smaller levels hold at most three times as many samples again.
        sum = sum.saturating_add(header.channels.list.len().saturating_mul(width * height));
        if sum > MAX_SAMPLES {
            return Err(decode_error(path, format!("expected at most {MAX_SAMPLES} samples in all parts, found more")));
        }
    }
    let reading =
        ::exr::prelude::read().no_deep_data().all_resolution_levels().all_channels().all_layers().all_attributes();
    let image = reading.non_parallel().from_buffered(Cursor::new(&bytes)).map_err(broken)?;
    let bounds = |position: Vec2<i32>, size: Vec2<usize>| {
        [i64::from(position.0), i64::from(position.1), size.0 as i64, size.1 as i64]
    };
    let display = image.attributes.display_window;
    let display = bounds(display.position, display.size);
    let only = image.layer_data.len() == 1;
    let mut parts = Vec::new();
    for (at, layer) in image.layer_data.into_iter().enumerate() {
        let name = layer.attributes.layer_name.as_ref().map(ToString::to_string);
        let name = match name.filter(|name| !name.is_empty()) {
            Some(name) => format!("part {name}"),
            None if only => String::new(),
            None => format!("part {at}"),
        };
        let windows = Windows { data: bounds(layer.attributes.layer_position, layer.size), display };
        levels(&name, windows, layer.channel_data.list.into_iter(), &mut parts);
    }
    if parts.iter().any(|part: &Part| part.channels.is_empty()) || parts.is_empty() {
        return Err(decode_error(path, "expected channels in every EXR part, found a part without any"));
    }
    Ok(Box::new(parts.into_iter().map(Ok)))
}

/// Adds the levels of a part.
fn levels(
    name: &str,
    windows: Windows,
    channels: impl Iterator<Item = AnyChannel<Levels<FlatSamples>>>,
    parts: &mut Vec<Part>,
) {
    let first = parts.len();
    for channel in channels {
        let AnyChannel { name: channel, sample_data, sampling, .. } = channel;
        let channel = channel.to_string();
        // Sizes of the levels, largest first; for rip maps, row by row.
        let full = [windows.data[2] as usize, windows.data[3] as usize];
        let smaller = |side: usize, level: usize, up: bool| {
            let divisor = 1_usize << level;
            (if up { side.div_ceil(divisor) } else { side / divisor }).max(1)
        };
        let sized: Vec<([usize; 2], FlatSamples)> = match sample_data {
            Levels::Singular(samples) => vec![(full, samples)],
            Levels::Mip { rounding_mode, level_data } => {
                let up = rounding_mode == ::exr::math::RoundingMode::Up;
                let size = |level| full.map(|side| smaller(side, level, up));
                level_data.into_iter().enumerate().map(|(level, samples)| (size(level), samples)).collect()
            }
            Levels::Rip { rounding_mode, level_data } => {
                let up = rounding_mode == ::exr::math::RoundingMode::Up;
                let across = level_data.level_count.0.max(1);
                let size = |at: usize| [smaller(full[0], at % across, up), smaller(full[1], at / across, up)];
                level_data.map_data.into_iter().enumerate().map(|(at, samples)| (size(at), samples)).collect()
            }
        };
        for (level, ([width, height], samples)) in sized.into_iter().enumerate() {
            if parts.len() <= first + level {
                let name = match level {
                    0 => name.to_owned(),
                    level => format!("{name} level {level}").trim_start().to_owned(),
                };
                parts.push(Part {
                    name,
                    width,
                    height,
                    channels: Vec::new(),
                    premultiplied: true,
                    windows: Some(windows),
                    shown: None,
                    notes: Vec::new(),
                });
            }
            let samples = match samples {
                FlatSamples::F16(v) => Samples::F16(v),
                FlatSamples::F32(v) => Samples::F32(v),
                FlatSamples::U32(v) => Samples::Whole(v),
            };
            let (width, height) = (width.div_ceil(sampling.0.max(1)), height.div_ceil(sampling.1.max(1)));
            // If a data window begins between the samples of a subsampled channel, the channel has one sample less per
            // side.
            let (width, height) = if samples.len() == width * height { (width, height) } else { (samples.len(), 1) };
            parts[first + level].channels.push(Channel { name: channel.clone(), width, height, samples });
        }
    }
}

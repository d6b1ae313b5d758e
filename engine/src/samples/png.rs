//! PNG and APNG: the picture, or each frame as it is shown. A default picture that is not part of the animation comes
//! first.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use ::png::{BitDepth, BlendOp, DecodingError, DisposeOp, FrameControl, Reader, Transformations};
use image::metadata::Orientation;

use super::orientation::oriented;
use super::{Part, Parts, Samples, one};
use crate::source::SourceError;
use crate::source::decode::{check_size, decode_error, png_can_hold};

/// Most memory of a decoder, in bytes.
const MAX_ALLOC: usize = 1 << 30;

pub(super) fn read(bytes: Vec<u8>, path: &Path) -> Result<Parts, SourceError> {
    let broken = |e: DecodingError| decode_error(path, format!("broken or unsupported Png image: {e}"));
    let limits = ::png::Limits { bytes: MAX_ALLOC };
    let header = bytes.clone();
    let mut decoder = ::png::Decoder::new_with_limits(Cursor::new(bytes), limits);
    decoder.set_transformations(Transformations::EXPAND);
    let info = decoder.read_header_info().map_err(broken)?;
    let (width, height) = (info.width, info.height);
    check_size(path, width as usize, height as usize)?;
    let mut reader = decoder.read_info().map_err(broken)?;
    let orientation = reader.info().exif_metadata.as_deref().and_then(Orientation::from_exif_chunk);
    let orientation = orientation.unwrap_or(Orientation::NoTransforms);
    let Some(animation) = reader.info().animation_control().copied() else {
        if !png_can_hold(&header, u64::from(width), u64::from(height)) {
            let found = header.len();
            return Err(decode_error(
                path,
                format!("{found} bytes of PNG cannot hold the {width}×{height} pixels they promise"),
            ));
        }
        let (part, _) = picture(&mut reader).map_err(broken)?;
        reader.finish().map_err(broken)?;
        return Ok(one(oriented(part, orientation)));
    };
    // A first picture without a frame control chunk is not part of the animation: viewers without APNG show it.
    let lonely = reader.info().frame_control().is_none();
    Ok(Box::new(Frames {
        reader,
        path: path.to_owned(),
        orientation,
        canvas: None,
        lonely,
        next: 0,
        count: animation.num_frames,
        start: 0.0,
        ended: false,
    }))
}

/// Reads the next picture of a file, and its frame control.
fn picture(reader: &mut Reader<Cursor<Vec<u8>>>) -> Result<(Part, Option<FrameControl>), DecodingError> {
    let size = reader.output_buffer_size().ok_or(DecodingError::LimitsExceeded)?;
    let mut bytes = vec![0; size];
    let found = reader.next_frame(&mut bytes)?;
    let (width, height) = (found.width as usize, found.height as usize);
    let channels = found.color_type.samples();
    let samples = match found.bit_depth {
        BitDepth::Sixteen => Samples::U16(bytes.as_chunks::<2>().0.iter().map(|b| u16::from_be_bytes(*b)).collect()),
        _ => Samples::U8(bytes),
    };
    let control = reader.info().frame_control().copied();
    Ok((Part::interleaved(width, height, channels, &samples), control))
}

/// Frames of an animation being read.
struct Frames {
    reader: Reader<Cursor<Vec<u8>>>,
    path: PathBuf,
    orientation: Orientation,
    /// The canvas before the next frame.
    canvas: Option<Part>,
    /// True if the next picture is not part of the animation.
    lonely: bool,
    next: u32,
    count: u32,
    start: f64,
    ended: bool,
}

impl Frames {
    fn step(&mut self) -> Result<Option<Part>, DecodingError> {
        if self.lonely {
            self.lonely = false;
            let (mut part, _) = picture(&mut self.reader)?;
            part.name = "default picture".to_owned();
            return Ok(Some(part));
        }
        if self.next == self.count {
            self.reader.finish()?;
            return Ok(None);
        }
        let (part, control) = picture(&mut self.reader)?;
        let control = control.unwrap_or_default();
        let size = [self.reader.info().width as usize, self.reader.info().height as usize];
        let canvas = self.canvas.take().unwrap_or_else(|| blank(&part, size));
        let mut shown = canvas.clone();
        lay(&mut shown, &part, &control);
        let duration =
            f64::from(control.delay_num) / f64::from(if control.delay_den == 0 { 100 } else { control.delay_den });
        let mut frame = shown.clone();
        frame.name = format!("frame {}", self.next);
        frame.shown = Some((self.start, Some(duration)));
        self.canvas = Some(match control.dispose_op {
            DisposeOp::None => shown,
            DisposeOp::Background => {
                let clear = blank(&part, [part.width, part.height]);
                let over = FrameControl { blend_op: BlendOp::Source, ..control };
                lay(&mut shown, &clear, &over);
                shown
            }
            DisposeOp::Previous => canvas,
        });
        self.start += duration;
        self.next += 1;
        Ok(Some(frame))
    }
}

impl Iterator for Frames {
    type Item = Result<Part, SourceError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let at = self.next;
        match self.step() {
            Ok(Some(part)) => Some(Ok(oriented(part, self.orientation))),
            Ok(None) => {
                self.ended = true;
                None
            }
            Err(e) => {
                self.ended = true;
                Some(Err(decode_error(&self.path, format!("broken or unsupported Png image: frame {at}: {e}"))))
            }
        }
    }
}

/// A canvas with the channels of `like` and alpha, every sample 0.
fn blank(like: &Part, [width, height]: [usize; 2]) -> Part {
    let grey = like.channels.len() < 3;
    let wide = matches!(like.channels[0].samples, Samples::U16(_));
    let channels = if grey { 2 } else { 4 };
    let count = channels * width * height;
    let samples = if wide { Samples::U16(vec![0; count]) } else { Samples::U8(vec![0; count]) };
    Part::interleaved(width, height, channels, &samples)
}

/// Draws a frame onto the canvas.
fn lay(canvas: &mut Part, frame: &Part, control: &FrameControl) {
    let colours = canvas.channels.len() - 1;
    let (width, height) = (canvas.width, canvas.height);
    let corner = [control.x_offset as usize, control.y_offset as usize];
    let full = match frame.channels[0].samples {
        Samples::U16(_) => u64::from(u16::MAX),
        _ => u64::from(u8::MAX),
    };
    let sample = |samples: &Samples, at: usize| match samples {
        Samples::U8(v) => u64::from(v[at]),
        Samples::U16(v) => u64::from(v[at]),
        _ => 0,
    };
    for row in 0..frame.height.min(height.saturating_sub(corner[1])) {
        for column in 0..frame.width.min(width.saturating_sub(corner[0])) {
            let (from, to) = (row * frame.width + column, (row + corner[1]) * width + column + corner[0]);
            let above = frame.channels.get(colours).map_or(full, |alpha| sample(&alpha.samples, from));
            let below = sample(&canvas.channels[colours].samples, to);
            let source = control.blend_op == BlendOp::Source || above == full || below == 0;
            if control.blend_op == BlendOp::Over && above == 0 {
                continue;
            }
            // Alpha in units of full²: of the upper picture, and of the lower one seen through it.
            let (over, under) = (above * full, below * (full - above));
            for at in 0..=colours {
                let value = if at == colours {
                    if source { above } else { (over + under + full / 2) / full }
                } else {
                    let colour = sample(&frame.channels[at].samples, from);
                    let behind = sample(&canvas.channels[at].samples, to);
                    let all = over + under;
                    if source { colour } else { (colour * over + behind * under + all / 2) / all }
                };
                match &mut canvas.channels[at].samples {
                    Samples::U8(v) => v[to] = value as u8,
                    Samples::U16(v) => v[to] = value as u16,
                    _ => {}
                }
            }
        }
    }
}

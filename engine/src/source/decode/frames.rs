//! Files with several frames: animated PNG and WebP, and TIFF with several pages.
//!
//! Frames of an animation have the durations stored in the file. The decoder composites each frame over the previous
//! ones, so that each is a whole picture. A frame with a duration of zero is shown for a tenth of a second, as in
//! browsers. Pages have no times.

use std::io::{BufRead, Cursor, Seek};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, sync_channel};

use image::codecs::png::PngDecoder;
use image::codecs::webp::WebPDecoder;
use image::metadata::Orientation;
use image::{AnimationDecoder, DynamicImage, Frames, ImageDecoder, ImageFormat, ImageResult, RgbaImage};

use super::{Still, check_size, common, decode_error, icc, orientation, png, tiff, webp};
use crate::source::SourceError;

/// Kind of a file with several frames.
pub(crate) enum Several {
    /// An animation: the duration of each frame, in seconds as a fraction.
    Animation(ImageFormat, Vec<(u32, u32)>),
    /// Indices of a TIFF file's pages, without reduced copies and masks.
    Pages(Vec<usize>),
}

impl Several {
    /// Detects the kind of the file; `None` for a single picture.
    ///
    /// # Errors
    /// A file whose number of frames differs from the one it declares.
    pub(crate) fn of(bytes: &[u8], path: &Path) -> Result<Option<Several>, SourceError> {
        if bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
            let delays = png::delays(bytes).map_err(|cause| decode_error(path, cause))?;
            return Ok(delays.map(|delays| Several::Animation(ImageFormat::Png, delays)));
        }
        if webp::is(bytes) {
            return Ok(webp::delays(bytes).map(|delays| Several::Animation(ImageFormat::WebP, delays)));
        }
        if tiff::is(bytes) {
            let pages = tiff::pages(bytes, path)?;
            return Ok((pages.len() > 1).then_some(Several::Pages(pages)));
        }
        Ok(None)
    }

    /// Returns the error for a place where one picture is expected.
    pub(super) fn refusal(&self, path: &Path) -> SourceError {
        let found = match self {
            Several::Animation(ImageFormat::Png, delays) => format!("an animated PNG of {} frames", delays.len()),
            Several::Animation(_, delays) => format!("an animated WebP of {} frames", delays.len()),
            Several::Pages(pages) => format!("a TIFF of {} pages", pages.len()),
        };
        decode_error(path, format!("expected one picture, found {found}: give the file alone as the input"))
    }
}

/// The frames of one file, in order.
pub(crate) struct Sequence {
    path: PathBuf,
    kind: Kind,
    next: usize,
}

enum Kind {
    Animation {
        delays: Vec<(u32, u32)>,
        times: Option<Vec<f64>>,
        frames: Receiver<ImageResult<RgbaImage>>,
        orientation: Orientation,
        notes: Vec<String>,
    },
    Pages {
        bytes: Vec<u8>,
        pages: Vec<usize>,
    },
}

impl Sequence {
    /// Starts reading a file of several frames.
    ///
    /// # Errors
    /// A file that is broken from its start, too large or cut off.
    pub(crate) fn open(bytes: Vec<u8>, path: &Path, several: Several) -> Result<Sequence, SourceError> {
        let kind = match several {
            Several::Animation(format, delays) => animation(bytes, path, format, delays)?,
            Several::Pages(pages) => Kind::Pages { bytes, pages },
        };
        Ok(Sequence { path: path.to_owned(), kind, next: 0 })
    }

    /// Number of frames in the file.
    pub(crate) fn len(&self) -> usize {
        match &self.kind {
            Kind::Animation { delays, .. } => delays.len(),
            Kind::Pages { pages, .. } => pages.len(),
        }
    }

    /// Returns the frames per second as a fraction, if all frames but the last have the same duration.
    pub(crate) fn rate(&self) -> Option<(u64, u64)> {
        let Kind::Animation { delays, .. } = &self.kind else { return None };
        rate(delays)
    }

    /// Returns the start of each frame in seconds since the first, if durations differ.
    pub(crate) fn times(&self) -> Option<&[f64]> {
        let Kind::Animation { times, .. } = &self.kind else { return None };
        times.as_deref()
    }

    /// Returns the next frame; `None` after the last.
    ///
    /// # Errors
    /// A broken frame, or fewer frames than the file declares.
    pub(crate) fn next(&mut self) -> Result<Option<Still>, SourceError> {
        let (index, length) = (self.next, self.len());
        if index == length {
            return Ok(None);
        }
        self.next += 1;
        match &self.kind {
            Kind::Animation { frames, orientation, notes, .. } => {
                let frame = match frames.recv() {
                    Ok(frame) => frame.map_err(|e| decode_error(&self.path, format!("frame {index}: {e}")))?,
                    Err(_) => {
                        return Err(decode_error(&self.path, format!("expected {length} frames, found {index}")));
                    }
                };
                let mut still = common::from_dynamic(&DynamicImage::ImageRgba8(frame), &self.path)?;
                still.picture = orientation::apply(still.picture, *orientation);
                still.notes.extend_from_slice(notes);
                Ok(Some(still))
            }
            Kind::Pages { bytes, pages } => {
                let mut still = tiff::page(bytes, pages[index], &self.path)?;
                still.notes.insert(0, format!("{length} pages of a TIFF are {length} frames"));
                Ok(Some(still))
            }
        }
    }
}

/// Starts the decoder of an animation on its own thread, one frame ahead.
fn animation(
    bytes: Vec<u8>,
    path: &Path,
    format: ImageFormat,
    mut delays: Vec<(u32, u32)>,
) -> Result<Kind, SourceError> {
    let explain = |e| decode_error(path, format!("broken or unsupported animated {format:?}: {e}"));
    let mut notes = Vec::new();
    if delays.iter().any(|&(numerator, _)| numerator == 0) {
        notes.push("frames of no duration are shown for a tenth of a second".to_owned());
        delays.iter_mut().filter(|(numerator, _)| *numerator == 0).for_each(|delay| *delay = (1, 10));
    }
    if format == ImageFormat::Png {
        notes.extend(png::colour_note(&bytes));
    }
    let Opened { size, orientation, profile, .. } = opened(Cursor::new(bytes.as_slice()), format).map_err(explain)?;
    check_size(path, size[0] as usize, size[1] as usize)?;
    common::check_length(&bytes, path, format, size)?;
    notes.extend(profile.and_then(|profile| icc::note(&profile)));
    let (sender, frames) = sync_channel(0);
    // The image crate's frame iterators cannot be sent to another thread.
    std::thread::spawn(move || {
        let send = |frame: ImageResult<RgbaImage>| sender.send(frame).is_ok();
        match opened(Cursor::new(bytes), format) {
            Ok(animation) => {
                for frame in animation.frames {
                    if !send(frame.map(image::Frame::into_buffer)) {
                        break;
                    }
                }
            }
            Err(e) => {
                send(Err(e));
            }
        }
    });
    let times = rate(&delays).is_none().then(|| starts(&delays));
    Ok(Kind::Animation { delays, times, frames, orientation, notes })
}

/// Returns the frames per second as a fraction, if all frames but the last have the same duration.
fn rate(delays: &[(u32, u32)]) -> Option<(u64, u64)> {
    let (_, shown) = delays.split_last()?;
    let (&(numerator, denominator), rest) = shown.split_first()?;
    let same = |&(n, d): &(u32, u32)| u64::from(n) * u64::from(denominator) == u64::from(d) * u64::from(numerator);
    rest.iter().all(same).then_some((u64::from(denominator), u64::from(numerator)))
}

/// Returns the start of each frame, in seconds since the first.
fn starts(delays: &[(u32, u32)]) -> Vec<f64> {
    let mut time = 0.0;
    let start = |&(numerator, denominator): &(u32, u32)| {
        let start = time;
        time += f64::from(numerator) / f64::from(denominator);
        start
    };
    delays.iter().map(start).collect()
}

/// An animation before its first frame is read.
struct Opened<'a> {
    frames: Frames<'a>,
    size: [u32; 2],
    orientation: Orientation,
    profile: Option<Vec<u8>>,
}

fn opened<'a, R: BufRead + Seek + 'a>(reader: R, format: ImageFormat) -> ImageResult<Opened<'a>> {
    let limits = common::limits();
    if format == ImageFormat::Png {
        let mut decoder = PngDecoder::with_limits(reader, limits)?;
        let (width, height) = decoder.dimensions();
        let (orientation, profile) = (decoder.orientation()?, decoder.icc_profile()?);
        Ok(Opened { frames: decoder.apng()?.into_frames(), size: [width, height], orientation, profile })
    } else {
        let mut decoder = WebPDecoder::new(reader)?;
        decoder.set_limits(limits)?;
        let (width, height) = decoder.dimensions();
        let (orientation, profile) = (decoder.orientation()?, decoder.icc_profile()?);
        Ok(Opened { frames: decoder.into_frames(), size: [width, height], orientation, profile })
    }
}

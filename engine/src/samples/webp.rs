//! WebP: the picture, or each frame of an animation as it is shown.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use image::codecs::webp::WebPDecoder;
use image::metadata::Orientation;
use image::{AnimationDecoder, DynamicImage, Frames, ImageDecoder};

use super::orientation::oriented;
use super::{Part, Parts, Samples, one, plain};
use crate::source::SourceError;
use crate::source::decode::{check_size, decode_error};

pub(super) fn read(bytes: Vec<u8>, path: &Path) -> Result<Parts, SourceError> {
    let broken = |e: image::ImageError| decode_error(path, format!("broken or unsupported WebP image: {e}"));
    let mut decoder = WebPDecoder::new(Cursor::new(bytes)).map_err(broken)?;
    let (width, height) = decoder.dimensions();
    check_size(path, width as usize, height as usize)?;
    let orientation = decoder.orientation().map_err(broken)?;
    if decoder.has_animation() {
        let alpha = decoder.color_type().has_alpha();
        let frames = decoder.into_frames();
        return Ok(Box::new(Animation { frames, path: path.to_owned(), alpha, orientation, next: 0, start: 0.0 }));
    }
    let image = DynamicImage::from_decoder(decoder).map_err(broken)?;
    Ok(one(oriented(plain::of(image, path)?, orientation)))
}

struct Animation {
    frames: Frames<'static>,
    path: PathBuf,
    alpha: bool,
    orientation: Orientation,
    next: usize,
    start: f64,
}

impl Iterator for Animation {
    type Item = Result<Part, SourceError>;

    fn next(&mut self) -> Option<Self::Item> {
        let at = self.next;
        self.next += 1;
        let frame = match self.frames.next()? {
            Ok(frame) => frame,
            Err(e) => {
                return Some(Err(decode_error(
                    &self.path,
                    format!("broken or unsupported WebP image: frame {at}: {e}"),
                )));
            }
        };
        let (numerator, denominator) = frame.delay().numer_denom_ms();
        let duration = f64::from(numerator) / f64::from(denominator.max(1)) / 1e3;
        let image = frame.into_buffer();
        let (width, height) = (image.width() as usize, image.height() as usize);
        let mut part = Part::interleaved(width, height, 4, &Samples::U8(image.into_raw()));
        if !self.alpha {
            part.channels.truncate(3);
        }
        part.name = format!("frame {at}");
        part.shown = Some((self.start, Some(duration)));
        self.start += duration;
        Some(Ok(oriented(part, self.orientation)))
    }
}

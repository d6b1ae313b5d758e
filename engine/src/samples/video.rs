//! Frames of videos: the planes of y4m as they are stored, and RGB of everything else.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use super::{Channel, Part, Parts, Samples};
use crate::source::y4m::Y4m;
use crate::source::y4m::header::Chroma;
use crate::source::{Options, Source, SourceError, decode, ffmpeg};

/// Every frame as RGB.
pub(super) fn read(path: &Path) -> Result<Parts, SourceError> {
    let mut source = Source::open(path, &Options::default())?;
    if [ffmpeg::ALPHA, ffmpeg::GIF_HOLES, decode::OVER_GREY]
        .iter()
        .any(|alpha| source.notes().iter().any(|note| note == alpha))
    {
        let cause = "expected a video without alpha, found one with it: compare folders of its frames as PNG files";
        return Err(SourceError::Decode { path: path.to_owned(), cause: cause.to_owned() });
    }
    let (mut ended, mut noted) = (false, 0);
    Ok(Box::new(std::iter::from_fn(move || {
        if ended {
            return None;
        }
        let frame = match source.next_frame() {
            Ok(None) => None,
            Ok(Some(frame)) => {
                let (width, height) = (frame.picture.width, frame.picture.height);
                let mut rgb = frame.picture.rgb;
                let blue = rgb.split_off(2 * width * height);
                let green = rgb.split_off(width * height);
                let channel = |(name, plane): (&str, Vec<f32>)| Channel {
                    name: name.to_owned(),
                    width,
                    height,
                    samples: Samples::F32(plane),
                };
                let mut part = Part {
                    name: format!("frame {}", frame.index),
                    width,
                    height,
                    channels: [("R", rgb), ("G", green), ("B", blue)].map(channel).into(),
                    premultiplied: false,
                    windows: None,
                    shown: Some((frame.timestamp, None)),
                    notes: source.notes()[noted..].to_vec(),
                };
                noted += part.notes.len();
                part.shown = part.shown.filter(|(start, _)| start.is_finite());
                Some(Ok(part))
            }
            Err(e) => Some(Err(e)),
        };
        ended = !matches!(frame, Some(Ok(_)));
        frame
    })))
}

/// The frames of two y4m files as planes, if both have one layout.
pub(super) fn planes(paths: [&Path; 2]) -> Result<Option<[Parts; 2]>, SourceError> {
    let open = |path: &Path| -> Result<Y4m<BufReader<File>>, SourceError> {
        let file = File::open(path).map_err(SourceError::read(path))?;
        Y4m::new(BufReader::with_capacity(1 << 16, file), path)
    };
    let [a, b] = [open(paths[0])?, open(paths[1])?];
    let mut other = b.header().clone();
    // Rates are compared by the times of frames instead.
    other.rate = a.header().rate;
    if *a.header() != other {
        return Ok(None);
    }
    Ok(Some([a, b].map(frames)))
}

fn frames(mut y4m: Y4m<BufReader<File>>) -> Parts {
    let mut index = 0;
    let mut ended = false;
    Box::new(std::iter::from_fn(move || {
        if ended {
            return None;
        }
        let frame = match y4m.next_frame() {
            Ok(None) => None,
            Ok(Some(bytes)) => {
                let bytes = bytes.to_vec();
                let header = y4m.header();
                let (width, height) = (header.width, header.height);
                let (columns, rows) = header.chroma_size();
                let mut planes = vec![("Y", width, height)];
                if header.chroma != Chroma::Mono {
                    planes.extend([("Cb", columns, rows), ("Cr", columns, rows)]);
                }
                if header.chroma == Chroma::C444Alpha {
                    planes.push(("A", width, height));
                }
                let mut rest = bytes.as_slice();
                let mut channels = Vec::with_capacity(planes.len());
                for (name, width, height) in planes {
                    let (plane, after) = rest.split_at(width * height * header.sample_bytes());
                    rest = after;
                    channels.push(Channel {
                        name: name.to_owned(),
                        width,
                        height,
                        samples: samples(plane, header.bits),
                    });
                }
                let shown = header.rate.map(|(frames, seconds)| (index as f64 * seconds as f64 / frames as f64, None));
                let name = format!("frame {index}");
                index += 1;
                Some(Ok(Part {
                    name,
                    width,
                    height,
                    channels,
                    premultiplied: false,
                    windows: None,
                    shown,
                    notes: Vec::new(),
                }))
            }
            Err(e) => Some(Err(e)),
        };
        ended = !matches!(frame, Some(Ok(_)));
        frame
    }))
}

/// Samples of a plane; those of 9 to 15 bits are scaled to the range of 16. Bits above them, which no writer sets, move
/// below them, so that none is lost.
fn samples(plane: &[u8], bits: u32) -> Samples {
    if bits == 8 {
        return Samples::U8(plane.to_vec());
    }
    let words = plane.as_chunks::<2>().0.iter().map(|b| u16::from_le_bytes(*b));
    Samples::U16(words.map(|word| word.rotate_left(16 - bits.min(16))).collect())
}

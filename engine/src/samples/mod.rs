//! Every sample of a picture file, as it is stored: for comparing files, without compositing, clamping or omissions.
//!
//! | format | parts | samples |
//! |---|---|---|
//! | PNG | the picture, or every frame of an animation as it is shown | u8, u16; palettes and fewer bits are expanded to u8 |
//! | JPEG | the picture | u8 |
//! | WebP | the picture, or every frame of an animation as it is shown | u8 |
//! | TIFF | every page | u8, u16, u32, i8 to i32, f16, f32, f64; palettes are expanded to u16, or to u8 where their colours have 8 bits |
//! | BMP, TGA, PNM, QOI | the picture | u8, u16 |
//! | OpenEXR | every part and every resolution level | f16, f32, u32 |
//! | y4m, video files | every frame | the planes of two y4m files of one layout; else RGB as [`crate::source`] decodes it |
//!
//! Alpha is a channel like any other. An orientation in EXIF is applied, as by all programs that show the picture.
//! Colour profiles, comments and other metadata are not samples and are not read.

mod exr;
mod jpeg;
mod orientation;
mod pair;
mod plain;
mod png;
mod tiff;
mod video;
mod webp;

use std::path::Path;

use half::f16;

use crate::folder;
use crate::source::SourceError;
use crate::source::decode::read_file;
pub use pair::{Pair, pair};

/// Samples of one type.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Samples {
    /// 8-bit samples; 255 is full.
    U8(Vec<u8>),
    /// 16-bit samples; 65535 is full.
    U16(Vec<u16>),
    /// 32-bit samples; 2³²−1 is full.
    U32(Vec<u32>),
    /// Whole numbers without a scale, such as OpenEXR's identifiers of objects.
    Whole(Vec<u32>),
    /// Signed whole numbers of this number of bits, without a scale.
    Signed(u8, Vec<i32>),
    /// Half floats.
    F16(Vec<f16>),
    /// Floats.
    F32(Vec<f32>),
    /// Double floats.
    F64(Vec<f64>),
}

impl Samples {
    /// Number of samples.
    pub fn len(&self) -> usize {
        match self {
            Samples::U8(v) => v.len(),
            Samples::U16(v) => v.len(),
            Samples::U32(v) | Samples::Whole(v) => v.len(),
            Samples::Signed(_, v) => v.len(),
            Samples::F16(v) => v.len(),
            Samples::F32(v) => v.len(),
            Samples::F64(v) => v.len(),
        }
    }

    /// Returns true if there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The type's name.
    pub fn kind(&self) -> &'static str {
        match self {
            Samples::U8(_) => "u8",
            Samples::U16(_) => "u16",
            Samples::U32(_) | Samples::Whole(_) => "u32",
            Samples::Signed(8, _) => "i8",
            Samples::Signed(16, _) => "i16",
            Samples::Signed(..) => "i32",
            Samples::F16(_) => "f16",
            Samples::F32(_) => "f32",
            Samples::F64(_) => "f64",
        }
    }

    /// Returns true for whole numbers whose largest value means 1.
    pub fn is_scaled(&self) -> bool {
        matches!(self, Samples::U8(_) | Samples::U16(_) | Samples::U32(_))
    }

    /// Values on one scale: samples with a full value divided by it (rounded to binary32 up to 16 bits, as frames are
    /// read), others unchanged.
    pub fn values(&self) -> Vec<f64> {
        match self {
            Samples::U8(v) => v.iter().map(|&v| f64::from(f32::from(v) / 255.0)).collect(),
            Samples::U16(v) => v.iter().map(|&v| f64::from(f32::from(v) / 65535.0)).collect(),
            Samples::U32(v) => v.iter().map(|&v| f64::from(v) / f64::from(u32::MAX)).collect(),
            Samples::Whole(v) => v.iter().map(|&v| f64::from(v)).collect(),
            Samples::Signed(_, v) => v.iter().map(|&v| f64::from(v)).collect(),
            Samples::F16(v) => v.iter().map(|v| v.to_f64()).collect(),
            Samples::F32(v) => v.iter().map(|&v| f64::from(v)).collect(),
            Samples::F64(v) => v.clone(),
        }
    }

    /// Distance of two samples of one range, as a part of it; `None` for other types, whose distance is that of
    /// [`Self::values`]. Levels are subtracted before they are divided, so that every level of 8 bits is 1/255.
    pub(crate) fn distance(&self, other: &Samples, at: usize) -> Option<f64> {
        let (levels, full) = match (self, other) {
            (Samples::U8(a), Samples::U8(b)) => (u32::from(a.get(at)?.abs_diff(*b.get(at)?)), 255.0),
            (Samples::U16(a), Samples::U16(b)) => (u32::from(a.get(at)?.abs_diff(*b.get(at)?)), 65535.0),
            (Samples::U32(a), Samples::U32(b)) => (a.get(at)?.abs_diff(*b.get(at)?), f64::from(u32::MAX)),
            _ => return None,
        };
        Some(f64::from(levels) / full)
    }

    /// One sample as text, as it is stored.
    ///
    /// # Panics
    /// When `at` is out of range.
    pub fn text(&self, at: usize) -> String {
        match self {
            Samples::U8(v) => v[at].to_string(),
            Samples::U16(v) => v[at].to_string(),
            Samples::U32(v) | Samples::Whole(v) => v[at].to_string(),
            Samples::Signed(_, v) => v[at].to_string(),
            Samples::F16(v) => v[at].to_string(),
            Samples::F32(v) => v[at].to_string(),
            Samples::F64(v) => v[at].to_string(),
        }
    }

    /// The same number of samples of the same type, all at the largest value of their range, or 1.
    fn full(&self) -> Samples {
        match self {
            Samples::U8(v) => Samples::U8(vec![u8::MAX; v.len()]),
            Samples::U16(v) => Samples::U16(vec![u16::MAX; v.len()]),
            Samples::U32(v) => Samples::U32(vec![u32::MAX; v.len()]),
            Samples::Whole(v) => Samples::Whole(vec![1; v.len()]),
            Samples::Signed(bits, v) => Samples::Signed(*bits, vec![1; v.len()]),
            Samples::F16(v) => Samples::F16(vec![f16::ONE; v.len()]),
            Samples::F32(v) => Samples::F32(vec![1.0; v.len()]),
            Samples::F64(v) => Samples::F64(vec![1.0; v.len()]),
        }
    }

    /// The samples at `places`, in that order.
    fn taken(&self, places: impl Iterator<Item = usize>) -> Samples {
        match self {
            Samples::U8(v) => Samples::U8(places.map(|i| v[i]).collect()),
            Samples::U16(v) => Samples::U16(places.map(|i| v[i]).collect()),
            Samples::U32(v) => Samples::U32(places.map(|i| v[i]).collect()),
            Samples::Whole(v) => Samples::Whole(places.map(|i| v[i]).collect()),
            Samples::Signed(bits, v) => Samples::Signed(*bits, places.map(|i| v[i]).collect()),
            Samples::F16(v) => Samples::F16(places.map(|i| v[i]).collect()),
            Samples::F32(v) => Samples::F32(places.map(|i| v[i]).collect()),
            Samples::F64(v) => Samples::F64(places.map(|i| v[i]).collect()),
        }
    }

    /// For equal types: true if the samples at `at` have the same bits.
    pub(crate) fn same_bits(&self, other: &Samples, at: usize) -> Option<bool> {
        Some(match (self, other) {
            (Samples::U8(a), Samples::U8(b)) => a[at] == b[at],
            (Samples::U16(a), Samples::U16(b)) => a[at] == b[at],
            (Samples::U32(a), Samples::U32(b)) | (Samples::Whole(a), Samples::Whole(b)) => a[at] == b[at],
            (Samples::Signed(p, a), Samples::Signed(q, b)) if p == q => a[at] == b[at],
            (Samples::F16(a), Samples::F16(b)) => a[at].to_bits() == b[at].to_bits(),
            (Samples::F32(a), Samples::F32(b)) => a[at].to_bits() == b[at].to_bits(),
            (Samples::F64(a), Samples::F64(b)) => a[at].to_bits() == b[at].to_bits(),
            _ => return None,
        })
    }
}

/// One channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// `R`, `G`, `B`, `A`, `Y` (grey or luma), or the file's own name.
    pub name: String,
    /// Samples per row; fewer than the picture's where the channel is subsampled.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `height · width` samples, row by row.
    pub samples: Samples,
}

/// Windows of an OpenEXR part: corner and size in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Windows {
    /// The stored pixels: left, top, width, height.
    pub data: [i64; 4],
    /// The displayed pixels.
    pub display: [i64; 4],
}

/// A picture in a file: the only one, a page, a frame, or a part.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// `page 1`, `frame 7`, `part depth`; empty for the only one.
    pub name: String,
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Its channels.
    pub channels: Vec<Channel>,
    /// True if colours are multiplied by alpha.
    pub premultiplied: bool,
    /// Windows of an OpenEXR part.
    pub windows: Option<Windows>,
    /// Time at which it is shown, in seconds, and its duration, if known.
    pub shown: Option<(f64, Option<f64>)>,
    /// Conversions of a video's frames, and parts of the file that are left out, a line each; each line once in a file.
    pub notes: Vec<String>,
}

impl Part {
    /// A picture of interleaved samples: 1 grey, 2 grey and alpha, 3 colour, 4 colour and alpha.
    fn interleaved(width: usize, height: usize, channels: usize, samples: &Samples) -> Part {
        let names: &[&str] = match channels {
            1 => &["Y"],
            2 => &["Y", "A"],
            3 => &["R", "G", "B"],
            _ => &["R", "G", "B", "A"],
        };
        Part::named(width, height, names, samples)
    }

    /// A picture of interleaved samples of channels with these names.
    fn named(width: usize, height: usize, names: &[impl AsRef<str>], samples: &Samples) -> Part {
        let channel = |(at, name): (usize, &_)| Channel {
            name: AsRef::<str>::as_ref(name).to_owned(),
            width,
            height,
            samples: samples.taken((0..width * height).map(|pixel| pixel * names.len() + at)),
        };
        Part {
            name: String::new(),
            width,
            height,
            channels: names.iter().enumerate().map(channel).collect(),
            premultiplied: false,
            windows: None,
            shown: None,
            notes: Vec::new(),
        }
    }

    /// The channel of this name.
    pub fn channel(&self, name: &str) -> Option<&Channel> {
        self.channels.iter().find(|channel| channel.name == name)
    }
}

/// The parts of a file, one after another.
pub type Parts = Box<dyn Iterator<Item = Result<Part, SourceError>>>;

/// Kind of a file of pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// An image file of a known kind.
    Image,
    /// A y4m file.
    Y4m,
    /// Any other file: ffmpeg decodes it.
    Video,
}

/// The kind of the file `path`: by its first bytes, else by its name.
///
/// # Errors
/// A file that cannot be read, or an empty one.
pub fn kind(path: &Path) -> Result<Kind, SourceError> {
    use std::io::Read;
    let mut head = Vec::new();
    let file = std::fs::File::open(path).map_err(SourceError::read(path))?;
    file.take(16).read_to_end(&mut head).map_err(SourceError::read(path))?;
    Ok(match head.as_slice() {
        [] => return Err(SourceError::EmptyFile { path: path.to_owned() }),
        head if head.starts_with(b"YUV4MPEG2 ") => Kind::Y4m,
        head if image(head, path).is_some() => Kind::Image,
        _ if folder::is_image(path) => Kind::Image,
        _ if folder::ends_in(path, &["y4m"]) => Kind::Y4m,
        _ => Kind::Video,
    })
}

/// Reader of an image file.
type Reader = fn(Vec<u8>, &Path) -> Result<Parts, SourceError>;

/// The reader of an image file with these first bytes.
fn image(head: &[u8], path: &Path) -> Option<Reader> {
    Some(match head {
        [0xff, 0xd8, ..] => jpeg::read,
        [0x76, 0x2f, 0x31, 0x01, ..] => exr::read,
        [0x89, b'P', b'N', b'G', ..] => png::read,
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => tiff::read,
        [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => webp::read,
        _ if plain::is(head, path) => plain::read,
        _ => return None,
    })
}

/// The parts of the file `path`.
///
/// # Errors
/// A file that cannot be read, is empty, or is of an unknown kind; broken or too large parts are separate errors.
pub fn open(path: &Path) -> Result<Parts, SourceError> {
    if kind(path)? != Kind::Image {
        return video::read(path);
    }
    let bytes = read_file(path)?;
    // A file named as an image that does not begin like one is refused with its kind's message.
    let reader = image(&bytes, path).unwrap_or(plain::read);
    reader(bytes, path)
}

/// The parts of two files for comparison: for two y4m files of one layout their planes.
///
/// # Errors
/// As [`open`].
pub fn open_both(paths: [&Path; 2]) -> Result<[Parts; 2], SourceError> {
    if kind(paths[0])? == Kind::Y4m
        && kind(paths[1])? == Kind::Y4m
        && let Some(parts) = video::planes(paths)?
    {
        return Ok(parts);
    }
    Ok([open(paths[0])?, open(paths[1])?])
}

/// A file's only part.
fn one(part: Part) -> Parts {
    Box::new(std::iter::once(Ok(part)))
}

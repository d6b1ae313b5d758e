//! The header line of a y4m stream.

use crate::picture::size_is_allowed;
use crate::source::colour::Matrix;

/// Longest header line accepted, in bytes.
pub const MAX_LINE: usize = 4096;

/// Size of the chroma planes relative to the luma plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chroma {
    /// Luma alone.
    Mono,
    /// Half width, half height, at `Siting`.
    C420(Siting),
    /// Half width, full height; samples are at every second luma column.
    C422,
    /// Quarter width, full height; samples are at every fourth luma column.
    C411,
    /// Full size.
    C444,
    /// Full size, with an alpha plane after the chroma planes.
    C444Alpha,
}

/// Position of a 4:2:0 chroma sample in its 2×2 luma pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Siting {
    /// In the middle (`420jpeg`, `420`).
    Centre,
    /// At the left, vertically in the middle (`420mpeg2`).
    Left,
    /// At the upper left (`420paldv`).
    TopLeft,
}

/// Parameters of a stream.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// Luma columns.
    pub width: usize,
    /// Luma rows.
    pub height: usize,
    /// Frames per second as a fraction, if present (`F0:0` is unknown).
    pub rate: Option<(u64, u64)>,
    /// Chroma planes.
    pub chroma: Chroma,
    /// Bits per sample: 8 to 16. Samples of more than 8 bits are two bytes, little-endian.
    pub bits: u32,
    /// True if samples span the full range (`XCOLORRANGE=FULL`). Without that parameter it is true for luma alone
    /// (`Cmono`), as ffmpeg writes it.
    pub full_range: bool,
    /// True if the header states the range.
    pub range_stated: bool,
    /// The matrix of the planes; `None` if they are green, blue and red, which a header alone never states.
    pub matrix: Option<Matrix>,
    /// Ratio of a pixel's width to its height (`A`), if it is stated and not 1.
    pub aspect: Option<(u32, u32)>,
    /// True if frames are two fields (`It`, `Ib`) or may be (`Im`).
    pub interlaced: bool,
}

impl Header {
    /// Returns true if pixels have alpha.
    pub fn has_alpha(&self) -> bool {
        self.chroma == Chroma::C444Alpha
    }

    /// Reads the header line (without its newline).
    ///
    /// # Errors
    /// Expected and found values, for every parameter that is missing, malformed or not supported, and for sizes
    /// outside the limits.
    pub fn parse(line: &[u8]) -> Result<Header, String> {
        let line = std::str::from_utf8(line).map_err(|_| "the header line is not text".to_owned())?;
        let mut words = line.split(' ').filter(|w| !w.is_empty());
        let magic = words.next().unwrap_or_default();
        if magic != "YUV4MPEG2" {
            return Err(format!("expected a header starting with YUV4MPEG2, found {:?}", shorten(magic)));
        }
        let (mut width, mut height, mut rate, mut range) = (None, None, None, None);
        let (mut aspect, mut interlaced) = (None, false);
        let (mut chroma, mut bits) = (Chroma::C420(Siting::Centre), 8);
        for word in words {
            let Some((tag, value)) = word.split_at_checked(1) else {
                return Err(format!("malformed header parameter {:?}", shorten(word)));
            };
            match tag {
                "W" => width = Some(number(word, value)?),
                "H" => height = Some(number(word, value)?),
                "F" => rate = fraction(word, value, "a frame rate like F30000:1001")?,
                "A" => aspect = fraction(word, value, "a pixel aspect like A4:3")?.filter(|(w, h)| w != h),
                "I" => interlaced = ["t", "b", "m"].contains(&value),
                "C" => (chroma, bits) = colour(value)?,
                "X" => match value.split_once('=') {
                    Some(("COLORRANGE", "FULL")) => range = Some(true),
                    Some(("COLORRANGE", "LIMITED")) => range = Some(false),
                    _ => {}
                },
                _ => {}
            }
        }
        let width = width.ok_or("the header gives no width (W)")? as usize;
        let height = height.ok_or("the header gives no height (H)")? as usize;
        if !size_is_allowed(width, height) {
            return Err(format!(
                "the header gives {width}×{height}, expected 1 to {} pixels a side and at most {} in all",
                crate::picture::MAX_SIDE,
                crate::picture::MAX_PIXELS
            ));
        }
        let rate = rate.map(|(numerator, denominator)| (u64::from(numerator), u64::from(denominator)));
        let (full_range, range_stated) = (range.unwrap_or(chroma == Chroma::Mono), range.is_some());
        let matrix = Some(Matrix::of_size(width, height));
        Ok(Header { width, height, rate, chroma, bits, full_range, range_stated, matrix, aspect, interlaced })
    }

    /// Returns columns and rows of a chroma plane.
    pub fn chroma_size(&self) -> (usize, usize) {
        match self.chroma {
            Chroma::Mono => (0, 0),
            Chroma::C420(_) => (self.width.div_ceil(2), self.height.div_ceil(2)),
            Chroma::C422 => (self.width.div_ceil(2), self.height),
            Chroma::C411 => (self.width.div_ceil(4), self.height),
            Chroma::C444 | Chroma::C444Alpha => (self.width, self.height),
        }
    }

    /// Returns width and height of the pictures after one side is enlarged to make pixels square; `None` if they are
    /// square already.
    pub fn square_size(&self) -> Option<(usize, usize)> {
        let (a, b) = self.aspect?;
        let longer = |side: usize, a: u32, b: u32| (side as f64 * f64::from(a) / f64::from(b)).round() as usize;
        Some(if a > b { (longer(self.width, a, b), self.height) } else { (self.width, longer(self.height, b, a)) })
    }

    /// Returns the bytes of one frame.
    pub fn frame_bytes(&self) -> usize {
        let (cw, ch) = self.chroma_size();
        let alpha = if self.chroma == Chroma::C444Alpha { self.width * self.height } else { 0 };
        (self.width * self.height + 2 * cw * ch + alpha) * self.sample_bytes()
    }

    /// Returns the bytes of one sample.
    pub fn sample_bytes(&self) -> usize {
        if self.bits > 8 { 2 } else { 1 }
    }
}

/// Returns the note on pixels of this aspect.
pub(in crate::source) fn made_square((width, height): (u32, u32)) -> String {
    format!("pixels of {width}:{height} were made square")
}

fn shorten(text: &str) -> String {
    text.chars().take(40).collect()
}

fn number(word: &str, value: &str) -> Result<u32, String> {
    value.parse().map_err(|_| format!("header parameter {:?}: expected a whole number", shorten(word)))
}

fn fraction(word: &str, value: &str, what: &str) -> Result<Option<(u32, u32)>, String> {
    let malformed = || format!("header parameter {:?}: expected {what}", shorten(word));
    let (numerator, denominator) = value.split_once(':').ok_or_else(malformed)?;
    let parse = |text: &str| text.parse::<u32>().map_err(|_| malformed());
    Ok(match (parse(numerator)?, parse(denominator)?) {
        (0, _) | (_, 0) => None,
        rate => Some(rate),
    })
}

fn colour(value: &str) -> Result<(Chroma, u32), String> {
    let unsupported = || {
        format!(
            "colour space C{}: expected 420jpeg, 420mpeg2, 420paldv, 420, 422, 411, 444, 444alpha, mono, or 420, 422, 444 \
             with p9 to p16, or mono9 to mono16",
            shorten(value)
        )
    };
    if let Some(bits) = value.strip_prefix("mono") {
        let bits = if bits.is_empty() { 8 } else { bits.parse().map_err(|_| unsupported())? };
        return if (8..=16).contains(&bits) { Ok((Chroma::Mono, bits)) } else { Err(unsupported()) };
    }
    Ok(match value {
        "420jpeg" | "420" => (Chroma::C420(Siting::Centre), 8),
        "420mpeg2" => (Chroma::C420(Siting::Left), 8),
        "420paldv" => (Chroma::C420(Siting::TopLeft), 8),
        "422" => (Chroma::C422, 8),
        "411" => (Chroma::C411, 8),
        "444" => (Chroma::C444, 8),
        "444alpha" => (Chroma::C444Alpha, 8),
        _ => {
            let (chroma, bits) = value.split_once('p').ok_or_else(unsupported)?;
            let chroma = match chroma {
                // The chroma of video with more than eight bits is sited as in MPEG-2.
                "420" => Chroma::C420(Siting::Left),
                "422" => Chroma::C422,
                "444" => Chroma::C444,
                _ => return Err(unsupported()),
            };
            let bits = bits.parse().map_err(|_| unsupported())?;
            if !(9..=16).contains(&bits) {
                return Err(unsupported());
            }
            (chroma, bits)
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_ffmpeg_writes_is_understood() {
        let header =
            Header::parse(b"YUV4MPEG2 W853 H480 F30000:1001 Ip A1:1 C420mpeg2 XYSCSS=420MPEG2 XCOLORRANGE=FULL");
        let header = header.expect("valid");
        assert_eq!((header.width, header.height, header.rate), (853, 480, Some((30000, 1001))));
        assert_eq!((header.chroma, header.bits, header.full_range), (Chroma::C420(Siting::Left), 8, true));
        assert_eq!(header.frame_bytes(), 853 * 480 + 2 * 427 * 240);
        let ten = Header::parse(b"YUV4MPEG2 W6 H4 F0:0 C422p10 XYSCSS=422P10").expect("valid");
        assert_eq!((ten.rate, ten.bits, ten.frame_bytes()), (None, 10, 2 * (24 + 2 * 12)));
    }

    #[test]
    fn aspect_fields_and_ranges_are_understood() {
        let of = |text: &str| Header::parse(format!("YUV4MPEG2 W32 H18 {text}").as_bytes()).expect("valid");
        assert_eq!(
            [of("A4:3").aspect, of("A1:1").aspect, of("A0:0").aspect, of("").aspect],
            [Some((4, 3)), None, None, None]
        );
        assert_eq!(
            [of("It").interlaced, of("Ib").interlaced, of("Im").interlaced, of("Ip").interlaced, of("I?").interlaced],
            [true, true, true, false, false]
        );
        assert_eq!(
            [of("A4:3"), of("A3:4"), of("A1:1")].map(|header| header.square_size()),
            [Some((43, 18)), Some((32, 24)), None]
        );
        // ffmpeg 5.1 writes grey of full range without a tag.
        assert_eq!(
            [of("Cmono").full_range, of("Cmono XCOLORRANGE=LIMITED").full_range, of("C420jpeg").full_range],
            [true, false, false]
        );
    }

    #[test]
    fn hostile_headers_are_errors() {
        for line in [
            "RIFF W1 H1",
            "YUV4MPEG2",
            "YUV4MPEG2 W10",
            "YUV4MPEG2 W0 H10",
            "YUV4MPEG2 W4294967295 H4294967295",
            "YUV4MPEG2 W99999999999 H1",
            "YUV4MPEG2 W-4 H4",
            "YUV4MPEG2 W4 H4 F25",
            "YUV4MPEG2 W4 H4 A4",
            "YUV4MPEG2 W4 H4 A-4:3",
            "YUV4MPEG2 W4 H4 C420p99",
            "YUV4MPEG2 W4 H4 C500",
            "YUV4MPEG2 W4 H4 Cmono7",
            "YUV4MPEG2 W4 é",
        ] {
            assert!(Header::parse(line.as_bytes()).is_err(), "{line}");
        }
    }

    proptest! {
        #[test]
        fn no_line_panics(line in proptest::collection::vec(any::<u8>(), 0..60)) {
            let mut whole = b"YUV4MPEG2 ".to_vec();
            whole.extend(line);
            if let Ok(header) = Header::parse(&whole) {
                prop_assert!(header.frame_bytes() > 0);
            }
        }
    }
}

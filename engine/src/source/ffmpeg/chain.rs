//! The ffmpeg filters that convert a stream's frames to planes for [`crate::source::y4m`].

use std::path::Path;

use super::shown::Look;
use super::{bright, program};
use crate::source::colour::{Conversion, Curve, Matrix};
use crate::source::y4m::header::made_square;

/// Formats of Y'CbCr and grey that y4m has, in ffmpeg's names; ffmpeg picks the one nearest to the file's own.
const FORMATS: &str = "format=pix_fmts=yuv420p|yuv422p|yuv444p|yuvj420p|yuvj422p|yuvj444p|yuv411p|gray|yuv420p9|yuv422p9|yuv444p9\
|yuv420p10|yuv422p10|yuv444p10|yuv420p12|yuv422p12|yuv444p12|yuv420p14|yuv422p14|yuv444p14|yuv420p16|yuv422p16|yuv444p16\
|gray10|gray12|gray16";
/// Light that becomes white in standard range, in cd/m²: for a video that exceeds the first level, and for others.
pub(super) const WHITE: [u32; 2] = [203, 100];

/// Notes on alpha, of videos and of GIFs.
pub(crate) const ALPHA: &str = "the alpha plane is left out";
pub(crate) const GIF_HOLES: &str = "transparent parts of the GIF are taken as white";
/// The number of a GIF's frames that are searched for transparent parts, and their size in pixels.
const LOOKED_AT: (usize, usize) = (500, 1 << 26);

/// The filters, and notes on them.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Chain {
    pub(super) filters: Vec<String>,
    pub(super) notes: Vec<String>,
    pub(super) samples: Samples,
}

/// Kind of the output planes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Samples {
    /// Green, blue and red.
    Rgb,
    /// Luma and chroma of this matrix.
    Matrix(Matrix),
    /// Luma and chroma of a matrix that is chosen by the picture's size.
    Guessed,
}

impl Chain {
    /// Returns the chain for frames of this kind. `given` replaces the file's own matrix.
    pub(super) fn of(
        look: &Look,
        size: (usize, usize),
        given: Option<Matrix>,
        gif: bool,
        path: &Path,
        stream: &str,
    ) -> Chain {
        let (mut filters, mut notes) = (Vec::new(), Vec::new());
        if look.interlaced {
            filters.push("bwdif=mode=send_frame:deint=interlaced".to_owned());
            notes.push("interlaced frames were deinterlaced".to_owned());
        }
        notes.extend(look.aspect.map(made_square));
        let (rgb, grey) = (rgb_bits(&look.format), is_grey(&look.format));
        let samples = match look.tags.conversion(size, rgb.is_some(), grey, given) {
            Conversion::Rgb => {
                let bits = rgb.filter(|bits| *bits > 8).map(|bits| bits.to_string()).unwrap_or_default();
                // The planes are renamed; their samples stay unchanged.
                filters.push(format!("format=gbrp{bits},mergeplanes=0x000102:yuv444p{bits}"));
                Samples::Rgb
            }
            Conversion::Matrix { matrix, guessed } => {
                filters.push(FORMATS.to_owned());
                if guessed { Samples::Guessed } else { Samples::Matrix(matrix) }
            }
            Conversion::HighRange { curve, assumed } => {
                let (filter, note) = to_standard(curve, &assumed, path, stream);
                filters.extend([filter, FORMATS.to_owned()]);
                notes.push(note);
                Samples::Matrix(Matrix::BT709)
            }
            Conversion::Zscale { from, options } => {
                filters.push(format!("zscale=m=bt709:r=tv{options},format=yuv444p10"));
                notes.push(format!("{from} was converted to BT.709"));
                Samples::Matrix(Matrix::BT709)
            }
        };
        // Alpha of a GIF marks pixels that no frame has covered yet; few have any.
        notes.extend(look.tags.assumed());
        let (frames, bytes) = LOOKED_AT;
        let holes = || program::samples(path, stream, "alphaextract", frames, bytes).iter().any(|alpha| *alpha < 255);
        if has_alpha(&look.format) && (!gif || holes()) {
            notes.push(if gif { GIF_HOLES } else { ALPHA }.to_owned());
        }
        Chain { filters, notes, samples }
    }
}

/// Returns the filter from high dynamic range to BT.709, and its description.
fn to_standard(curve: Curve, assumed: &str, path: &Path, stream: &str) -> (String, String) {
    let (name, curve, white) = match curve {
        Curve::Hlg => ("HLG", "arib-std-b67", bright::hlg(f64::from(WHITE[1]))),
        Curve::Pq => ("PQ", "smpte2084", bright::pq(f64::from(WHITE[1]))),
    };
    let bright = bright::looks_brighter(path, stream, white);
    let light = WHITE[usize::from(!bright)];
    let roll = if bright { format!("tonemap=mobius:param=0.8:desat=0:peak={},", 1000 / light) } else { String::new() };
    let filter = format!(
        "zscale=tin={curve}{assumed}:t=linear:npl={light},format=gbrpf32le,zscale=p=bt709,{roll}zscale=t=bt709:m=bt709:r=tv,format=yuv444p10"
    );
    (filter, format!("{name} was converted to BT.709 of standard range, white at {light} cd/m²"))
}

/// Returns the bits per sample of an RGB format, by ffmpeg's name; `None` for other formats.
fn rgb_bits(format: &str) -> Option<u32> {
    let starts = |starts: &[&str]| starts.iter().any(|start| format.starts_with(start));
    if !starts(&["rgb", "bgr", "gbr", "argb", "abgr", "0rgb", "0bgr", "x2rgb", "x2bgr", "pal8", "xyz", "bayer"]) {
        return None;
    }
    Some(match format {
        _ if starts(&["x2rgb10", "x2bgr10"]) => 10,
        _ if starts(&["xyz12"]) => 12,
        _ if starts(&["rgb48", "bgr48", "rgba64", "bgra64", "rgbf", "rgbaf", "rgb96", "rgba128"])
            || format.contains("16") =>
        {
            16
        }
        _ => {
            // gbrp10le, gbrap12be, gbrpf32le.
            let digits: String =
                format.chars().skip_while(|c| !c.is_ascii_digit()).take_while(char::is_ascii_digit).collect();
            match digits.parse() {
                _ if !format.starts_with("gbr") => 8,
                Ok(bits @ (9 | 10 | 12 | 14)) => bits,
                Ok(_) => 16,
                Err(_) => 8,
            }
        }
    })
}

/// Returns true if pictures of this format, by ffmpeg's name, are luma alone.
fn is_grey(format: &str) -> bool {
    ["gray", "ya8", "ya16", "yaf", "mono"].iter().any(|start| format.starts_with(start))
}

/// Returns true if pictures of this format, by ffmpeg's name, have an alpha plane.
fn has_alpha(format: &str) -> bool {
    ["yuva", "rgba", "bgra", "argb", "abgr", "gbrap", "ya8", "ya16", "yaf", "vuya", "ayuv"]
        .iter()
        .any(|start| format.starts_with(start))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::colour::Tags;

    fn chain(format: &str, tags: Tags, interlaced: bool, aspect: Option<(u32, u32)>) -> Chain {
        let look = Look { format: format.into(), aspect, interlaced, tags };
        Chain::of(&look, (320, 180), None, false, Path::new("x"), "0:0")
    }

    #[test]
    fn planes_that_y4m_has_pass_untouched() {
        let found = chain("yuv420p", Tags::of(Some("bt709"), None, None), false, None);
        assert_eq!(
            (found.filters, found.notes, found.samples),
            (vec![FORMATS.to_owned()], Vec::new(), Samples::Matrix(Matrix::BT709))
        );
        assert_eq!(chain("yuv420p", Tags::default(), false, None).samples, Samples::Guessed);
        // Luma alone has no matrix to guess.
        assert_ne!(chain("gray", Tags::default(), false, None).samples, Samples::Guessed);
    }

    #[test]
    fn red_green_and_blue_get_other_names_alone() {
        for (format, bits, planes) in [
            ("rgb24", Some(8), ["format=gbrp", "yuv444p"]),
            ("bgra", Some(8), ["format=gbrp", "yuv444p"]),
            ("pal8", Some(8), ["format=gbrp", "yuv444p"]),
            ("rgb565le", Some(8), ["format=gbrp", "yuv444p"]),
            ("gbrp10le", Some(10), ["format=gbrp10", "yuv444p10"]),
            ("gbrap12le", Some(12), ["format=gbrp12", "yuv444p12"]),
            ("x2rgb10le", Some(10), ["format=gbrp10", "yuv444p10"]),
            ("rgb48be", Some(16), ["format=gbrp16", "yuv444p16"]),
            ("rgba64le", Some(16), ["format=gbrp16", "yuv444p16"]),
            ("gbrpf32le", Some(16), ["format=gbrp16", "yuv444p16"]),
            ("bayer_rggb16le", Some(16), ["format=gbrp16", "yuv444p16"]),
        ] {
            assert_eq!(rgb_bits(format), bits, "{format}");
            let found = chain(format, Tags::default(), false, None);
            let [from, to] = planes;
            assert_eq!(
                (found.filters, found.samples),
                (vec![format!("{from},mergeplanes=0x000102:{to}")], Samples::Rgb),
                "{format}"
            );
        }
        for format in ["yuv420p", "gray16le", "nv12", "ya8", "yuva444p10le", "xv36le", ""] {
            assert_eq!(rgb_bits(format), None, "{format}");
        }
    }

    #[test]
    fn what_is_done_is_told() {
        let found =
            chain("yuva420p", Tags::of(Some("bt2020nc"), Some("bt2020"), Some("bt2020-10")), true, Some((4, 3)));
        assert_eq!(
            found.notes,
            [
                "interlaced frames were deinterlaced",
                "pixels of 4:3 were made square",
                "BT.2020 was converted to BT.709",
                "the alpha plane is left out"
            ]
        );
        assert_eq!(found.samples, Samples::Matrix(Matrix::BT709));
    }
}

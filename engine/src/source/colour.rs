//! Colour of inputs: the meaning of a file's tags and the conversion for each. No other module decides it.
//!
//! | tag | conversion |
//! |---|---|
//! | matrix bt709, bt470bg, smpte170m, fcc, smpte240m, bt2020nc | [`Matrix`] of that standard, in our own arithmetic |
//! | matrix gbr, or an RGB format | none: samples are used unchanged |
//! | other matrices (bt2020c, ictcp, ycgco, chroma-derived) | ffmpeg's zscale filter converts to BT.709 |
//! | no matrix | by size: BT.709 above 1024 columns or 576 rows, else BT.601, the usual matrices of these sizes ([`Matrix::of_size`]) |
//! | range tv, pc | limited, full; untagged YCbCr is limited, untagged grey and RGB are full |
//! | primaries bt2020, smpte431, smpte432, film, bt470m | zscale converts to BT.709, with the curve of BT.1886 for the BT.709 family |
//! | other primaries | treated as BT.709's: those of BT.601 are close, and players do the same |
//! | transfer arib-std-b67, smpte2084 | high dynamic range: converted to BT.709 of standard range |
//! | transfer linear, log100, log316 | the curve of sRGB is applied |
//! | other transfers | none: samples are display-referred |
//!
//! A note names primaries and transfers that are neither converted nor BT.709's or its equals.

/// The factors of one Y'CbCr matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Matrix {
    /// Luma weight of red.
    pub kr: f32,
    /// Luma weight of blue.
    pub kb: f32,
}

impl Matrix {
    /// ITU-R BT.709.
    pub const BT709: Matrix = Matrix { kr: 0.2126, kb: 0.0722 };
    /// ITU-R BT.601; also BT.470 B/G, SMPTE 170M and JFIF (JPEG).
    pub const BT601: Matrix = Matrix { kr: 0.299, kb: 0.114 };
    /// FCC, 47 CFR 73.682 (1953).
    pub const FCC: Matrix = Matrix { kr: 0.30, kb: 0.11 };
    /// SMPTE 240M.
    pub const SMPTE240M: Matrix = Matrix { kr: 0.212, kb: 0.087 };
    /// ITU-R BT.2020 and BT.2100, not constant luminance.
    pub const BT2020: Matrix = Matrix { kr: 0.2627, kb: 0.0593 };
    /// Names for [`Matrix::named`].
    pub const NAMES: &[&str] = &["bt709", "bt601", "bt470bg", "smpte170m", "fcc", "smpte240m", "bt2020"];

    /// Returns the matrix for pictures of this size whose file does not name one.
    pub fn of_size(width: usize, height: usize) -> Matrix {
        if width > 1024 || height > 576 { Matrix::BT709 } else { Matrix::BT601 }
    }

    /// Returns the matrix of this name: one of [`Matrix::NAMES`] or ffmpeg's `bt2020nc`.
    pub fn named(name: &str) -> Option<Matrix> {
        Some(match name {
            "bt709" => Matrix::BT709,
            "bt601" | "bt470bg" | "smpte170m" => Matrix::BT601,
            "fcc" => Matrix::FCC,
            "smpte240m" => Matrix::SMPTE240M,
            "bt2020" | "bt2020nc" => Matrix::BT2020,
            _ => return None,
        })
    }

    /// Converts luma `y` in `[0, 1]` and chroma `b`, `r` in [−½,½] to red, green and blue.
    pub fn rgb(self, y: f32, b: f32, r: f32) -> [f32; 3] {
        let kg = 1.0 - self.kr - self.kb;
        let (to_r, to_b) = (2.0 * (1.0 - self.kr), 2.0 * (1.0 - self.kb));
        [y + to_r * r, (y - to_b * self.kb / kg * b) - to_r * self.kr / kg * r, y + to_b * b]
    }

    /// Converts a colour to luma in `[0, 1]` and chroma in [−½,½]: the inverse of [`Matrix::rgb`].
    pub fn ycbcr(self, [red, green, blue]: [f32; 3]) -> [f32; 3] {
        let kg = 1.0 - self.kr - self.kb;
        let y = self.kr * red + kg * green + self.kb * blue;
        [y, (blue - y) / (2.0 * (1.0 - self.kb)), (red - y) / (2.0 * (1.0 - self.kr))]
    }
}

/// Colour tags of a file, in ffmpeg's names; `None` for tags that are absent.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Tags {
    pub(super) matrix: Option<String>,
    pub(super) primaries: Option<String>,
    pub(super) transfer: Option<String>,
    /// `tv` or `pc`.
    pub(super) range: Option<String>,
}

/// A transfer curve of high dynamic range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Curve {
    /// Hybrid log-gamma (ARIB STD-B67, ITU-R BT.2100).
    Hlg,
    /// Perceptual quantiser (SMPTE ST 2084, ITU-R BT.2100).
    Pq,
}

/// Conversion of a stream's colours to red, green and blue of BT.709 and standard range.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Conversion {
    /// Samples are red, green and blue already.
    Rgb,
    /// Converted by our own arithmetic; `guessed`: the file does not name its matrix.
    Matrix { matrix: Matrix, guessed: bool },
    /// zscale converts it to BT.709 of standard range. `assumed` names the properties that the file does not state.
    HighRange { curve: Curve, assumed: String },
    /// zscale converts it to BT.709. `from` are the stream's tags, `options` the filter's.
    Zscale { from: String, options: String },
}

/// Names of matrices that zscale supports and our own arithmetic does not.
const ELSEWHERE: [&str; 6] = ["bt2020c", "ictcp", "ycgco", "chroma-derived-nc", "chroma-derived-c", "smpte2085"];
/// Primaries that are converted, with their names for people.
const WIDE: [(&str, &str); 5] = [
    ("bt2020", "BT.2020"),
    ("smpte431", "DCI-P3"),
    ("smpte432", "Display P3"),
    ("film", "generic film"),
    ("bt470m", "BT.470 M"),
];
/// Transfers that get the curve of sRGB, with their names for people.
const LIGHT: [(&str, &str); 3] =
    [("linear", "linear light"), ("log100", "logarithmic light"), ("log316", "logarithmic light")];
/// Transfers that zscale reads and writes; for others, BT.709's is used.
const CURVES: [&str; 5] = ["bt709", "smpte170m", "bt2020-10", "bt2020-12", "iec61966-2-1"];

impl Tags {
    /// Parses tags in ffmpeg's names; `unknown` and `reserved` count as absent.
    pub(super) fn of(matrix: Option<&str>, primaries: Option<&str>, transfer: Option<&str>) -> Tags {
        let known = |name: Option<&str>| {
            name.filter(|name| !["unknown", "unspecified", "reserved", ""].contains(name)).map(ToOwned::to_owned)
        };
        Tags { matrix: known(matrix), primaries: known(primaries), transfer: known(transfer), range: None }
    }

    /// Adds the range, if its name is known.
    pub(super) fn with_range(self, name: Option<&str>) -> Tags {
        Tags { range: name.filter(|name| ["tv", "pc"].contains(name)).map(ToOwned::to_owned), ..self }
    }

    /// Returns the conversion of pictures with these tags. `rgb`: their format is red, green and blue; `grey`: luma
    /// alone. `given` replaces the file's matrix.
    pub(super) fn conversion(&self, size: (usize, usize), rgb: bool, grey: bool, given: Option<Matrix>) -> Conversion {
        let tag = self.matrix.as_deref().filter(|name| rgb || *name != "gbr");
        let curve = match self.transfer.as_deref() {
            Some("arib-std-b67") => Some(Curve::Hlg),
            Some("smpte2084") => Some(Curve::Pq),
            _ => None,
        };
        if let Some(curve) = curve {
            let matrix = if tag.is_some() || rgb { "" } else { ":min=2020_ncl" };
            let primaries = if self.primaries.is_some() { "" } else { ":pin=2020" };
            return Conversion::HighRange { curve, assumed: format!("{matrix}{primaries}") };
        }
        let wide = WIDE.iter().find(|(name, _)| self.primaries.as_deref() == Some(name));
        let light = LIGHT.iter().find(|(name, _)| self.transfer.as_deref() == Some(name));
        let elsewhere = tag.filter(|name| !rgb && given.is_none() && ELSEWHERE.contains(name));
        if wide.is_some() || light.is_some() || elsewhere.is_some() {
            let mut options = String::new();
            let mut from = Vec::new();
            let transfer = self.transfer.as_deref().filter(|name| light.is_some() || CURVES.contains(name));
            if transfer.is_none() {
                // The filters need a transfer to convert to linear light.
                options += ":tin=bt709";
            }
            if let Some((_, name)) = light {
                options += ":t=iec61966-2-1";
                from.push(*name);
            } else {
                // The curve does not change: input and output of the filter have the same one.
                options += &format!(":t={}", transfer.unwrap_or("bt709"));
            }
            if let Some((_, name)) = wide {
                from.push(*name);
            } else {
                // No conversion of primaries: input and output have the same ones.
                options += ":pin=bt709";
            }
            if let Some(name) = elsewhere {
                from.push(name);
            } else if !rgb {
                let named = given.or_else(|| tag.and_then(Matrix::named)).unwrap_or(Matrix::of_size(size.0, size.1));
                options += &format!(":min={}", zimg_name(named));
            }
            options += ":p=bt709";
            return Conversion::Zscale { from: from.join(", "), options };
        }
        if rgb {
            return Conversion::Rgb;
        }
        let named = given.or_else(|| tag.and_then(Matrix::named));
        // Luma needs no matrix.
        let guessed = named.is_none() && !grey;
        Conversion::Matrix { matrix: named.unwrap_or(Matrix::of_size(size.0, size.1)), guessed }
    }
}

impl Tags {
    /// Returns a note for each tag that is taken as if it were BT.709's.
    pub(super) fn assumed(&self) -> Vec<String> {
        let known = |table: &[(&str, &str)], name: &str| table.iter().any(|(known, _)| *known == name);
        let primaries = self.primaries.as_deref().filter(|name| *name != "bt709" && !known(&WIDE, name));
        let transfer = self.transfer.as_deref().filter(|name| {
            !known(&LIGHT, name) && !CURVES.contains(name) && !["arib-std-b67", "smpte2084"].contains(name)
        });
        let note = |what: &str, name: &str| format!("the {what} {name} taken as BT.709's");
        let primaries = primaries.map(|name| note("primaries", &format!("{name} are")));
        primaries.into_iter().chain(transfer.map(|name| note("transfer", &format!("{name} is")))).collect()
    }
}

/// Returns the note on a matrix chosen by size.
pub(super) fn guessed(matrix: Matrix) -> String {
    let matrix = title(matrix);
    format!("the matrix is not stated: {matrix} was taken by the size of the pictures (--matrix takes another)")
}

/// Returns a matrix's name for zscale.
fn zimg_name(matrix: Matrix) -> &'static str {
    match matrix {
        Matrix::BT709 => "709",
        Matrix::FCC => "fcc",
        Matrix::SMPTE240M => "240m",
        Matrix::BT2020 => "2020_ncl",
        _ => "170m",
    }
}

/// Returns a matrix's name for messages.
fn title(matrix: Matrix) -> &'static str {
    match matrix {
        Matrix::BT709 => "BT.709",
        Matrix::FCC => "FCC",
        Matrix::SMPTE240M => "SMPTE 240M",
        Matrix::BT2020 => "BT.2020",
        _ => "BT.601",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_matrix_and_its_inverse_agree() {
        for name in Matrix::NAMES {
            let matrix = Matrix::named(name).expect("a name of the list");
            for colour in [[1.0, 0.0, 0.0], [0.2, 0.7, 0.4], [1.0, 1.0, 1.0]] {
                let [y, b, r] = matrix.ycbcr(colour);
                for (found, expected) in matrix.rgb(y, b, r).iter().zip(colour) {
                    assert!((found - expected).abs() < 1e-6);
                }
            }
        }
    }

    #[test]
    fn matrices_have_the_coefficients_of_their_standards() {
        // Cr's and Cb's factors for red and blue: BT.709 1.5748 and 1.8556, BT.601 1.402 and 1.772, BT.2020 1.4746 and
        // 1.8814, SMPTE 240M 1.576 and 1.826, FCC 1.4 and 1.78.
        for (name, red, blue) in [
            ("bt709", 1.5748, 1.8556),
            ("bt470bg", 1.402, 1.772),
            ("smpte170m", 1.402, 1.772),
            ("bt2020nc", 1.4746, 1.8814),
            ("smpte240m", 1.576, 1.826),
            ("fcc", 1.4, 1.78),
        ] {
            let matrix = Matrix::named(name).expect("known");
            let found = [matrix.rgb(0.0, 0.0, 1.0)[0], matrix.rgb(0.0, 1.0, 0.0)[2]];
            assert!((found[0] - red).abs() < 1e-4 && (found[1] - blue).abs() < 1e-4, "{name}: {found:?}");
        }
        assert_eq!(Matrix::named("gbr"), None);
    }

    fn tags(matrix: &str, primaries: &str, transfer: &str) -> Tags {
        Tags::of(Some(matrix), Some(primaries), Some(transfer))
    }

    #[test]
    fn tags_that_are_not_converted_are_told() {
        for (primaries, transfer, expected) in [
            ("bt709", "bt709", &[][..]),
            ("bt2020", "arib-std-b67", &[]),
            ("film", "log100", &[]),
            ("unknown", "iec61966-2-1", &[]),
            (
                "smpte170m",
                "bt470bg",
                &["the primaries smpte170m are taken as BT.709's", "the transfer bt470bg is taken as BT.709's"],
            ),
        ] {
            assert_eq!(tags("bt709", primaries, transfer).assumed(), expected, "{primaries} {transfer}");
        }
        let film = tags("bt709", "film", "log100").conversion((320, 180), false, false, None);
        let Conversion::Zscale { from, options } = film else { panic!("{film:?}") };
        assert_eq!((&from[..], &options[..]), ("logarithmic light, generic film", ":t=iec61966-2-1:min=709:p=bt709"));
    }

    #[test]
    fn tags_go_before_the_size_and_options_before_tags() {
        let of = |tags: Tags, size, given| match tags.conversion(size, false, false, given) {
            Conversion::Matrix { matrix, guessed } => (matrix, guessed),
            other => panic!("{other:?}"),
        };
        let (small, large) = ((320, 180), (1280, 720));
        assert_eq!(of(tags("bt709", "bt709", "bt709"), small, None), (Matrix::BT709, false));
        assert_eq!(of(tags("smpte170m", "smpte170m", "smpte170m"), large, None), (Matrix::BT601, false));
        assert_eq!(of(tags("bt470bg", "unknown", "unknown"), large, None), (Matrix::BT601, false));
        assert_eq!(of(tags("bt2020nc", "unknown", "unknown"), large, None), (Matrix::BT2020, false));
        assert_eq!(of(Tags::default(), small, None), (Matrix::BT601, true));
        assert_eq!(of(Tags::default(), large, None), (Matrix::BT709, true));
        // A matrix tag that contradicts the sample format is ignored.
        assert_eq!(of(tags("gbr", "bt709", "bt709"), small, None), (Matrix::BT601, true));
        assert_eq!(of(tags("bt709", "bt709", "bt709"), small, Some(Matrix::FCC)), (Matrix::FCC, false));
        assert_eq!(of(Tags::default(), small, Some(Matrix::BT709)), (Matrix::BT709, false));
    }

    #[test]
    fn what_our_own_arithmetic_does_not_have_goes_through_zscale() {
        let of = |tags: Tags, rgb| tags.conversion((320, 180), rgb, false, None);
        let zscale = |from: &str, options: &str| Conversion::Zscale { from: from.into(), options: options.into() };
        assert_eq!(
            of(tags("bt2020nc", "bt2020", "bt2020-10"), false),
            zscale("BT.2020", ":t=bt2020-10:min=2020_ncl:p=bt709")
        );
        assert_eq!(
            of(tags("unknown", "bt2020", "unknown"), false),
            zscale("BT.2020", ":tin=bt709:t=bt709:min=170m:p=bt709")
        );
        assert_eq!(of(tags("bt709", "smpte432", "bt709"), false), zscale("Display P3", ":t=bt709:min=709:p=bt709"));
        assert_eq!(
            of(tags("ycgco", "bt709", "iec61966-2-1"), false),
            zscale("ycgco", ":t=iec61966-2-1:pin=bt709:p=bt709")
        );
        assert_eq!(
            of(tags("gbr", "unknown", "linear"), true),
            zscale("linear light", ":t=iec61966-2-1:pin=bt709:p=bt709")
        );
        assert_eq!(of(tags("gbr", "bt709", "iec61966-2-1"), true), Conversion::Rgb);
        assert_eq!(of(Tags::default(), true), Conversion::Rgb);
        let high = |curve, assumed: &str| Conversion::HighRange { curve, assumed: assumed.into() };
        assert_eq!(of(tags("bt2020nc", "bt2020", "smpte2084"), false), high(Curve::Pq, ""));
        assert_eq!(of(tags("unknown", "unknown", "arib-std-b67"), false), high(Curve::Hlg, ":min=2020_ncl:pin=2020"));
        assert_eq!(of(tags("gbr", "bt2020", "smpte2084"), true), high(Curve::Pq, ""));
    }
}

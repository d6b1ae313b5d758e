//! The colour space of an EXR part, from its attributes.

use super::light::{self, Curve};
use crate::openexr::{Chromaticities, Part};

/// Colour space of samples.
pub(super) struct Space {
    /// Its name, or the attribute that defines it; `None` if the file has neither.
    name: Option<String>,
    curve: Curve,
    /// Matrix to BT.709's primaries, if the file's are others.
    matrix: Option<[[f64; 3]; 3]>,
}

impl Space {
    pub fn of(part: Part<'_>) -> Result<Space, String> {
        let said = |name: &str| part.text(name).filter(|text| !text.trim().is_empty() && text != "unknown");
        let space = |name: Option<String>, curve: Curve, primaries: Chromaticities| {
            Ok(Space { name, curve, matrix: light::to_rec709(primaries)? })
        };
        if let Some(name) = said("colorInteropID").or_else(|| said("oiio:ColorSpace")) {
            let (curve, primaries) = named(&name)?;
            let primaries = primaries.or(part.chromaticities()).unwrap_or(light::REC709);
            return space(Some(name), curve, primaries);
        }
        match part.chromaticities() {
            Some(primaries) => space(Some("its chromaticities".to_owned()), Curve::Linear, primaries),
            None if part.integer("acesImageContainerFlag") == Some(1) => {
                let name = Some("ACES2065-1".to_owned());
                space(name, Curve::Linear, light::primaries("ap0").unwrap_or(light::REC709))
            }
            None => space(None, Curve::Linear, light::REC709),
        }
    }

    /// Returns true if the samples are display-referred.
    pub fn is_shown(&self) -> bool {
        self.curve == Curve::Srgb && self.matrix.is_none()
    }

    pub fn note(&self) -> Option<String> {
        match &self.name {
            _ if self.is_shown() => None,
            None => Some(
                "EXR colours are linear light of BT.709's primaries, as the file does not say: converted to sRGB"
                    .to_owned(),
            ),
            Some(name) => Some(format!("EXR colours are converted from {name} to sRGB")),
        }
    }

    /// Converts pixels of `colours` samples each, followed by alpha if `alpha`, to display-referred colours over mid
    /// grey.
    pub fn shown(&self, samples: &[f32], colours: usize, alpha: bool) -> Vec<f32> {
        let channels = colours + usize::from(alpha);
        let mut shown = Vec::with_capacity(samples.len() / channels * colours);
        for pixel in samples.chunks_exact(channels) {
            let behind = if alpha { light::BEHIND * (1.0 - f64::from(pixel[colours].clamp(0.0, 1.0))) } else { 0.0 };
            if behind == 0.0 && self.curve == Curve::Linear && self.matrix.is_none() {
                shown.extend(pixel[..colours].iter().map(|&light| light::sample(light)));
                continue;
            }
            let mut light = [0, 1, 2].map(|c| self.curve.light(f64::from(pixel[c.min(colours - 1)])));
            // Grey has no primaries.
            if let Some(matrix) = self.matrix.as_ref().filter(|_| colours == 3) {
                light = light::applied(matrix, light);
            }
            shown.extend(light[..colours].iter().map(|&light| light::to_srgb(light + behind) as f32));
        }
        shown
    }
}

/// Returns curve and primaries of a named space: an identifier of the Color Interop Forum, or a name of OpenImageIO or
/// of OpenColorIO's configurations. Primaries of `None` mean those of the file.
fn named(name: &str) -> Result<(Curve, Option<Chromaticities>), String> {
    let plain: String =
        name.trim().to_ascii_lowercase().chars().map(|c| if c == ' ' || c == '-' { '_' } else { c }).collect();
    let plain = plain.trim_end_matches("_scene").trim_end_matches("_display");
    let known = |curve: Curve, primaries: &str| Ok((curve, light::primaries(primaries)));
    match plain {
        "lin" | "linear" | "scene_linear" => return Ok((Curve::Linear, None)),
        "lin_srgb" | "srgb_linear" | "linear_srgb" | "linear_rec.709" | "linear_rec.709_(srgb)" | "linear_rec709" => {
            return known(Curve::Linear, "rec709");
        }
        "linear_rec.2020" => return known(Curve::Linear, "rec2020"),
        "linear_p3_d65" => return known(Curve::Linear, "p3d65"),
        "acescg" | "aces___acescg" => return known(Curve::Linear, "ap1"),
        "aces2065_1" | "aces___aces2065_1" => return known(Curve::Linear, "ap0"),
        // Video's samples are used as they are, as for video files.
        "srgb" | "srgb_tx" | "srgb_texture" | "srgb___texture" | "rec709" | "g24_rec709" => {
            return known(Curve::Srgb, "rec709");
        }
        "adobergb" => return known(Curve::Gamma(22), "adobergb"),
        "data" | "raw" | "non_color" | "utility___raw" => {
            return Err(format!("expected colours, found samples that the file calls {name}"));
        }
        _ => {}
    }
    let space = plain.split_once('_').and_then(|(curve, primaries)| {
        let curve = match curve {
            "lin" => Curve::Linear,
            "srgb" => Curve::Srgb,
            _ => gamma(curve.strip_prefix('g')?)?,
        };
        Some((curve, Some(light::primaries(primaries)?)))
    });
    // Names such as OpenImageIO's "Gamma2.2".
    let power =
        || plain.strip_prefix("gamma").and_then(|digits| gamma(&digits.replacen('.', "", 1))).map(|g| (g, None));
    space.or_else(power).ok_or_else(|| {
        format!(
            "the EXR colour space {name} is not known here; oiiotool IN --colorconvert \"{name}\" lin_rec709 -o OUT converts it"
        )
    })
}

/// Returns the power curve with the exponent in two digits.
fn gamma(digits: &str) -> Option<Curve> {
    digits.parse().ok().filter(|gamma| digits.len() == 2 && (10..=30).contains(gamma)).map(Curve::Gamma)
}

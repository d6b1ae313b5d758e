//! How α falls from a Gaussian's centre to its edge, and where the footprint ends.

use crate::simd::Simd;

/// Least α that is drawn; a Gaussian of a lower opacity reaches no pixel.
pub const ALPHA_MIN: f32 = 1.0 / 255.0;
/// An alpha above this is lowered to it.
const ALPHA_MAX: f32 = 0.99;
/// A pixel is finished when the next splat would take its transmittance below this.
const TRANSMITTANCE_MIN: f32 = 1e-4;

/// How α falls with the distance d from a Gaussian's centre, in standard deviations: `α = min(0.99, o·g·(e^(−d²/2) −
/// f))`, skipped where it is under 1/255.
///
/// The last two reproduce programs whose footprints fall to 0 at an edge. Both numbers are rounded to binary32 once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Falloff {
    /// g = 1, f = 0: the Gaussian itself.
    #[default]
    Gaussian,
    /// g = 1, f = e^(−9/2): 0 from three standard deviations on, as splat-transform draws.
    SplatTransform,
    /// f = e^(−4), g = 1/(1 − f): 0 from √8 standard deviations on, as PlayCanvas's engine draws.
    PlayCanvas,
}

impl Falloff {
    /// All of them.
    pub const ALL: &'static [Falloff] = &[Falloff::Gaussian, Falloff::SplatTransform, Falloff::PlayCanvas];

    /// Its name in options and records.
    pub fn name(self) -> &'static str {
        match self {
            Falloff::Gaussian => "gaussian",
            Falloff::SplatTransform => "splat-transform",
            Falloff::PlayCanvas => "playcanvas",
        }
    }

    /// g and f.
    pub(super) fn gain_and_floor(self) -> [f64; 2] {
        match self {
            Falloff::Gaussian => [1.0, 0.0],
            Falloff::SplatTransform => [1.0, 0.011_108_996_538_242_306],
            Falloff::PlayCanvas => [1.018_657_360_363_774_2, 0.018_315_638_888_734_18],
        }
    }
}

/// A camera whose lens has a width: things out of focus are blurred.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Defocus {
    /// Diameter of the entrance pupil, in the scene's units. Not below 0.
    pub aperture: f32,
    /// Depth of the plane in focus. Above 0; infinite: distant things are in focus.
    pub focus: f32,
}

impl Defocus {
    /// Returns true if both numbers are in their ranges.
    pub fn is_usable(&self) -> bool {
        self.aperture >= 0.0 && self.aperture.is_finite() && self.focus > 0.0
    }
}

/// Least α that is drawn through a lens with a width: a Gaussian spread over many pixels is still visible where several
/// add up.
pub(super) const BLURRED_ALPHA_MIN: f32 = 1.0 / 65_536.0;

/// Added to the exponent at which a footprint ends, so that no rounding in the blend reaches beyond it.
const EXPONENT_MARGIN: f32 = 0.02;
/// The largest excess of log₂(1 + m) over m.
const EXCESS: f32 = 0.0861;

/// The ends of footprints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cut {
    gain: f32,
    floor: f32,
    /// Least α that is drawn.
    pub least: f32,
    /// An α above this is lowered to it.
    pub most: f32,
    /// A pixel is finished when the next splat would take its transmittance below this.
    pub end: f32,
    /// log₂(1/least), and the constant that [`reach`](Self::reach) adds.
    base: f32,
}

impl Cut {
    pub(super) const GAUSSIAN: Cut = Cut {
        gain: 1.0,
        floor: 0.0,
        least: ALPHA_MIN,
        most: ALPHA_MAX,
        end: TRANSMITTANCE_MIN,
        base: 7.994_354 + EXCESS + EXPONENT_MARGIN,
    };

    /// The same with another largest α, and with pixels finished at another transmittance.
    pub(super) fn with_bounds(self, most: f32, end: f32) -> Self {
        Self { most, end, ..self }
    }

    pub(super) fn new(falloff: Falloff, blurred: bool) -> Self {
        let [gain, floor] = falloff.gain_and_floor().map(|v| v as f32);
        let (least, base) = if blurred {
            (BLURRED_ALPHA_MIN, 16.0 + EXCESS + EXPONENT_MARGIN)
        } else {
            (ALPHA_MIN, Self::GAUSSIAN.base)
        };
        Self { gain, floor, least, base, ..Self::GAUSSIAN }
    }

    /// −f, so that `opacity·(2^−e + dip)` is α.
    #[inline(always)]
    pub(super) fn dip(&self) -> f32 {
        -self.floor
    }

    /// `o·g`, the exponent at which α is `least` or a little more of it, and which Gaussians can be drawn at all.
    ///
    /// α ≥ least where `2^−e ≥ least/(o·g) + f`, that is where `e ≤ log₂(o′/least)` with `o′ = o·g / (1 +
    /// o·g·f/least)`.
    #[inline(always)]
    pub(super) fn apply<S: Simd>(&self, s: S, opacity: S::F32) -> (S::F32, S::F32, S::Mask) {
        let opaque = s.le(s.splat(self.least), opacity);
        if self.floor == 0.0 {
            return (opacity, self.reach(s, opacity), opaque);
        }
        let opacity = s.mul(opacity, s.splat(self.gain));
        let share = s.mul_add(opacity, s.splat(self.floor / self.least), s.splat(1.0));
        let above = s.div(opacity, share);
        // The threshold is a little lower, so that no rounding here leaves out a Gaussian that the blend would draw.
        let opaque = s.and(opaque, s.le(s.splat(self.least * (1.0 - 1e-5)), above));
        (opacity, self.reach(s, above), opaque)
    }

    /// At least `log₂(opacity/least)`, at most 0.11 above it, for opacities from `least` on.
    #[inline(always)]
    fn reach<S: Simd>(&self, s: S, opacity: S::F32) -> S::F32 {
        let bits = s.to_bits(opacity);
        let exponent = s.to_f32(s.sub_i32(s.shr::<23>(bits), s.splat_i32(127)));
        let fraction = s.or_i32(s.and_i32(bits, s.splat_i32(0x007f_ffff)), s.splat_i32(0x3f80_0000));
        let mantissa = s.sub(s.from_bits(fraction), s.splat(1.0));
        s.add(s.add(exponent, mantissa), s.splat(self.base))
    }
}

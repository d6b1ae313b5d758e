//! Parameters of the flow, and the sizes of frames that it accepts.

use std::fmt;

/// Rows and columns of a patch.
pub(super) const PATCH: usize = 8;

/// Parameters of the flow. The weights are from 0 to 10⁶; [`Pyramid::new`](super::Pyramid::new) refuses others.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// The finest scale of the search: its pixels are 2ᵏ wide. The flow is enlarged from there.
    pub finest: usize,
    /// Pixels from one patch to the next, 1 to 8.
    pub stride: usize,
    /// Steps of a patch's descent, at most.
    pub iterations: usize,
    /// Fixed-point iterations of the variational refinement at every scale.
    pub refinement: usize,
    /// Weight α of smoothness in the refinement.
    pub smoothness: f32,
    /// Weight δ of constant brightness.
    pub brightness: f32,
    /// Weight γ of constant gradients.
    pub gradient: f32,
}

impl Default for Options {
    fn default() -> Self {
        Self { finest: 1, stride: 3, iterations: 12, refinement: 5, smoothness: 20.0, brightness: 5.0, gradient: 10.0 }
    }
}

impl Options {
    /// The largest weight of a term: sums of squared gradients times it stay far below the largest binary32 number.
    pub(super) const MAX_WEIGHT: f32 = 1e6;

    /// Refuses weights with which the refinement has no finite solution.
    pub(super) fn check(&self) -> Result<(), FlowError> {
        let weights = [("smoothness", self.smoothness), ("brightness", self.brightness), ("gradient", self.gradient)];
        match weights.into_iter().find(|(_, weight)| !(0.0..=Self::MAX_WEIGHT).contains(weight)) {
            Some((name, weight)) => Err(FlowError::Weight { name, bits: weight.to_bits() }),
            None => Ok(()),
        }
    }

    /// The coarsest scale: the longer side has about four patches there, the shorter one at least one.
    pub(super) fn coarsest(&self, [h, w]: [usize; 2]) -> usize {
        let (long, short) = (h.max(w), h.min(w));
        let mut scale = 0;
        // log₂(long / (4 · 8)) rounded, and log₂(short / 8) cut off.
        while (long as f64) >= 32.0 * std::f64::consts::SQRT_2 * f64::from(1_u32 << scale)
            && short >> (scale + 1) >= PATCH
        {
            scale += 1;
        }
        scale
    }
}

/// A frame or options for which no flow can be computed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FlowError {
    /// A value of the frame is NaN or infinite; the first of them.
    NotFinite {
        /// Its row.
        row: usize,
        /// Its column.
        column: usize,
    },
    /// There are no pixels, or too many.
    Size {
        /// Rows and columns of the frame.
        size: [usize; 2],
    },
    /// A weight of the options is NaN, negative, or larger than 10⁶.
    Weight {
        /// The option.
        name: &'static str,
        /// Its bits.
        bits: u32,
    },
}

impl FlowError {
    /// The longest side of a frame.
    pub(super) const LONGEST: usize = 1 << 16;
    /// Pixels of the largest frame.
    pub(super) const MOST: usize = 1 << 28;

    /// Returns true if a frame of this size has pixels, and not too many: every coordinate in it is a binary32 number.
    pub(super) const fn allows([h, w]: [usize; 2]) -> bool {
        h > 0 && w > 0 && h <= Self::LONGEST && w <= Self::LONGEST && h * w <= Self::MOST
    }
}

impl fmt::Display for FlowError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            FlowError::NotFinite { row, column } => {
                write!(f, "the luma at row {row}, column {column} is not finite: optical flow needs finite values")
            }
            FlowError::Size { size: [h, w] } => {
                let (longest, most) = (Self::LONGEST, Self::MOST);
                write!(
                    f,
                    "a frame of {h}×{w} pixels has no optical flow: expected sides from 1 to {longest}, at most {most} pixels"
                )
            }
            FlowError::Weight { name, bits } => {
                let (most, found) = (Options::MAX_WEIGHT, f32::from_bits(*bits));
                write!(f, "the flow's {name}: expected a weight from 0 to {most}, found {found}")
            }
        }
    }
}

impl std::error::Error for FlowError {}

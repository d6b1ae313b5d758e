//! Static blocks of the picture keep their Gaussians.
//!
//! A picture is divided into blocks of [`BLOCK`]×[`BLOCK`] pixels. For each block the stream holds the mean of the
//! frames since its Gaussians were computed. Over an interval, let d be the difference of a frame from that mean, m the
//! number of frames in the mean, and μ the mean of d per channel. Then the block
//!
//! ```text
//! rests    where in every frame   rms(d) ≤ R and rms of d's means over 4×4 pixels ≤ S,
//!                                 or rms(d − μ) ≤ C, that of its means ≤ 0.8·C, and |μ| small
//! drifts   where in every frame   the same of d − μ, |μ| ≤ D, and |μ − t·μ(key frame)| ≤ S
//! changes  otherwise
//!
//! σ = the 40th percentile of rms(d)/√(1 + 1/m) over blocks and frames
//! R = MARGIN·σ·√(1 + 1/m) + ROUNDING     S = R/2     C = 2/255, or 3/255 (`StaticRegions::Loose`)
//! ```
//!
//! The second line counts where the noise is that of a codec: where it is not white, or less than the rounding of
//! 8-bit frames. A codec updates blocks at different times, so that the differences of quiet blocks are neither small
//! nor white. There a block that stays within C of its mean is kept, and |μ| and |μ − t·μ(key frame)| may be
//! [`CLOSE_MEAN`].
//!
//! σ estimates the camera's noise, at most [`MOST_NOISE`] where it is white and [`MOST_CHANGE`] where it is not. Means
//! over 4×4 pixels of white noise have a quarter of its deviation; motion and a codec's artefacts change them nearly as
//! much as the pixels. Noise counts as white where their ratio is less than [`WHITE`], over the blocks and frames up to
//! the percentile. A block that rests or drifts keeps its Gaussians: one record per Gaussian through the interval,
//! without motion and without fading. The frames of a block that rests enter its mean; the mean of a block that drifts
//! moves by μ.
//!
//! Blocks are kept only where they are a share of [`LEAST`] of those with a texture. The camera is static there, and
//! where a share of [`STATIC`] of the blocks with a texture has rms(d − μ) ≤ [`STEADY`] in every frame. A static
//! camera's frames are alike: of many in between every second one is used for motion and colours. With `refine_every`
//! of 1 colours are also fitted to the others, in the blocks that differ from the mean of their neighbours in time.
//!
//! Colours of kept Gaussians follow the mean. They are fitted to it again when the block drifts, when the mean holds
//! twice as many frames as at the last fit, and when its means over 4×4 pixels have moved by more than [`FOLLOWED`]
//! since. Over that interval they change linearly, so that crossing a key frame changes no bit.
//!
//! # Order of operations
//!
//! Sums over 4×4 pixels are binary32: each column from top to bottom, then the columns as (a + b) + (c + d). Sums of
//! those are binary64, block by block: a function of the pictures alone.
//!
//! [`CLOSE_MEAN`]: camera::CLOSE_MEAN
//! [`MOST_NOISE`]: camera::MOST_NOISE
//! [`MOST_CHANGE`]: camera::MOST_CHANGE
//! [`WHITE`]: camera::WHITE
//! [`LEAST`]: camera::LEAST
//! [`STATIC`]: camera::STATIC
//! [`STEADY`]: camera::STEADY
//! [`FOLLOWED`]: kept::FOLLOWED

mod blocks;
mod camera;
mod gaussians;
mod kept;
mod past;
mod state;

pub(in crate::stream) use blocks::Blocks;
pub(in crate::stream) use camera::Camera;
pub(in crate::stream) use gaussians::{Keeps, Lattice, with_kept};
pub(in crate::stream) use kept::Kept;
pub use past::Past;
pub use state::KeptState;

/// Side of a block, in pixels.
const BLOCK: usize = 16;
/// Side of the cells of a block whose means are compared.
const CELL: usize = 4;

/// What happens to a block over an interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::stream) enum Change {
    /// Its Gaussians are kept with their colours.
    None,
    /// Its Gaussians are kept; their colours change.
    Colours,
    /// Its Gaussians are computed.
    All,
}

#[cfg(test)]
mod tests;

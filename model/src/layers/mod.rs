//! The layers of all parts: weights packed at load, applied to row-major matrices of tokens.

mod attention;
mod block;
mod feed_forward;
mod layer_norm;
mod linear;
mod norm;
mod pointwise;
mod position;
mod workspace;

pub(crate) use attention::{CrossAttention, SelfAttention, attend_kept};
pub(crate) use block::{Block, windows};
pub(crate) use feed_forward::FeedForward;
pub(crate) use layer_norm::LayerNorm;
pub(crate) use linear::{Bias, Linear};
pub(crate) use norm::RmsNorm;
pub(crate) use pointwise::load_pointwise;
pub(crate) use position::{add, add_zero, sinusoid};
pub(crate) use workspace::{Workspace, Workspaces, sized};

/// Channels of a head.
pub(crate) const HEAD: usize = 64;

//! From an interval, a time and a camera to an image.
//!
//! The Gaussians are taken to the time ([`Record::position_at`](crate::stream::Record::position_at) and
//! [`opacity_at`](crate::stream::Record::opacity_at)), into scene space, and into the camera's view, which the kernels rasterise.
//! Scene space is x right, y down, z forward with
//!
//! ```text
//! z = 1 / (9.8·y + 0.2 + 10⁻⁶)   for normalised inverse depths y in [0, 1]; Gaussians outside are not drawn
//! ```
//!
//! and standard deviations (s_x, s_z, s_y) along these axes (StreamSplat (ICLR 2026), camera and image). The canonical camera is
//! axis-aligned, so its splats need no rotation; other cameras turn every Gaussian by the opposite of their own rotation.
//!
//! A canonical image shows the content of the model's input, without the border that the frame's shape left. Its Gaussians
//! are drawn at the size asked for, not scaled from an image.

mod options;
mod view;

pub use options::{RenderError, RenderOptions, Size};
pub use view::{Lens, Snapshot, View};

//! The stream: ordinary video in, a dynamic scene of 3D Gaussians out, one key frame at a time.
//!
//! An [`Engine`] takes key frames with time stamps. Each gives an [`Interval`]: the Gaussians that can be seen between the
//! key frame before and this one, which can be drawn at any time in between, from any [`Camera`], at any size.
//! Nothing of this needs a file system, and nothing depends on the machine: the output bits are one function of the model,
//! the frames and the [`Settings`], whatever the instruction-set level and the number of threads.
//!
//! Around it: [`source`] reads videos and [`depth`] their depth maps, [`output`] and [`scene`] write and read results,
//! [`metrics`] measures them.
#![deny(unsafe_code)]

pub mod camera;
pub mod depth;
pub mod fit;
pub mod metrics;
pub mod openexr;
pub mod output;
pub mod picture;
pub mod render;
pub mod scene;
pub mod source;
pub mod stream;

pub use camera::Camera;
pub use render::{RenderError, RenderOptions, Size};
pub use stream::{Engine, EngineError, Frame, Interval, Settings};

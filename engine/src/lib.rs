//! The stream: ordinary video in, a dynamic scene of 3D Gaussians out, one key frame at a time.
//!
//! An [`Engine`] takes key frames with time stamps. Each returns an [`Interval`]: the Gaussians that can be seen
//! between the key frame before and this one, which can be drawn at any time in between, from any [`Camera`], at any
//! size. Nothing of this needs a file system, and nothing depends on the machine: the output bits are one function of
//! the model, the frames and the [`Settings`], on every instruction-set level and for any number of threads.
//!
//! ```
//! use streamsplat::{Camera, Engine, Frame, RenderOptions, Settings};
//!
//! // The small model inside the library; any other through `Settings::model`.
//! let mut engine = Engine::new(Settings::default())?;
//!
//! // Two frames of a video: red, green and blue planes in [0, 1]. Any size.
//! let (width, height) = (128, 72);
//! let frame = |shift: usize| {
//!     let pixel = |i: usize| ((i % width + shift) / 8 % 2) as f32;
//!     Frame { width, height, rgb: (0..3 * width * height).map(pixel).collect(), depth: None }
//! };
//! engine.push(frame(0), 0.0)?;
//! let interval = engine.push(frame(2), 0.2)?;
//!
//! // The scene between them, at any time, from any camera.
//! let image = interval.render(0.1, &Camera::Canonical, &RenderOptions::default(), engine.workers())?;
//! assert_eq!((image.width, image.height), (width, height));
//! assert!(image.rgb.iter().all(|x| x.is_finite()));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! A splat file becomes an image in eight lines: [`still`].
//!
//! Related modules: [`source`] reads videos, [`gap`] chooses key frames, and [`depth`] returns their depth maps, from
//! files or a network ([`onnx`]). [`output`] and [`scene`] write and read results, [`formats`] still scenes of other
//! programs, and [`mod@open`] scenes of any kind. [`view`] shows scenes in a browser. [`metrics`] and [`lpips`] measure
//! pictures, [`track`] follows points through time, and [`difference`] measures how far two pictures differ and where.
//!
//! Features: `onnx` ([`onnx`], [`lpips`], networks of [`depth`]) and `viewer` ([`view`]) are on unless turned off;
//! `wgpu` draws on graphics cards, outside of the bit contract.
#![deny(unsafe_code)]

pub mod camera;
pub mod choice;
pub mod depth;
pub mod difference;
pub mod fit;
pub mod folder;
pub mod formats;
pub mod gap;
#[cfg(feature = "onnx")]
pub mod lpips;
pub mod metrics;
#[cfg(feature = "onnx")]
pub mod onnx;
pub mod open;
pub mod openexr;
pub mod output;
pub mod parallax;
pub mod picture;
pub mod raster;
pub mod recognise;
pub mod render;
pub mod run;
pub mod samples;
pub mod scene;
pub mod source;
pub mod space;
pub mod still;
pub mod stream;
pub mod track;
#[cfg(feature = "viewer")]
pub mod view;
#[cfg(feature = "wgpu")]
pub mod wgpu;
pub mod world;

pub use camera::Camera;
pub use render::{Image, RenderError, RenderOptions, Size};
pub use stream::{Engine, EngineError, Frame, Interval, Settings, Workers};
pub use streamsplat_kernels::Level;
/// The crates whose types appear in this one's functions, in the versions it was built with.
pub use {streamsplat_kernels as kernels, streamsplat_model as model};

/// The version of the bit contract that this library keeps: the same model, frames and options produce the same bytes
/// wherever this number is the same. A release that changes an output bit changes this number (`docs/bit-contract.md`).
pub const BIT_CONTRACT: u32 = 1;

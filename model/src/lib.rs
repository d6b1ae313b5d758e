//! The StreamSplat network on CPUs, for one pair of frames.
//!
//! StreamSplat (Wu, Yan, Yi, Wang, Liao: "StreamSplat: Towards Online Dynamic 3D Reconstruction from Uncalibrated Video
//! Streams", ICLR 2026) turns each frame into static Gaussians and each pair of frames into the motion between them:
//!
//! ```text
//! frame ── tokenize ── encode ──► h ── static upsampler ── static head ──► Gaussians at the frame's own time
//! h_a, h_b, conditions ── decoder ──► d_a, d_b ── deformation upsampler ── deformation head ──► velocity, γ
//! ```
//!
//! A [`Session`] takes frames through the network. [`reuse`] skips tokens that did not change between frames,
//! [`zero_output`] skips branches that add nothing.
//!
//! Arrays are row-major `f32`; a frame's tokens run over the patch grid row by row. World axes: x right, y away from
//! the camera (0 near, 1 far: normalised inverse depth), z up. Every output obeys the bit contract of the kernels: it
//! is the same on every instruction-set level and for any number of threads.
//!
//! The library never prints, and never panics on data: errors of a file or an input are returned as a [`ModelError`].

#![deny(unsafe_code)]

pub mod checkpoint;
pub mod columns;
mod config;
pub mod cost;
mod decoder;
mod deformation_head;
mod dino;
mod dino_layout;
mod dino_session;
mod encoder;
mod error;
mod frame;
mod grid;
pub mod inspect;
mod keys;
mod layers;
pub mod motion;
mod network;
mod options;
pub mod reuse;
mod session;
mod static_head;
mod upsampler;
pub mod zero_output;

pub use config::{Config, DinoConfig, StaticPosition};
pub use dino::Dino;
pub use dino_layout::DinoLayout;
pub use dino_session::DinoSession;
pub use error::ModelError;
pub use frame::{
    Deformation, DinoFeatures, Embedding, FrameInput, Sampling, Side, StaticFrame, StaticGaussian, StaticGaussians,
};
pub use network::Network;
pub use options::{LoadOptions, Precision, UnknownPrecision};
pub use session::Session;

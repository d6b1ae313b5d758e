//! Scenes in the formats of others.
//!
//! There is no open format for dynamic Gaussians; what viewers read are sequences of still ones, one [`Snapshot`] per time.
//!
//! [`Snapshot`]: crate::render::Snapshot

mod ply;

pub use ply::ply;

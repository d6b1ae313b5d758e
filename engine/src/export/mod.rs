//! Scenes in the formats of others.
//!
//! There is no open format for dynamic Gaussians; what viewers read are sequences of still ones, one [`Snapshot`] per time.
//!
//! [`Snapshot`]: crate::render::Snapshot

mod ply;
mod splat;

pub use ply::ply;
pub use splat::splat;

//! Scenes in the formats of others.
//!
//! There is no open format for dynamic Gaussians; what viewers read are sequences of still ones, one [`Snapshot`] per time.
//!
//! [`Snapshot`]: crate::render::Snapshot

mod ply;
mod splat;
pub(crate) mod spz;
mod tracks;

pub use ply::ply;
pub use splat::splat;
pub use spz::spz;
pub use tracks::{HEADER as TRACKS_HEADER, tracks};

/// The same of scenes that do not move.
pub mod still {
    pub use super::ply::of_still as ply;
    pub use super::splat::of_still as splat;
    pub use super::spz::of_still as spz;
}

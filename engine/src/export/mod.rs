//! Scenes in the formats of other programs.
//!
//! There is no open format for dynamic Gaussians. Viewers read sequences of still scenes, one [`Snapshot`] per time.
//!
//! [`Snapshot`]: crate::render::Snapshot

mod gltf;
mod notes;
mod order;
mod packed;
mod ply;
mod sog;
mod splat;
pub(crate) mod spz;
#[cfg(test)]
mod tests;
mod tracks;

pub use gltf::glb;
pub use notes::{Options, SpzVersion, Written};
pub use packed::packed;
pub use ply::ply;
pub use sog::sog;
pub use splat::splat;
pub use spz::spz;
pub use tracks::tracks;

use order::Order;

/// The same functions for still scenes.
pub mod still {
    pub use super::gltf::of_still as glb;
    pub use super::packed::of_still as packed;
    pub use super::ply::of_still as ply;
    pub use super::sog::of_still as sog;
    pub use super::splat::of_still as splat;
    pub use super::spz::of_still as spz;
}

/// Still scenes as files, with notes on the content that is lost.
pub mod written {
    pub use super::gltf::written as glb;
    pub use super::packed::written as packed;
    pub use super::ply::written as ply;
    pub use super::sog::written as sog;
    pub use super::splat::of_scene as splat;
    pub use super::spz::written as spz;
}

//! Scenes in the formats of others.
//!
//! There is no open format for dynamic Gaussians; what viewers read are sequences of still ones, one [`Snapshot`] per time.
//!
//! [`Snapshot`]: crate::render::Snapshot

mod gltf;
mod order;
mod packed;
mod ply;
mod sog;
mod splat;
pub(crate) mod spz;
mod tracks;

pub use gltf::glb;
pub use packed::packed;
pub use ply::ply;
pub use sog::sog;
pub use splat::splat;
pub use spz::spz;
pub use tracks::{HEADER as TRACKS_HEADER, tracks};

use order::Order;

/// The same of scenes that do not move.
pub mod still {
    pub use super::gltf::of_still as glb;
    pub use super::packed::of_still as packed;
    pub use super::ply::of_still as ply;
    pub use super::sog::of_still as sog;
    pub use super::splat::of_still as splat;
    pub use super::spz::of_still as spz;
}

//! Gaussians in world space drawn by gsplat's conventions, in any number of channels, and the adjoint of the image.
//!
//! # Definition
//!
//! A Gaussian with mean w, quaternion q, scales S = diag(s), opacity o and channels c is seen by a camera with the
//! world-to-view matrix [V | t]:
//!
//! ```text
//! (x, y, z) = V·w + t                R = rotation of q/|q|
//! pinhole       u = f_x·x/z + c_x    J = [[f_x/z, 0, −(f_x/z)·h_x], [0, f_y/z, −(f_y/z)·h_y]]
//! orthographic  u = f_x·x + c_x      J = [[f_x, 0, 0], [0, f_y, 0]]
//! [m₁; m₂] = J·V·R·S                 Σ = [[a, b], [b, c]] = [m₁; m₂]·[m₁; m₂]ᵀ + e·I              drawn where near < z < far
//! o′ = o, or with anti-aliasing o·√(|m₁ × m₂|² / det Σ)
//! α = min(0.999, o′·exp(−½·dᵀΣ⁻¹d))                                              skipped where α < 1/255      (0.999 or `largest_alpha`)
//! stop before the first that takes T·(1 − α) to 1e-4 or under
//! image = Σ α·T·c + T·background     alpha = 1 − T
//! ```
//!
//! Pixel centres are halves: c_x and u count from the image's left edge. `h_x` is x/z clamped to `(−0.15·W − c_x)/f_x`
//! and `(1.15·W − c_x)/f_x`. A Gaussian's radius along an axis is `⌈min(3.33, √(2·ln(255·o′)))·√a⌉` pixels. It is 0,
//! and the Gaussian is left out, where its box of radii is outside the image, where both radii are at most
//! `least_radius`, and where o′ is under 1/255.
//!
//! The adjoint takes a loss's gradients with respect to image and alpha to those with respect to everything above. It
//! differentiates the formulas as written: an α at its bound 0.999, a clamped h_x and skipped Gaussians have no
//! gradient of their own.
//!
//! # Order of operations
//!
//! Projection is binary64 in the order written in `project.rs`, from the numbers as they are in binary32; its results
//! are rounded once. Lists and α are those of [`super`] (form *general*). A pixel's channel is summed front to back,
//! one fused multiply-add per Gaussian.
//!
//! The adjoint walks the same lists front to back with the same α and T. g are the gradients of a pixel's channels, g_α
//! is that of alpha, and `G = g_α + Σ_c g_c·c_c` (fused, channels ascending, from g_α). `B` is the part behind the
//! Gaussian, from `B₀ = g_α·alpha + Σ_c g_c·image_c` (alike):
//!
//! ```text
//! B −= (α·T)·G        v = α·∂L/∂α = (α·T)·G − α/(1 − α)·B
//! ```
//!
//! B is a difference: v is as exact as 2⁻²² of B₀, divided by 1 − α. Channels are taken in groups of four, and of the
//! remaining ones; g_α counts with the first group. With `s = q·(y − v)`, `t = p·(x − m)` of the footprint's triangular
//! factor, a Gaussian's sums `Σv, Σvt, Σvs, Σvt², Σvts, Σvs²` and `Σ α·T·g_c` have three steps:
//!
//! 1. on each of the 16 lanes of a block of 4×4 pixels, over those blocks of a tile on which the Gaussian is drawn,
//!    row-major, from +0;
//! 2. the lanes, folded as [`Simd::sum`](crate::simd::Simd::sum) does;
//! 3. the tiles of [`TILE_PIXELS`](super::TILE_PIXELS), added in ascending order, row-major, from +0.
//!
//! Groups of channels are added in ascending order. A background's gradient is the sum of T·g in binary64: over a
//! block's lanes, the blocks of a tile, the tiles, each in ascending order. The rest is binary64 in the order written
//! in `adjoint.rs`; a camera's gradient is summed over the Gaussians of chunks of 2048, then over the chunks, both in
//! ascending order.
//!
//! # Values that are not finite
//!
//! A Gaussian with a NaN or an infinity in mean, scale, quaternion or opacity is left out; its gradients are 0.
//! Channels, backgrounds and gradients of pixels that are not finite count as +0. A quaternion shorter than 1e-12 is
//! divided by 1e-12, as gsplat does, and has no gradient. Neither has an opacity that anti-aliasing lowers to 0.
//!
//! Source: Ye et al., "gsplat: An Open-Source Library for Gaussian Splatting" (2024), version 1.5.3, for the
//! conventions; Kerbl et al. (2023) for the formulas.

mod adjoint;
mod blend;
mod project;
mod rasteriser;
pub mod reference;
#[cfg(test)]
mod tests;

use bytemuck::{Pod, Zeroable};

pub use rasteriser::WorldRasteriser;

/// A pixel is finished when the next splat would take its transmittance to this or below.
const TRANSMITTANCE_MIN: f32 = 1e-4;

/// Projection of rays onto the image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WorldProjection {
    /// Rays through one point.
    #[default]
    Pinhole,
    /// Parallel rays.
    Orthographic,
}

/// A camera and its image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorldView {
    /// [V | t], row by row; V is used as it is.
    pub world_to_view: [[f32; 4]; 3],
    /// Projection of rays onto the image.
    pub projection: WorldProjection,
    /// Pixels per unit along x and y: of a tangent with a pinhole, of length without.
    pub focal: [f32; 2],
    /// The point at which the axis z meets the image, from its left and upper edge in pixels.
    pub centre: [f32; 2],
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Gaussians are drawn beyond this depth, at least 0,
    pub near: f32,
    /// and before this one.
    pub far: f32,
    /// Gaussians whose radii are at most this many pixels are left out.
    pub least_radius: f32,
    /// e: added to both variances of a footprint, px².
    pub low_pass: f32,
    /// True if opacities are lowered by as much as the low-pass widens footprints.
    pub antialias: bool,
    /// An α above this is lowered to it; below 1.
    pub largest_alpha: f32,
}

impl WorldView {
    /// A pinhole of gsplat's defaults: near 0.01, far 1e10, low-pass 0.3 px², α up to 0.999.
    pub fn pinhole(world_to_view: [[f32; 4]; 3], focal: [f32; 2], centre: [f32; 2], size: [usize; 2]) -> Self {
        Self {
            world_to_view,
            projection: WorldProjection::Pinhole,
            focal,
            centre,
            width: size[0],
            height: size[1],
            near: 0.01,
            far: 1e10,
            least_radius: 0.0,
            low_pass: 0.3,
            antialias: false,
            largest_alpha: 0.999,
        }
    }
}

/// Gaussians as a camera sees them; all arrays are equally long. Zeros where a Gaussian is left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Projected {
    /// u, v: centres from the image's left and upper edge, px.
    pub centre: Vec<[f32; 2]>,
    /// z: depths of the centres.
    pub depth: Vec<f32>,
    /// Σ⁻¹: `[c, −b, a]/det Σ`.
    pub conic: Vec<[f32; 3]>,
    /// o′.
    pub opacity: Vec<f32>,
    /// Radii along x and y, px; 0 where the Gaussian is left out.
    pub radius: Vec<[i32; 2]>,
}

/// Gradient of a loss with respect to a Gaussian's footprint, without colour.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct FootprintGradient {
    /// By u and v, per px.
    pub centre: [f32; 2],
    /// By ln p, by `k·p/q` and by ln q of the triangular factor of `½log₂e·Σ⁻¹`, whose columns are (p, −k·p) and (0,
    /// q).
    pub shape: [f32; 3],
    /// By o′.
    pub opacity: f32,
}

/// Gradients of a loss with respect to Gaussians; all slices are as long as these.
#[derive(Debug)]
pub struct WorldGradients<'a> {
    /// By means.
    pub mean: &'a mut [[f32; 3]],
    /// By quaternions.
    pub rotation: &'a mut [[f32; 4]],
    /// By scales.
    pub scale: &'a mut [[f32; 3]],
    /// By opacities.
    pub opacity: &'a mut [f32],
}

/// An image's channels and colours.
#[derive(Clone, Copy, Debug)]
pub struct Drawing<'a> {
    /// D: values per Gaussian and pixel.
    pub channels: usize,
    /// `[N, D]`
    pub colours: &'a [f32],
    /// `[D]`, or nothing: black.
    pub background: &'a [f32],
}

//! Rasterisation of 3-D Gaussians, orthographic or pinhole: project, bin, sort, blend.
//!
//! # Definition
//!
//! Gaussians come in view space: x right, y down, z forward. Gaussian i with mean (x, y, z), scales S, rotation R (from
//! the quaternion as it is, not normalised) and opacity o has the footprint
//!
//! ```text
//! orthographic  u = f_x·x + (W − 1)/2        J = [[f_x, 0, 0], [0, f_y, 0]]                           drawn where z > 0
//! pinhole       u = f_x·x/z + c_x            J = [[f_x/z, 0, −f_x·x/z²], [0, f_y/z, −f_y·y/z²]]       drawn where z > 1e-6
//! Σ = J·R·S·Sᵀ·Rᵀ·Jᵀ + 0.3·I                (px²; pixel centres are whole numbers)
//! ```
//!
//! and is drawn on pixel d away from its centre, front to back by z (ties: lower index first), with
//!
//! ```text
//! α = min(0.99, o·exp(−½·dᵀΣ⁻¹d))            skipped where α < 1/255
//! stop before the first that takes T·(1 − α) under 1e-4
//! C += α·T·c     D += α·T·z     T −= α·T      from T = 1
//! rgb = C + T·background     depth = D     alpha = 1 − T
//! ```
//!
//! An *equirectangular* image shows all around the eye. A Gaussian with its centre in the direction n, at the distance
//! r, has its footprint in the plane that touches the sphere of directions in n. The plane has the axes e (east) and s
//! (south), in pixels of a meridian:
//!
//! ```text
//! K = H/π     J = K/r·[e; s]     Σ = J·R·S·Sᵀ·Rᵀ·Jᵀ + diag(0.3·(max(cos φ, 1/16)·2H/W)², 0.3)     drawn where r > 1e-6
//! α = min(0.99, o·exp(−½·dᵀΣ⁻¹d))     d = K·(e·q, s·q)/(n·q) for a pixel in the direction q with n·q > 0
//! ```
//!
//! So it has, anywhere, the shape that a pinhole looking along n sees: it bends with the image near the poles, and the
//! image's edges meet. The low-pass of 0.3 px² is in the image's own pixels, which on the sphere are cos φ as wide as
//! they are high. Drawing order and `depth` use r instead of z.
//!
//! With [`Request::antialias`], o is `o·√(det(J·R·S·Sᵀ·Rᵀ·Jᵀ) / det Σ)` throughout, so that Gaussians smaller than a
//! pixel get fainter instead of larger (Mip-Splatting, CVPR 2024, the 2D filter with a variance of 0.3 px²).
//!
//! With [`Request::bounded`], x/z and y/z in a pinhole's J (not in u and v) are clamped, as in the original 3D Gaussian
//! splatting and gsplat: x/z between `(−½ − 0.15·W − c_x)/f_x` and `(1.15·W − ½ − c_x)/f_x`, y/z alike. Without it, the
//! affine approximation of Gaussians far outside the image and close to the eye smears over the image.
//!
//! With a [`Falloff`] other than the Gaussian itself, `α = min(0.99, o·g·(exp(−½·dᵀΣ⁻¹d) − f))`.
//!
//! With [`Request::defocus`], a pinhole's lens has a width A and is focused at depth F. A point at depth z is a disc of
//! radius `½A·f·|1/z − 1/F|` px; its variance along either axis is a quarter of its radius squared. Footprints are
//! widened by it and keep their sum over the image:
//!
//! ```text
//! b_x = (f_x·¼A·(1/z − 1/F))²     b_y alike     Σ' = Σ + diag(b_x, b_y)     o' = o·√(det Σ / det Σ')
//! ```
//!
//! α is then skipped where it is under 2⁻¹⁶ instead of 1/255, so a Gaussian spread over many pixels keeps its sum.
//! Gaussians with an opacity under 1/255 are left out as without a lens. With `antialias` as well, `o' =
//! o·√(det(J·R·S·Sᵀ·Rᵀ·Jᵀ) / det Σ')`.
//!
//! Source: StreamSplat, ICLR 2026, section 3, with the affine approximation of EWA splatting. A Gaussian reaches every
//! pixel on which its α is at least 1/255: the image depends on no tile size and no cut at a multiple of σ.
//!
//! # Order of operations
//!
//! A pixel's value is a function of the scene and the pixel alone. General footprints are projected in binary64,
//! separable ones in binary32 with centres in two parts (`project`); the blend is binary32 with the fused multiply-adds
//! written in `blend/walk.rs`. The conic enters as a triangular factor, `½log₂e·dᵀΣ⁻¹d = (p·(dx − k·dy))² + (q·dy)²`,
//! whose determinant is a sum of squares: neither thin nor far Gaussians cancel. With `m₁, m₂` the rows of `J·R·S`, the
//! blurred determinant is `(|m₁ × m₂|² + ((0.3 + b_x)·|m₂|² + (0.3 + b_y)·|m₁|²)) + (0.3 + b_x)·(0.3 + b_y)` in that
//! order. The square root of the quotient is rounded to binary32 once. α has three forms, chosen by the scene and never
//! by tile, level or thread:
//!
//! - *separable*, when the projection is orthographic and every rotation is the identity:
//!   `α = min(0.99, (o·2^−(q·dy)²)·2^−(p·dx)² − o·f)`, one exponential per row and per column;
//! - *general*: `α = min(0.99, o·2^−((p·(dx − k·dy))² + (q·dy)²) − o·f)`,
//!
//! The last step of both is one fused multiply-add with `−o·f`, which is −0 for Gaussians and then changes no bit. o·g
//! comes first, in binary32.
//!
//! The third form, *spherical* (`blend/sphere.rs`), is for equirectangular images: `α = min(0.99, o·2^−(((a·q)² +
//! (b·q)²)/(n·q)²) − o·f)`.
//!
//! Pixels are blended in blocks of 4×4, one vector each. Blocks and tiles that a footprint cannot reach are left out,
//! as are blocks whose pixels are all finished; that changes no bit.
//!
//! # Values that are not finite
//!
//! A Gaussian with a NaN or an infinity in any field is dropped and counted. It contributes nothing to the image.

mod bin;
mod blend;
mod falloff;
mod linear;
mod lists;
mod project;
mod rasteriser;
pub mod reference;
mod sort;
mod world;

pub use falloff::{ALPHA_MIN, Defocus, Falloff};
pub use linear::{ColourFit, ColourMap, Effort, FitView, Preparation, Solution, WEIGHT_BYTES};
pub use lists::{BLOCK_PIXELS, Footprint, Lists, TILE_PIXELS};
pub use rasteriser::{Rasteriser, Work};
pub use world::{
    Drawing, FootprintGradient, Projected, WorldGradients, WorldProjection, WorldRasteriser, WorldView,
    reference as world_reference,
};

use crate::level::Level;

/// Gaussians in view space; all slices are equally long.
#[derive(Clone, Copy, Debug, Default)]
pub struct Gaussians<'a> {
    /// Centres: x right, y down, z forward.
    pub mean: &'a [[f32; 3]],
    /// Standard deviations along the Gaussian's own axes.
    pub scale: &'a [[f32; 3]],
    /// Quaternions w, x, y, z, used as they are; `None`: all are the identity.
    pub rotation: Option<&'a [[f32; 4]]>,
    /// Opacity at the centre.
    pub opacity: &'a [f32],
    /// Colour.
    pub rgb: &'a [[f32; 3]],
}

impl Gaussians<'_> {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.mean.len()
    }

    /// Returns true if there are none.
    pub fn is_empty(&self) -> bool {
        self.mean.is_empty()
    }

    fn assert_equal_lengths(&self) {
        let n = self.len();
        assert!(
            self.scale.len() == n
                && self.opacity.len() == n
                && self.rgb.len() == n
                && self.rotation.is_none_or(|r| r.len() == n),
            "Gaussians of unequal lengths: {n} means, {} scales, {:?} rotations, {} opacities, {} colours",
            self.scale.len(),
            self.rotation.map(<[_]>::len),
            self.opacity.len(),
            self.rgb.len(),
        );
    }
}

/// [`Gaussians`] that are owned; all arrays are equally long.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OwnedGaussians {
    /// Centres.
    pub mean: Vec<[f32; 3]>,
    /// Standard deviations along the Gaussian's own axes.
    pub scale: Vec<[f32; 3]>,
    /// Quaternions w, x, y, z; `None`: all are the identity.
    pub rotation: Option<Vec<[f32; 4]>>,
    /// Opacity at the centre.
    pub opacity: Vec<f32>,
    /// Colour.
    pub rgb: Vec<[f32; 3]>,
}

impl OwnedGaussians {
    /// All of them.
    pub fn gaussians(&self) -> Gaussians<'_> {
        Gaussians {
            mean: &self.mean,
            scale: &self.scale,
            rotation: self.rotation.as_deref(),
            opacity: &self.opacity,
            rgb: &self.rgb,
        }
    }

    /// Adds one Gaussian, with its quaternion only where the others have one.
    pub fn push(&mut self, mean: [f32; 3], scale: [f32; 3], turn: [f32; 4], opacity: f32, rgb: [f32; 3]) {
        self.mean.push(mean);
        self.scale.push(scale);
        if let Some(rotation) = &mut self.rotation {
            rotation.push(turn);
        }
        self.opacity.push(opacity);
        self.rgb.push(rgb);
    }
}

/// Projection from view space to the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Parallel rays; the axis z meets the middle of the image.
    Orthographic {
        /// Pixels per unit along x and y.
        focal: [f32; 2],
    },
    /// Rays through one point.
    Pinhole {
        /// Focal lengths in pixels.
        focal: [f32; 2],
        /// The pixel that the axis z meets.
        centre: [f32; 2],
    },
    /// All around the eye: columns are longitudes from −π to π, rows latitudes from −π/2 (above) to π/2 (below). Pixel
    /// centres are half a step from the edges; the axis z meets the middle of the image.
    Equirectangular,
}

/// Size, projection and planes of an image to draw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Request {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Colour behind everything. A component that is not finite counts as zero.
    pub background: [f32; 3],
    /// True if `depth` is wanted.
    pub depth: bool,
    /// True if `alpha` is wanted.
    pub alpha: bool,
    /// True if `final_t` and `blended` are wanted.
    pub statistics: bool,
    /// True if opacities are lowered by as much as the low-pass widens footprints, for scenes trained that way.
    pub antialias: bool,
    /// True if a pinhole's footprints outside the image have the shape they would have at most 15 % of its size beyond
    /// its edge, for scenes trained that way.
    pub bounded: bool,
    /// How α falls from a Gaussian's centre to its edge.
    pub falloff: Falloff,
    /// The width of a pinhole's lens; other projections, and [unusable](Defocus::is_usable) ones, have none.
    pub defocus: Option<Defocus>,
}

impl Request {
    /// A request for colour alone.
    pub fn colour(width: usize, height: usize, background: [f32; 3]) -> Self {
        Self {
            width,
            height,
            background,
            depth: false,
            alpha: false,
            statistics: false,
            antialias: false,
            bounded: false,
            falloff: Falloff::Gaussian,
            defocus: None,
        }
    }
}

/// Drawn image. Planes are row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[3, H, W]`
    pub rgb: Vec<f32>,
    /// `[H, W]`: Σ z α T, not normalised.
    pub depth: Option<Vec<f32>>,
    /// `[H, W]`: Σ α T.
    pub alpha: Option<Vec<f32>>,
    /// `[H, W]`: transmittance left.
    pub final_t: Option<Vec<f32>>,
    /// `[H, W]`: Gaussians drawn.
    pub blended: Option<Vec<u32>>,
    /// Gaussians dropped because a field was not finite.
    pub dropped: u64,
}

/// Draws `gaussians`.
///
/// Runs on the current rayon pool. The result is the same for every level and number of threads. To draw a scene
/// repeatedly use a [`Rasteriser`]: it keeps its buffers and redraws only changed tiles.
///
/// # Panics
/// When the slices of `gaussians` differ in length, when there are 2³² Gaussians or more, or when a side of the image
/// is longer than [`MAX_SIDE`].
pub fn render(level: Level, gaussians: &Gaussians<'_>, projection: &Projection, request: &Request) -> Image {
    let mut rasteriser = Rasteriser::new(level);
    rasteriser.render(gaussians, projection, request);
    rasteriser.into_image()
}

/// The longest side of an image.
pub const MAX_SIDE: usize = 1 << 16;

#[cfg(test)]
mod tests;

//! A renderer of Gaussians in world space, called with arrays by gsplat's conventions, and its gradients.
//!
//! [`rasterise`] takes the same arguments as gsplat's `rasterization`, with the same shapes: `N` Gaussians, `C` cameras
//! of one size, colours in any number of channels or as spherical harmonics, and a [`RenderMode`].
//! [`Rasterisation::backward`] returns the gradients of a loss from those with respect to the images. Formulas and
//! orders of operations are those of [`streamsplat_kernels::raster::WorldRasteriser`]: every result is the same on
//! every level and for any number of threads. [`View`] is the part of one camera.
//!
//! ```
//! use streamsplat::raster::{Colours, Gaussians, Options, rasterise};
//!
//! let gaussians = Gaussians {
//!     means: &[[0.0, 0.0, 2.0], [0.3, 0.0, 3.0]],
//!     quats: &[[1.0, 0.0, 0.0, 0.0]; 2],
//!     scales: &[[0.2, 0.1, 0.1], [0.3; 3]],
//!     opacities: &[0.8, 0.9],
//! };
//! let colours = Colours::Channels { values: &[1.0, 0.0, 0.0, 0.0, 0.0, 1.0], channels: 3 };
//! let viewmat = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
//! let k = [[50.0, 0.0, 32.0], [0.0, 50.0, 24.0], [0.0, 0.0, 1.0]];
//! let drawn = rasterise(&gaussians, &colours, &[viewmat], &[k], &Options::new(64, 48))?;
//! assert_eq!((drawn.colours().len(), drawn.alphas().len()), (64 * 48 * 3, 64 * 48));
//!
//! // The gradient of the images' sum.
//! let gradients = drawn.backward(&vec![1.0; 64 * 48 * 3], &vec![0.0; 64 * 48])?;
//! assert!(gradients.opacities[0] > 0.0);
//! # Ok::<(), streamsplat::raster::RasterError>(())
//! ```
//!
//! Images are drawn on the current rayon pool.

mod call;
mod check;
mod harmonics;
mod planes;
#[cfg(test)]
mod tests;
mod view;

use thiserror::Error;

pub use call::{Gradients, Rasterisation, rasterise};
pub use harmonics::{HarmonicGradients, harmonic_colours, harmonic_gradients};
pub use planes::{PlaneSplat, Planes};
pub use view::{GaussianGradients, View};

/// Maximum number of Gaussians.
pub const MAX_GAUSSIANS: usize = 1 << 24;
/// Maximum number of channels.
pub const MAX_CHANNELS: usize = 1 << 10;

/// A world-to-camera matrix, row by row; its last row is 0, 0, 0, 1.
pub type ViewMatrix = [[f32; 4]; 4];
/// A camera's matrix `[[f_x, 0, c_x], [0, f_y, c_y], [0, 0, 1]]`, in pixels from the image's left and upper edge.
pub type CameraMatrix = [[f32; 3]; 3];

/// Gaussians in world space; all slices have the same length.
#[derive(Clone, Copy, Debug, Default)]
pub struct Gaussians<'a> {
    /// Centres.
    pub means: &'a [[f32; 3]],
    /// Quaternions w, x, y, z of any length above 0.
    pub quats: &'a [[f32; 4]],
    /// Standard deviations along the Gaussian's own axes.
    pub scales: &'a [[f32; 3]],
    /// Opacities at the centres.
    pub opacities: &'a [f32],
}

/// Colours of Gaussians, the same for all cameras or camera by camera.
#[derive(Clone, Copy, Debug)]
pub enum Colours<'a> {
    /// `[N, D]` or `[C, N, D]`.
    Channels {
        /// The values.
        values: &'a [f32],
        /// D
        channels: usize,
    },
    /// `[N, K, 3]` or `[C, N, K, 3]`, of which the first (degree + 1)² are used.
    Harmonics {
        /// The coefficients.
        coefficients: &'a [f32],
        /// K
        count: usize,
        /// 0 to 3.
        degree: usize,
    },
}

/// Channels of the images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RenderMode {
    /// Colours.
    #[default]
    Rgb,
    /// Depth Σ α·T·z.
    Depth,
    /// Depth over alpha, with alpha at least 1e-10.
    ExpectedDepth,
    /// Colours, then depth.
    RgbDepth,
    /// Colours, then depth over alpha.
    RgbExpectedDepth,
}

impl RenderMode {
    /// Names of the modes in gsplat.
    pub const NAMES: [(&'static str, RenderMode); 5] = [
        ("RGB", RenderMode::Rgb),
        ("D", RenderMode::Depth),
        ("ED", RenderMode::ExpectedDepth),
        ("RGB+D", RenderMode::RgbDepth),
        ("RGB+ED", RenderMode::RgbExpectedDepth),
    ];

    fn has_colours(self) -> bool {
        !matches!(self, RenderMode::Depth | RenderMode::ExpectedDepth)
    }

    fn has_depth(self) -> bool {
        self != RenderMode::Rgb
    }

    fn is_expected(self) -> bool {
        matches!(self, RenderMode::ExpectedDepth | RenderMode::RgbExpectedDepth)
    }
}

/// Options of drawing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options<'a> {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Gaussians are drawn beyond this depth, which is at least 0,
    pub near_plane: f32,
    /// and before this one.
    pub far_plane: f32,
    /// Gaussians whose radii are at most this many pixels are left out.
    pub radius_clip: f32,
    /// Added to both variances of a footprint, px².
    pub eps2d: f32,
    /// Colours behind all Gaussians, `[C, D]`; black if absent. Depth has no background.
    pub backgrounds: Option<&'a [f32]>,
    /// Channels of the images.
    pub render_mode: RenderMode,
    /// True to lower opacities by as much as `eps2d` widens footprints.
    pub antialiased: bool,
    /// True for parallel rays.
    pub orthographic: bool,
    /// Maximum α; larger ones are lowered to it.
    pub largest_alpha: f32,
}

impl Options<'_> {
    /// Returns gsplat's defaults for images of this size.
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            near_plane: 0.01,
            far_plane: 1e10,
            radius_clip: 0.0,
            eps2d: 0.3,
            backgrounds: None,
            render_mode: RenderMode::Rgb,
            antialiased: false,
            orthographic: false,
            largest_alpha: 0.999,
        }
    }
}

/// An argument that cannot be drawn.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum RasterError {
    /// A slice of wrong length.
    #[error("{name}: expected {expected} values, found {found}")]
    Length {
        /// The argument.
        name: &'static str,
        /// Expected number of values.
        expected: usize,
        /// Number of values found.
        found: usize,
    },
    /// No Gaussians, cameras or pixels.
    #[error("{name}: expected at least one, found none")]
    Empty {
        /// The missing items.
        name: &'static str,
    },
    /// More items than can be drawn.
    #[error("{name}: expected at most {most}, found {found}")]
    TooMany {
        /// The items.
        name: &'static str,
        /// Maximum number.
        most: usize,
        /// Number found.
        found: usize,
    },
    /// A number that is not finite.
    #[error("{name}: expected finite numbers, found {value} at place {at}")]
    NotFinite {
        /// The argument.
        name: &'static str,
        /// Index of the value.
        at: usize,
        /// The number.
        value: f32,
    },
    /// A number outside its range.
    #[error("{name}: expected {expected}, found {found}")]
    Range {
        /// The argument.
        name: &'static str,
        /// Valid numbers.
        expected: &'static str,
        /// The number.
        found: f64,
    },
    /// A view matrix that is not invertible.
    #[error("viewmats: expected a matrix with an inverse and the last row 0, 0, 0, 1, found {found:?}")]
    Singular {
        /// The matrix.
        found: ViewMatrix,
    },
    /// An invalid camera matrix.
    #[error("Ks: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx and fy above 0, found {found:?}")]
    Camera {
        /// The matrix.
        found: CameraMatrix,
    },
    /// Not enough memory.
    #[error("memory: {bytes} bytes for images of {width}×{height} could not be had")]
    Memory {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
        /// Bytes that were requested.
        bytes: usize,
    },
}

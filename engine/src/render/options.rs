//! Options of an image.

use std::fmt;
use std::str::FromStr;

use streamsplat_kernels::raster::{self, Request};

use super::{Aperture, Backend, Falloff};
use crate::camera::Camera;
use crate::fit::Placement;

/// Options of an image: planes in addition to colour, size, background.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderOptions {
    /// The image's size.
    pub size: Size,
    /// Background colour.
    pub background: [f32; 3],
    /// True if a depth image (Σ d α T) is requested.
    pub depth: bool,
    /// True if an alpha image (Σ α T) is requested.
    pub alpha: bool,
    /// True if the remaining transmittance and the number of splats per pixel are requested.
    pub statistics: bool,
    /// Whether splats smaller than a pixel are drawn fainter instead of larger, for scenes trained with anti-aliasing
    /// ([`raster::Request::antialias`]).
    pub antialias: bool,
    /// How α falls from a Gaussian's centre to its edge.
    pub falloff: Falloff,
    /// Aperture of a pinhole camera's lens, if any.
    pub aperture: Option<Aperture>,
}

impl Default for RenderOptions {
    /// Colour at the model's own size, on grey.
    fn default() -> Self {
        Self {
            size: Size::Model,
            background: [0.5; 3],
            depth: false,
            alpha: false,
            statistics: false,
            antialias: false,
            falloff: Falloff::Gaussian,
            aperture: None,
        }
    }
}

/// Bytes per pixel in addition to its planes: its share of the tile's lists, and its samples in the written file.
const BESIDE: usize = 16;

impl RenderOptions {
    /// Request to the rasteriser for an image of this size.
    ///
    /// # Errors
    /// Sides that cannot be drawn, and images for which there is no memory. The memory is reserved here and freed at
    /// once, so that a later allocation does not abort the process.
    pub(crate) fn request(&self, [height, width]: [usize; 2]) -> Result<Request, RenderError> {
        if [height, width].iter().any(|side| !(1..=raster::MAX_SIDE).contains(side)) {
            return Err(RenderError::Size { most: raster::MAX_SIDE, width, height });
        }
        let Self { background, depth, alpha, statistics, antialias, falloff, .. } = *self;
        let planes = 3 + usize::from(depth) + usize::from(alpha) + 2 * usize::from(statistics);
        // At most 2^32 pixels.
        let bytes = width * height * (size_of::<f32>() * planes + BESIDE);
        if Vec::<u8>::new().try_reserve_exact(bytes).is_err() {
            return Err(RenderError::Memory { width, height, bytes });
        }
        let planes = Request { depth, alpha, statistics, ..Request::colour(width, height, background) };
        Ok(Request { antialias, falloff, ..planes })
    }

    /// [`Self::request`] for an image that `camera` sees.
    ///
    /// # Errors
    /// As [`Self::request`], and an aperture for a camera without a lens.
    pub(crate) fn seen_by(&self, camera: &Camera, size: [usize; 2]) -> Result<Request, RenderError> {
        let defocus = self.aperture.map(|aperture| aperture.of(camera)).transpose()?;
        Ok(Request { defocus, ..self.request(size)? })
    }
}

/// The size of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Size {
    /// The content's size inside the model's input.
    #[default]
    Model,
    /// The source's own size.
    Source,
    /// Any other.
    Exact {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
    },
}

impl fmt::Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Size::Model => f.write_str("model"),
            Size::Source => f.write_str("source"),
            Size::Exact { width, height } => write!(f, "{width}x{height}"),
        }
    }
}

/// A text that is not a size of an image.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected model, source or WIDTHxHEIGHT up to {most} a side, found {0:?}", most = raster::MAX_SIDE)]
pub struct UnknownSize(pub String);

impl FromStr for Size {
    type Err = UnknownSize;

    /// `model`, `source` or `WIDTHxHEIGHT`.
    fn from_str(text: &str) -> Result<Self, UnknownSize> {
        let side = |text: &str| text.parse().ok().filter(|side| (1..=raster::MAX_SIDE).contains(side));
        let sides = text.split_once('x').and_then(|(width, height)| side(width).zip(side(height)));
        match (text, sides) {
            ("model", _) => Ok(Size::Model),
            ("source", _) => Ok(Size::Source),
            (_, Some((width, height))) => Ok(Size::Exact { width, height }),
            _ => Err(UnknownSize(text.to_owned())),
        }
    }
}

impl Size {
    /// Height and width for a source of this placement.
    pub fn resolve(self, placement: &Placement) -> [usize; 2] {
        match self {
            Size::Model => placement.content,
            Size::Source => placement.source,
            Size::Exact { width, height } => [height, width],
        }
    }
}

/// Why an image could not be drawn.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// The time is outside of the interval.
    #[error("time {time} s: expected one between {start} s and {end} s")]
    Time {
        /// The requested time.
        time: f64,
        /// The interval's start.
        start: f64,
        /// The interval's end.
        end: f64,
    },
    /// The image has no pixels, or sides longer than can be drawn.
    #[error("image size: expected sides of 1 to {most} pixels, found {width}×{height}")]
    Size {
        /// The longest side that can be drawn.
        most: usize,
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// There is no memory for the image.
    #[error("image size: no memory for {width}×{height} pixels, which take {bytes} bytes")]
    Memory {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
        /// Bytes of the image and of the data made from it.
        bytes: usize,
    },
    /// The camera has numbers that are not finite, or a lens with an empty view.
    #[error("camera: expected finite numbers, positive extents and focal lengths")]
    Camera,
    /// The canonical camera for a scene that has none.
    #[error("camera: expected an orthographic or pinhole one, found canonical: a still scene has no camera of its own")]
    NoOwnCamera,
    /// The aperture of a camera that is not a pinhole.
    #[error("aperture: expected a pinhole camera, found one without a lens (orthographic or all around)")]
    NoLens,
    /// An aperture with impossible values.
    #[error("aperture: {what}: expected more than 0, and a lens of finite width, found {found:?}")]
    Aperture {
        /// The number's name.
        what: &'static str,
        /// Its value.
        found: f64,
    },
    /// A feature that the graphics card renderer does not support.
    #[error("renderer wgpu: expected no {what}, which the CPU alone draws (--renderer cpu)")]
    CpuAlone {
        /// Name of the feature.
        what: &'static str,
    },
    /// A size taken from a source that a scene does not have.
    #[error("image size: expected WIDTHxHEIGHT: a still scene has no size of its own")]
    NoOwnSize,
    /// The library was built without the backend.
    #[error("renderer {backend}: expected a build with the cargo feature {backend}, found one without")]
    NotBuiltIn {
        /// The missing backend.
        backend: Backend,
    },
    /// The graphics card could not draw.
    #[cfg(feature = "wgpu")]
    #[error("renderer wgpu: {0}")]
    Wgpu(#[from] crate::wgpu::WgpuError),
    /// The arrays of an interval differ in length.
    #[error("interval: {array}: expected {expected} records, found {found}")]
    Records {
        /// The array.
        array: &'static str,
        /// Records in `mean`.
        expected: usize,
        /// Records in it.
        found: usize,
    },
}

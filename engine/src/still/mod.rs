//! Still scenes of 3D Gaussians, as stored in 3D Gaussian splatting's own files.
//!
//! A [`Still`] keeps a file's numbers unchanged, so that they survive a round trip: logarithms of scales, logits of
//! opacities, coefficients of spherical harmonics, quaternions of any length. The drawn values are
//! ```text
//! scale = e^log_scale     opacity = 1 / (1 + e^−logit)     rotation = q / |q|     rgb = colour of the harmonics from the eye
//! ```
//!
//! computed in binary64 and rounded once, the harmonics by [`streamsplat_kernels::harmonics`]. Axes are those of scene
//! space (x right, y down, z forward), units the file's own. A still scene has no time, no camera of its own, and no
//! identities.
//!
//! From a file of any supported [format](crate::formats) and a camera to an image:
//!
//! ```no_run
//! use streamsplat::still::{Drawable, Still};
//! use streamsplat::{Level, RenderOptions, Size, Workers, output};
//!
//! let workers = Workers::new(Level::detect(), 0)?;
//! let scene = Drawable::new(Still::open("garden.ply")?, &workers)?;
//! let camera = scene.still().framing().ok_or("an empty scene")?.camera(0.0, 16.0 / 9.0);
//! let options = RenderOptions { size: Size::Exact { width: 640, height: 360 }, ..RenderOptions::default() };
//! let image = scene.render(&camera, &options, &workers)?;
//! output::write_file("garden.png".as_ref(), &output::image_png(&image))?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! No file system is required. A scene is read from bytes, or made from arrays; cameras are poses with a lens:
//!
//! ```
//! use streamsplat::camera::{Camera, Pose};
//! use streamsplat::still::{Drawable, Still, Values};
//! use streamsplat::{Level, RenderOptions, Size, Workers, formats};
//!
//! let values = Values { mean: vec![[0.0, 0.0, 2.0]], scale: vec![[0.2; 3]], opacity: vec![0.9], rgb: vec![[1.0, 0.5, 0.0]], ..Values::default() };
//! let file: Vec<u8> = formats::ply::write(&Still::of_values(values)?).bytes;
//!
//! let workers = Workers::new(Level::detect(), 2)?;
//! let scene = Drawable::new(Still::read(&file)?, &workers)?;
//! let pose = Pose::look_at([0.0, -0.5, 0.0], [0.0, 0.0, 2.0], [0.0, -1.0, 0.0]).ok_or("a place to look from")?;
//! let camera = Camera::pinhole(pose, 45.0, 16.0 / 9.0).ok_or("a field of view")?;
//! let options = RenderOptions { size: Size::Exact { width: 64, height: 36 }, ..RenderOptions::default() };
//! let image = scene.render(&camera, &options, &workers)?;
//! assert!(image.rgb[18 * 64 + 32] > 0.8, "the red of the middle");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod about;
mod axes;
mod draw;
mod framing;
mod sound;
mod statistics;
#[cfg(test)]
mod tests;
mod turn;
mod values;

pub use about::{About, Orbit};
pub use axes::Axes;
pub use draw::Drawable;
pub(crate) use draw::{after, grown};
pub use framing::Framing;
pub use sound::Defect;
pub(crate) use statistics::middle;
pub use statistics::{Spread, Statistics};
pub use turn::Similarity;
pub use values::{GAUSSIANS, Values, ValuesError};

use streamsplat_kernels::harmonics;
use streamsplat_kernels::math::f64::ln;

use crate::stream::Snapshot;

/// The least scale, and the least distance of opacities from 0 and 1, before a logarithm.
pub(crate) const LEAST: f64 = 1e-12;

/// ln s, for s of at least [`LEAST`].
fn log_of(scale: f32) -> f32 {
    ln(f64::from(scale).max(LEAST)) as f32
}

/// ln(o / (1 − o)), at least [`LEAST`] from 0 and 1.
fn logit_of(opacity: f32) -> f32 {
    let opacity = f64::from(opacity).clamp(LEAST, 1.0 - LEAST);
    (ln(opacity) - ln(1.0 - opacity)) as f32
}

/// The first coefficient of the harmonics for a colour.
fn first_of(colour: f32) -> f32 {
    ((f64::from(colour) - 0.5) / harmonics::Y0) as f32
}

/// Gaussians that do not move. All arrays have the same length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Still {
    /// Centres.
    pub mean: Vec<[f32; 3]>,
    /// Natural logarithms of the standard deviations along the Gaussian's own axes.
    pub log_scale: Vec<[f32; 3]>,
    /// Quaternions (w, x, y, z) of any length; zero draws nothing ([`Still::defect`]).
    pub rotation: Vec<[f32; 4]>,
    /// ln(o / (1 − o)) of the opacities.
    pub logit: Vec<f32>,
    /// The harmonics' first coefficients, by channel.
    pub base: Vec<[f32; 3]>,
    /// Degree of the harmonics, 0 to 3.
    pub degree: usize,
    /// The other coefficients: `[N, (degree + 1)² − 1, 3]`.
    pub higher: Vec<f32>,
    /// Metadata of the scene.
    pub about: About,
}

impl Still {
    /// An empty scene with room for `count` Gaussians.
    pub(crate) fn with_room(count: usize, degree: usize) -> Self {
        let mut still = Still { degree, ..Still::default() };
        let higher = count * 3 * still.rest();
        still.mean.reserve_exact(count);
        still.log_scale.reserve_exact(count);
        still.rotation.reserve_exact(count);
        still.logit.reserve_exact(count);
        still.base.reserve_exact(count);
        still.higher.reserve_exact(higher);
        still
    }

    /// Bytes in memory per Gaussian with harmonics of this degree.
    pub(crate) fn bytes_each(degree: usize) -> u64 {
        4 * (3 + 3 + 4 + 1 + 3 + 3 * harmonics::rest(degree)) as u64
    }

    /// A scene of `count` Gaussians of zeros. Memory is committed as they are written.
    pub(crate) fn zeros(count: usize, degree: usize) -> Self {
        Still {
            mean: vec![[0.0; 3]; count],
            log_scale: vec![[0.0; 3]; count],
            rotation: vec![[0.0; 4]; count],
            logit: vec![0.0; count],
            base: vec![[0.0; 3]; count],
            degree,
            higher: vec![0.0; count * 3 * harmonics::rest(degree)],
            about: About::default(),
        }
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.mean.len()
    }

    /// Returns true if there is none.
    pub fn is_empty(&self) -> bool {
        self.mean.is_empty()
    }

    /// Number of coefficients above the first, per Gaussian and channel.
    pub fn rest(&self) -> usize {
        harmonics::rest(self.degree)
    }

    /// The name and length of an array that does not fit `mean`, if any.
    pub fn uneven(&self) -> Option<(&'static str, usize)> {
        let n = self.len();
        let lengths = [
            ("log_scale", self.log_scale.len(), n),
            ("rotation", self.rotation.len(), n),
            ("logit", self.logit.len(), n),
            ("base", self.base.len(), n),
            ("higher", self.higher.len(), n * 3 * self.rest()),
        ];
        lengths.into_iter().find(|(_, found, expected)| found != expected).map(|(name, found, _)| (name, found))
    }

    /// The still scene of a snapshot, in drawing order. Scales under 10⁻¹² and opacities nearer than that to 0 or 1 are
    /// clamped, so that every value is finite; colours become `(rgb − ½) / Y₀`.
    pub fn of(snapshot: &Snapshot) -> Self {
        let count = snapshot.mean.len();
        Self {
            mean: snapshot.mean.clone(),
            log_scale: snapshot.scale.iter().map(|s| s.map(log_of)).collect(),
            rotation: vec![[1.0, 0.0, 0.0, 0.0]; count],
            logit: snapshot.opacity.iter().map(|o| logit_of(*o)).collect(),
            base: snapshot.rgb.iter().map(|rgb| rgb.map(first_of)).collect(),
            degree: 0,
            higher: Vec::new(),
            about: About::default(),
        }
    }

    /// Least and greatest coordinates of the finite centres, with the scene's offset.
    pub fn bounds(&self) -> Option<[[f64; 3]; 2]> {
        let finite = self.mean.iter().filter(|m| m.iter().all(|x| x.is_finite()));
        let bounds = finite.fold(None, |bounds: Option<[[f32; 3]; 2]>, m| {
            let [least, greatest] = bounds.unwrap_or([*m, *m]);
            Some([std::array::from_fn(|i| least[i].min(m[i])), std::array::from_fn(|i| greatest[i].max(m[i]))])
        });
        bounds.map(|bounds| bounds.map(|corner| std::array::from_fn(|i| f64::from(corner[i]) + self.about.offset[i])))
    }
}

//! Still scenes of 3D Gaussians, as 3D Gaussian splatting's own files hold them.
//!
//! A [`Still`] keeps a file's numbers unchanged, so that they survive a round trip: logarithms of scales, logits of opacities,
//! coefficients of spherical harmonics, quaternions of any length. The values drawn are
//!
//! ```text
//! scale = e^log_scale     opacity = 1 / (1 + e^−logit)     rotation = q / |q|     rgb = colour of the harmonics from the eye
//! ```
//!
//! computed in binary64 and rounded once, the harmonics by [`streamsplat_kernels::harmonics`]. Axes are those of scene space
//! (x right, y down, z forward), units the file's own. Such a scene has no time, no camera of its own, and no identities.

mod about;
mod axes;
mod draw;
mod framing;
mod sound;
mod statistics;
#[cfg(test)]
mod tests;
mod turn;

pub use about::{About, Orbit};
pub use axes::Axes;
pub use draw::Drawable;
pub(crate) use draw::{after, grown};
pub use framing::Framing;
pub use sound::Defect;
pub(crate) use statistics::middle;
pub use statistics::{Spread, Statistics};
pub use turn::Similarity;

use streamsplat_kernels::harmonics;
use streamsplat_kernels::math::f64::ln;

use crate::render::Snapshot;

/// The least scale and the distance of opacities from 0 and 1 that survive a logarithm.
pub(crate) const LEAST: f64 = 1e-12;

/// Gaussians that do not move. All arrays are equally long.
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

    /// Bytes in memory of a Gaussian whose harmonics have this degree.
    pub(crate) fn bytes_each(degree: usize) -> u64 {
        4 * (3 + 3 + 4 + 1 + 3 + 3 * harmonics::rest(degree)) as u64
    }

    /// A scene of `count` Gaussians of zeros. Memory is taken as they are filled.
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

    /// Coefficients above the first, per Gaussian and channel.
    pub fn rest(&self) -> usize {
        harmonics::rest(self.degree)
    }

    /// The name and length of an array that does not fit `mean`, if there is one.
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

    /// Still scene of a snapshot. Scales under 10⁻¹² and opacities nearer than that to 0 or 1 are moved there, so that every
    /// value is finite; colours become `(rgb − ½) / Y₀`. In drawing order.
    pub fn of(snapshot: &Snapshot) -> Self {
        let count = snapshot.mean.len();
        let logit = |opacity: f32| {
            let opacity = f64::from(opacity).clamp(LEAST, 1.0 - LEAST);
            (ln(opacity) - ln(1.0 - opacity)) as f32
        };
        let first = |c: f32| ((f64::from(c) - 0.5) / harmonics::Y0) as f32;
        Self {
            mean: snapshot.mean.clone(),
            log_scale: snapshot.scale.iter().map(|s| s.map(|s| ln(f64::from(s).max(LEAST)) as f32)).collect(),
            rotation: vec![[1.0, 0.0, 0.0, 0.0]; count],
            logit: snapshot.opacity.iter().map(|o| logit(*o)).collect(),
            base: snapshot.rgb.iter().map(|rgb| rgb.map(first)).collect(),
            degree: 0,
            higher: Vec::new(),
            about: About::default(),
        }
    }

    /// Least and greatest coordinates of the centres that are finite, with the scene's offset.
    pub fn bounds(&self) -> Option<[[f64; 3]; 2]> {
        let finite = self.mean.iter().filter(|m| m.iter().all(|x| x.is_finite()));
        let bounds = finite.fold(None, |bounds: Option<[[f32; 3]; 2]>, m| {
            let [least, greatest] = bounds.unwrap_or([*m, *m]);
            Some([std::array::from_fn(|i| least[i].min(m[i])), std::array::from_fn(|i| greatest[i].max(m[i]))])
        });
        bounds.map(|bounds| bounds.map(|corner| std::array::from_fn(|i| f64::from(corner[i]) + self.about.offset[i])))
    }
}

//! gsplat's function: several cameras, colours or harmonics, depth.

use streamsplat_kernels::raster::Projected;

use super::harmonics::{HarmonicGradients, harmonic_colours, harmonic_gradients};
use super::view::{GaussianGradients, View};
use super::{CameraMatrix, Colours, Gaussians, Options, RasterError, ViewMatrix, check};

/// Minimum alpha by which depth is divided.
const LEAST_ALPHA: f32 = 1e-10;

/// One camera's image.
#[derive(Debug)]
struct Drawn {
    view: View,
    /// Colours from harmonics, `[N, 3]`; empty without harmonics.
    seen: Vec<[f32; 3]>,
    /// Colours and depth, `[N, D]`.
    colours: Vec<f32>,
    background: Vec<f32>,
    /// `[H, W, D]`, before depth is divided by alpha.
    image: Vec<f32>,
}

/// Images of all cameras, and the data that their gradients need.
#[derive(Debug)]
pub struct Rasterisation<'a> {
    gaussians: Gaussians<'a>,
    source: Colours<'a>,
    options: Options<'a>,
    /// Channels per image.
    channels: usize,
    cameras: Vec<Drawn>,
    colours: Vec<f32>,
    alphas: Vec<f32>,
}

/// Gradients of a loss with respect to the arguments of [`rasterise`].
#[derive(Clone, Debug, PartialEq)]
pub struct Gradients {
    /// By means, `[N]`.
    pub means: Vec<[f32; 3]>,
    /// By quaternions, `[N]`.
    pub quats: Vec<[f32; 4]>,
    /// By scales, `[N]`.
    pub scales: Vec<[f32; 3]>,
    /// By opacities, `[N]`.
    pub opacities: Vec<f32>,
    /// By colours or coefficients, with their shape.
    pub colours: Vec<f32>,
    /// By backgrounds `[C, D]`; empty without backgrounds.
    pub backgrounds: Vec<f32>,
    /// By view matrices, `[C]`; their last rows are 0.
    pub viewmats: Vec<ViewMatrix>,
}

/// Returns one camera's part of values `[N, …]` or `[C, N, …]`, which are `per_camera` per camera.
fn part<T>(values: &[T], camera: usize, per_camera: usize) -> &[T] {
    if values.len() == per_camera { values } else { &values[camera * per_camera..][..per_camera] }
}

/// Draws Gaussians as seen by all cameras.
///
/// # Errors
/// Arguments that cannot be drawn; they are checked before memory is allocated.
pub fn rasterise<'a>(
    gaussians: &Gaussians<'a>,
    colours: &Colours<'a>,
    viewmats: &[ViewMatrix],
    ks: &[CameraMatrix],
    options: &Options<'a>,
) -> Result<Rasterisation<'a>, RasterError> {
    check::options(options)?;
    let (n, c) = (check::gaussians(gaussians)?, viewmats.len());
    check::some("viewmats", usize::MAX, c)?;
    check::length("Ks", 9 * c, 9 * ks.len())?;
    let (values, per_gaussian, mut channels) = match *colours {
        Colours::Channels { values, channels } => (values, channels, channels),
        Colours::Harmonics { coefficients, count, .. } => (coefficients, count.saturating_mul(3), 3),
    };
    check::channels(channels)?;
    let per_camera = n.saturating_mul(per_gaussian);
    if values.len() != per_camera {
        check::length("colors", per_camera.saturating_mul(c), values.len())?;
    }
    check::finite("colors", values)?;
    let background_channels = channels;
    if let Some(backgrounds) = options.backgrounds {
        check::length("backgrounds", c.saturating_mul(channels), backgrounds.len())?;
        check::finite("backgrounds", backgrounds)?;
    }
    for (viewmat, k) in viewmats.iter().zip(ks) {
        check::eye(viewmat)?;
        check::camera(k)?;
    }
    let mode = options.render_mode;
    channels = if mode.has_colours() { channels } else { 0 } + usize::from(mode.has_depth());
    check::channels(channels)?;
    let mut all = Rasterisation {
        gaussians: *gaussians,
        source: *colours,
        options: *options,
        channels,
        cameras: Vec::with_capacity(c),
        colours: Vec::new(),
        alphas: Vec::new(),
    };
    for (camera, (viewmat, k)) in viewmats.iter().zip(ks).enumerate() {
        let view = View::checked(gaussians, viewmat, k, options)?;
        let mut seen = Vec::new();
        let own: &[f32] = match *colours {
            _ if !mode.has_colours() => &[],
            Colours::Channels { .. } => part(values, camera, per_camera),
            Colours::Harmonics { count, degree, .. } => {
                let own = part(values, camera, per_camera);
                seen = harmonic_colours(own, count, degree, gaussians.means, view.eye())?;
                seen.as_flattened()
            }
        };
        let depth: &[f32] = if mode.has_depth() { &view.projected().depth } else { &[] };
        let drawn = joined(own, depth, n, channels);
        let mut background = Vec::new();
        if let Some(backgrounds) = options.backgrounds.filter(|_| mode.has_colours()) {
            background.extend_from_slice(part(backgrounds, camera, background_channels));
            background.resize(channels, 0.0);
        }
        let (image, alpha) = view.draw(&drawn, channels, &background)?;
        all.colours.extend_from_slice(&image);
        if mode.is_expected() {
            let from = all.colours.len() - image.len();
            for (pixel, alpha) in all.colours[from..].chunks_exact_mut(channels).zip(&alpha) {
                pixel[channels - 1] /= alpha.max(LEAST_ALPHA);
            }
        }
        all.alphas.extend_from_slice(&alpha);
        all.cameras.push(Drawn { view, seen, colours: drawn, background, image });
    }
    Ok(all)
}

/// Joins colours and depth to `[N, D]`; either may be empty.
fn joined(colours: &[f32], depth: &[f32], n: usize, channels: usize) -> Vec<f32> {
    let from = channels - usize::from(!depth.is_empty());
    let mut all = Vec::with_capacity(n * channels);
    for i in 0..n {
        all.extend_from_slice(&colours[i * from..][..from]);
        all.extend(depth.get(i));
    }
    all
}

impl Rasterisation<'_> {
    /// Returns the images `[C, H, W, D]`.
    pub fn colours(&self) -> &[f32] {
        &self.colours
    }

    /// Returns the alphas `[C, H, W]`.
    pub fn alphas(&self) -> &[f32] {
        &self.alphas
    }

    /// Returns the number of values per pixel of [`Rasterisation::colours`].
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Iterates over the Gaussians as seen by each camera.
    pub fn projected(&self) -> impl Iterator<Item = &Projected> {
        self.cameras.iter().map(|camera| camera.view.projected())
    }

    /// Computes the gradients of a loss from those by [`Rasterisation::colours`] and [`Rasterisation::alphas`]. Cameras
    /// are added in ascending order.
    ///
    /// # Errors
    /// Slices of another length.
    pub fn backward(&self, of_colours: &[f32], of_alphas: &[f32]) -> Result<Gradients, RasterError> {
        check::length("gradients of colours", self.colours.len(), of_colours.len())?;
        check::length("gradients of alphas", self.alphas.len(), of_alphas.len())?;
        let (n, channels, mode) = (self.gaussians.means.len(), self.channels, self.options.render_mode);
        let pixels = self.options.width * self.options.height;
        let own_channels = channels - usize::from(mode.has_depth());
        let mut to = GaussianGradients::zeros(n);
        let source = match self.source {
            Colours::Channels { values, .. } => values,
            Colours::Harmonics { coefficients, .. } => coefficients,
        };
        let mut of_source = vec![0.0; source.len()];
        let (mut of_backgrounds, mut of_viewmats) = (Vec::new(), Vec::new());
        for (at, camera) in self.cameras.iter().enumerate() {
            let range = at * pixels..(at + 1) * pixels;
            let mut of_image = of_colours[range.start * channels..range.end * channels].to_vec();
            let mut of_alpha = of_alphas[range.clone()].to_vec();
            let alpha = &self.alphas[range];
            if mode.is_expected() {
                for (i, of) in of_image.chunks_exact_mut(channels).enumerate() {
                    let (of, held) = (&mut of[channels - 1], alpha[i].max(LEAST_ALPHA));
                    if alpha[i] > LEAST_ALPHA {
                        of_alpha[i] -= *of * (camera.image[i * channels + channels - 1] / held) / held;
                    }
                    *of /= held;
                }
            }
            let (mut of_drawn, mut of_background) = (vec![0.0; n * channels], vec![0.0; camera.background.len()]);
            let footprints = camera.view.draw_gradients(
                &camera.colours,
                channels,
                &camera.background,
                [&camera.image, alpha],
                [&of_image, &of_alpha],
                &mut of_drawn,
                &mut of_background,
            )?;
            let each = || of_drawn.chunks_exact(channels);
            let of_depth: Option<Vec<f32>> = mode.has_depth().then(|| each().map(|of| of[channels - 1]).collect());
            let mut of_eye = [0.0; 3];
            if mode.has_colours() {
                let shared = self.is_shared();
                let start = if shared { 0 } else { at * (source.len() / self.cameras.len()) };
                match self.source {
                    Colours::Channels { .. } => {
                        let to = of_source[start..].chunks_exact_mut(own_channels);
                        for (to, of) in to.zip(each()) {
                            to.iter_mut().zip(of).for_each(|(to, of)| *to += of);
                        }
                    }
                    Colours::Harmonics { count, degree, .. } => {
                        let own = &source[start..][..n * count * 3];
                        let of: Vec<[f32; 3]> = each().map(|of| [of[0], of[1], of[2]]).collect();
                        let means = self.gaussians.means;
                        let found =
                            harmonic_gradients(own, count, degree, means, camera.view.eye(), &camera.seen, &of)?;
                        let HarmonicGradients { coefficients, means, eye } = found;
                        of_source[start..].iter_mut().zip(&coefficients).for_each(|(to, of)| *to += of);
                        let from = means.as_flattened();
                        to.means.as_flattened_mut().iter_mut().zip(from).for_each(|(to, of)| *to += of);
                        of_eye = eye;
                    }
                }
            }
            of_viewmats.push(camera.view.gradients(
                &self.gaussians,
                &footprints,
                of_depth.as_deref(),
                of_eye,
                &mut to,
            )?);
            if self.options.backgrounds.is_some() {
                let own = of_background.iter().map(|&of| of as f32).take(own_channels);
                let width = self.options.backgrounds.map_or(0, <[f32]>::len) / self.cameras.len();
                of_backgrounds.extend(own.chain(std::iter::repeat(0.0)).take(width));
            }
        }
        let GaussianGradients { means, quats, scales, opacities } = to;
        Ok(Gradients {
            means,
            quats,
            scales,
            opacities,
            colours: of_source,
            backgrounds: of_backgrounds,
            viewmats: of_viewmats,
        })
    }

    /// Returns true if all cameras see the same colours.
    fn is_shared(&self) -> bool {
        let n = self.gaussians.means.len();
        match self.source {
            Colours::Channels { values, channels } => values.len() == n * channels,
            Colours::Harmonics { coefficients, count, .. } => coefficients.len() == n * count * 3,
        }
    }
}

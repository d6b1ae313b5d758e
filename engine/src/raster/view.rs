//! One camera's view of Gaussians.

use streamsplat_kernels::Level;
use streamsplat_kernels::raster::{
    self, Drawing, FootprintGradient, Projected, WorldGradients, WorldProjection, WorldRasteriser, WorldView,
};

use super::{CameraMatrix, Gaussians, Options, RasterError, ViewMatrix, check};

/// Gaussians as seen by one camera: their footprints and lists, images in any colours, and gradients.
#[derive(Debug)]
pub struct View {
    rasteriser: WorldRasteriser,
    eye: [f64; 3],
    inverse: [[f64; 3]; 3],
}

/// Gradients of a loss with respect to Gaussians.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GaussianGradients {
    /// By means, `[N]`.
    pub means: Vec<[f32; 3]>,
    /// By quaternions, `[N]`.
    pub quats: Vec<[f32; 4]>,
    /// By scales, `[N]`.
    pub scales: Vec<[f32; 3]>,
    /// By opacities, `[N]`.
    pub opacities: Vec<f32>,
}

impl GaussianGradients {
    /// Returns zeros for `count` Gaussians.
    pub fn zeros(count: usize) -> Self {
        Self {
            means: vec![[0.0; 3]; count],
            quats: vec![[0.0; 4]; count],
            scales: vec![[0.0; 3]; count],
            opacities: vec![0.0; count],
        }
    }
}

fn kernel<'a>(gaussians: &Gaussians<'a>) -> raster::Gaussians<'a> {
    raster::Gaussians {
        mean: gaussians.means,
        scale: gaussians.scales,
        rotation: Some(gaussians.quats),
        opacity: gaussians.opacities,
        rgb: &[],
    }
}

impl View {
    /// Builds the view of a camera. It uses these `options`: size, planes, `radius_clip`, `eps2d`, and the kinds of
    /// rays and of anti-aliasing.
    ///
    /// # Errors
    /// Arguments that cannot be drawn.
    pub fn new(
        gaussians: &Gaussians<'_>,
        viewmat: &ViewMatrix,
        k: &CameraMatrix,
        options: &Options<'_>,
    ) -> Result<Self, RasterError> {
        check::options(options)?;
        check::gaussians(gaussians)?;
        Self::checked(gaussians, viewmat, k, options)
    }

    /// Builds a view as [`View::new`] does, from Gaussians and options that were checked.
    pub(super) fn checked(
        gaussians: &Gaussians<'_>,
        viewmat: &ViewMatrix,
        k: &CameraMatrix,
        options: &Options<'_>,
    ) -> Result<Self, RasterError> {
        let (eye, inverse) = check::eye(viewmat)?;
        let (focal, centre) = check::camera(k)?;
        let view = WorldView {
            world_to_view: [viewmat[0], viewmat[1], viewmat[2]],
            projection: if options.orthographic { WorldProjection::Orthographic } else { WorldProjection::Pinhole },
            focal,
            centre,
            width: options.width,
            height: options.height,
            near: options.near_plane,
            far: options.far_plane,
            least_radius: options.radius_clip,
            low_pass: options.eps2d,
            antialias: options.antialiased,
            largest_alpha: options.largest_alpha,
        };
        let mut rasteriser = WorldRasteriser::new(Level::detect());
        rasteriser.project(&kernel(gaussians), &view);
        Ok(Self { rasteriser, eye, inverse })
    }

    /// Returns the Gaussians as seen by the camera.
    pub fn projected(&self) -> &Projected {
        self.rasteriser.projected()
    }

    /// Returns the eye's position.
    pub fn eye(&self) -> [f32; 3] {
        self.eye.map(|v| v as f32)
    }

    /// Returns the number of pixels of the image.
    fn pixels(&self) -> usize {
        let [width, height] = self.rasteriser.size();
        width * height
    }

    fn drawing<'a>(
        &self,
        colours: &'a [f32],
        channels: usize,
        background: &'a [f32],
    ) -> Result<Drawing<'a>, RasterError> {
        check::channels(channels)?;
        check::length("colors", self.rasteriser.gaussians() * channels, colours.len())?;
        if !background.is_empty() {
            check::length("backgrounds", channels, background.len())?;
        }
        Ok(Drawing { channels, colours, background })
    }

    /// Draws the image `[H, W, D]` and its alpha `[H, W]` with `colours [N, D]` and a `background [D]` or none.
    ///
    /// # Errors
    /// Slices of wrong length, and images that do not fit in memory.
    pub fn draw(
        &self,
        colours: &[f32],
        channels: usize,
        background: &[f32],
    ) -> Result<(Vec<f32>, Vec<f32>), RasterError> {
        let drawing = self.drawing(colours, channels, background)?;
        let pixels = self.pixels();
        let size = self.rasteriser.size();
        let (mut image, mut alpha) = (check::zeros(pixels * channels, size)?, check::zeros(pixels, size)?);
        self.rasteriser.draw(&drawing, &mut image, &mut alpha);
        Ok((image, alpha))
    }

    /// Computes gradients of a loss. `drawn` are image and alpha of [`View::draw`], and `of` the gradients by them.
    /// `of_colours [N, D]` and `of_background [D]` (or an empty slice) are overwritten. Returns the gradients by
    /// footprints.
    ///
    /// # Errors
    /// Slices of wrong length.
    #[expect(clippy::too_many_arguments, reason = "what was drawn, two gradients in, two out")]
    pub fn draw_gradients(
        &self,
        colours: &[f32],
        channels: usize,
        background: &[f32],
        drawn: [&[f32]; 2],
        of: [&[f32]; 2],
        of_colours: &mut [f32],
        of_background: &mut [f64],
    ) -> Result<Vec<FootprintGradient>, RasterError> {
        let drawing = self.drawing(colours, channels, background)?;
        for [image, alpha] in [drawn, of] {
            check::length("image", self.pixels() * channels, image.len())?;
            check::length("alpha", self.pixels(), alpha.len())?;
        }
        check::length("gradients of colors", colours.len(), of_colours.len())?;
        check::length("gradients of backgrounds", background.len(), of_background.len())?;
        let mut footprints = vec![FootprintGradient::default(); self.rasteriser.gaussians()];
        self.rasteriser.draw_adjoint(&drawing, drawn, of, &mut footprints, of_colours, of_background);
        Ok(footprints)
    }

    /// Adds to `to` the gradients by Gaussians that were projected, from those by footprints, by depths `[N]` if there
    /// are any, and by [`View::eye`]. Returns the gradient by the view matrix, whose last row is 0.
    ///
    /// # Errors
    /// Slices of wrong length.
    pub fn gradients(
        &self,
        gaussians: &Gaussians<'_>,
        footprints: &[FootprintGradient],
        of_depth: Option<&[f32]>,
        of_eye: [f64; 3],
        to: &mut GaussianGradients,
    ) -> Result<ViewMatrix, RasterError> {
        let n = self.rasteriser.gaussians();
        let Gaussians { means, quats, scales, opacities } = gaussians;
        let sizes = [means.len(), quats.len(), scales.len(), opacities.len(), footprints.len()];
        let out = [to.means.len(), to.quats.len(), to.scales.len(), to.opacities.len()];
        for found in sizes.into_iter().chain(out).chain(of_depth.map(<[_]>::len)) {
            check::length("Gaussians", n, found)?;
        }
        let GaussianGradients { means: mean, quats: rotation, scales: scale, opacities: opacity } = to;
        let to = WorldGradients { mean, rotation, scale, opacity };
        let mut of = self.rasteriser.project_adjoint(&kernel(gaussians), footprints, of_depth, to);
        // The eye is −V⁻¹·t: ∂L/∂t −= V⁻ᵀ·g and ∂L/∂V −= V⁻ᵀ·g·eyeᵀ.
        for row in 0..3 {
            let pulled: f64 = (0..3).map(|k| self.inverse[k][row] * of_eye[k]).sum();
            for column in 0..3 {
                of[row][column] -= pulled * self.eye[column];
            }
            of[row][3] -= pulled;
        }
        let [a, b, c] = of.map(|row| row.map(|v| v as f32));
        Ok([a, b, c, [0.0; 4]])
    }
}

//! Difficult splats.

use streamsplat_kernels::raster::{Gaussians, OwnedGaussians, Projection, Request};

/// Pixels per row and rows: no multiple of a tile or a block.
pub(super) const SIZE: [usize; 2] = [61, 45];

/// Splats in view space, and their view.
#[derive(Clone)]
pub(super) struct Scene {
    pub splats: OwnedGaussians,
    pub projection: Projection,
}

pub(super) const ORTHOGRAPHIC: Projection = Projection::Orthographic { focal: [30.0, 22.0] };
pub(super) const PINHOLE: Projection = Projection::Pinhole { focal: [50.0, 50.0], centre: [30.0, 22.0] };

impl Scene {
    /// A scene without splats, whose splats will all be `rotated` or none.
    pub(super) fn new(projection: Projection, rotated: bool) -> Scene {
        Scene { splats: OwnedGaussians { rotation: rotated.then(Vec::new), ..OwnedGaussians::default() }, projection }
    }

    /// Adds a splat that is not rotated.
    pub(super) fn push(&mut self, mean: [f32; 3], scale: [f32; 3], opacity: f32) {
        let shade = (self.splats.mean.len() % 7) as f32 / 7.0;
        self.splats.push(mean, scale, [1.0, 0.0, 0.0, 0.0], opacity, [shade, 1.0 - shade, 0.3]);
    }

    /// A few ordinary splats, rotated or not.
    pub(super) fn plain(projection: Projection, rotated: bool) -> Scene {
        let mut scene = Scene::new(projection, rotated);
        for i in 0..40 {
            let (a, b) = ((i * 7 % 40) as f32 / 20.0 - 1.0, (i * 11 % 40) as f32 / 20.0 - 1.0);
            scene.push([0.9 * a, 0.9 * b, 1.0 + 0.1 * i as f32], [0.1, 0.2, 0.15], 0.3 + 0.01 * i as f32);
        }
        if let Some(rotation) = &mut scene.splats.rotation {
            rotation.iter_mut().enumerate().for_each(|(i, q)| *q = about_z(i as f32 * 9.0));
        }
        scene
    }

    pub(super) fn gaussians(&self) -> Gaussians<'_> {
        self.splats.gaussians()
    }

    pub(super) fn request(&self) -> Request {
        let [width, height] = SIZE;
        Request { depth: true, alpha: true, statistics: true, ..Request::colour(width, height, [0.5; 3]) }
    }
}

/// The rotation by `degrees` about the view's axis.
pub(super) fn about_z(degrees: f32) -> [f32; 4] {
    let half = (0.5 * f64::from(degrees)).to_radians();
    [half.cos() as f32, 0.0, 0.0, half.sin() as f32]
}

//! Splats made to go wrong.

use streamsplat_kernels::raster::{Gaussians, Projection, Request};

/// Pixels per row and rows: no multiple of a tile or a block.
pub(super) const SIZE: [usize; 2] = [61, 45];

/// Splats in view space, and how they are seen.
#[derive(Clone)]
pub(super) struct Scene {
    pub mean: Vec<[f32; 3]>,
    pub scale: Vec<[f32; 3]>,
    pub rotation: Option<Vec<[f32; 4]>>,
    pub opacity: Vec<f32>,
    pub rgb: Vec<[f32; 3]>,
    pub projection: Projection,
}

pub(super) const ORTHOGRAPHIC: Projection = Projection::Orthographic { focal: [30.0, 22.0] };
pub(super) const PINHOLE: Projection = Projection::Pinhole { focal: [50.0, 50.0], centre: [30.0, 22.0] };

impl Scene {
    pub(super) fn new(projection: Projection) -> Scene {
        let none = (Vec::new(), Vec::new(), Vec::new());
        Scene { mean: none.0, scale: none.1, rotation: None, opacity: Vec::new(), rgb: none.2, projection }
    }

    /// One more, not rotated.
    pub(super) fn push(&mut self, mean: [f32; 3], scale: [f32; 3], opacity: f32) {
        let shade = (self.mean.len() % 7) as f32 / 7.0;
        self.mean.push(mean);
        self.scale.push(scale);
        self.opacity.push(opacity);
        self.rgb.push([shade, 1.0 - shade, 0.3]);
        if let Some(rotation) = &mut self.rotation {
            rotation.push([1.0, 0.0, 0.0, 0.0]);
        }
    }

    /// A few unremarkable splats, rotated or not.
    pub(super) fn plain(projection: Projection, rotated: bool) -> Scene {
        let mut scene = Scene::new(projection);
        scene.rotation = rotated.then(Vec::new);
        for i in 0..40 {
            let (a, b) = ((i * 7 % 40) as f32 / 20.0 - 1.0, (i * 11 % 40) as f32 / 20.0 - 1.0);
            scene.push([0.9 * a, 0.9 * b, 1.0 + 0.1 * i as f32], [0.1, 0.2, 0.15], 0.3 + 0.01 * i as f32);
        }
        if let Some(rotation) = &mut scene.rotation {
            rotation.iter_mut().enumerate().for_each(|(i, q)| *q = about_z(i as f32 * 9.0));
        }
        scene
    }

    pub(super) fn gaussians(&self) -> Gaussians<'_> {
        Gaussians {
            mean: &self.mean,
            scale: &self.scale,
            rotation: self.rotation.as_deref(),
            opacity: &self.opacity,
            rgb: &self.rgb,
        }
    }

    pub(super) fn request(&self) -> Request {
        let [width, height] = SIZE;
        Request { width, height, background: [0.5; 3], depth: true, alpha: true, statistics: true }
    }
}

/// The rotation by so many degrees about the view's axis.
pub(super) fn about_z(degrees: f32) -> [f32; 4] {
    let half = (0.5 * f64::from(degrees)).to_radians();
    [half.cos() as f32, 0.0, 0.0, half.sin() as f32]
}

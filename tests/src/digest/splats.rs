//! The rasteriser on the oracle's scenes.

use safetensors::SafeTensors;
use streamsplat_kernels::raster::{Gaussians, Image, Projection, Request, render};

use super::{Digest, Thing};

pub(super) fn things() -> Vec<Thing> {
    ["predicted-t050", "rotated-orthographic", "perspective", "extreme"]
        .map(|name| {
            Thing::new(format!("splats/{name}"), move |level, digest| {
                let scene = Scene::read(name);
                let image = render(level, &scene.gaussians(), &scene.projection, &scene.request);
                add(digest, &image);
            })
        })
        .into()
}

/// An image, all planes of it.
pub(super) fn add(digest: &mut Digest, image: &Image) {
    digest.floats(&image.rgb);
    for plane in [&image.depth, &image.alpha, &image.final_t].into_iter().flatten() {
        digest.floats(plane);
    }
    digest.integers(image.blended.iter().flatten().map(|n| u64::from(*n)));
    digest.integers([image.dropped]);
}

/// A scene of the oracle.
pub struct Scene {
    mean: Vec<[f32; 3]>,
    scale: Vec<[f32; 3]>,
    rotation: Vec<[f32; 4]>,
    opacity: Vec<f32>,
    rgb: Vec<[f32; 3]>,
    /// How it is projected.
    pub projection: Projection,
    /// What the oracle drew.
    pub request: Request,
}

impl Scene {
    /// Reads `fixtures/oracle/NAME.safetensors`.
    ///
    /// # Panics
    /// When it cannot be read.
    pub fn read(name: &str) -> Self {
        let path = streamsplat_fixtures::path(&format!("oracle/{name}.safetensors"));
        let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let file = SafeTensors::deserialize(&bytes).expect("a safetensors file");
        let words =
            |name: &str| -> Option<Vec<[u8; 4]>> { Some(file.tensor(name).ok()?.data().as_chunks::<4>().0.to_vec()) };
        let floats =
            |name: &str| -> Option<Vec<f32>> { Some(words(name)?.into_iter().map(f32::from_le_bytes).collect()) };
        let wanted = |name: &str| floats(name).unwrap_or_else(|| panic!("{}: no {name}", path.display()));
        let size: Vec<usize> =
            words("size").expect("a size").into_iter().map(|b| i32::from_le_bytes(b) as usize).collect();
        let projection = match floats("intrinsics") {
            Some(v) => Projection::Pinhole { focal: [v[0], v[1]], centre: [v[2], v[3]] },
            None => Projection::Orthographic { focal: wanted("focal").as_chunks().0[0] },
        };
        Self {
            mean: wanted("mean").as_chunks().0.to_vec(),
            scale: wanted("scale").as_chunks().0.to_vec(),
            rotation: wanted("quat").as_chunks().0.to_vec(),
            opacity: wanted("opacity"),
            rgb: wanted("rgb").as_chunks().0.to_vec(),
            projection,
            request: Request {
                width: size[1],
                height: size[0],
                background: wanted("background").as_chunks().0[0],
                depth: true,
                alpha: true,
                statistics: true,
            },
        }
    }

    /// Its Gaussians.
    pub fn gaussians(&self) -> Gaussians<'_> {
        Gaussians {
            mean: &self.mean,
            scale: &self.scale,
            rotation: Some(&self.rotation),
            opacity: &self.opacity,
            rgb: &self.rgb,
        }
    }
}

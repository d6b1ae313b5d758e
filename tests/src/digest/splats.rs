//! The rasteriser on the oracle's scenes.

use streamsplat::splats::Splats;
use streamsplat_kernels::raster::{Image, render};

use super::{Digest, Thing};

pub(super) fn things() -> Vec<Thing> {
    ["predicted-t050", "rotated-orthographic", "perspective", "extreme"]
        .map(|name| {
            Thing::new(format!("splats/{name}"), move |level, digest| {
                let scene = scene(name);
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

/// Reads `fixtures/oracle/NAME.safetensors`.
///
/// # Panics
/// When it cannot be read.
pub fn scene(name: &str) -> Splats {
    let path = streamsplat_fixtures::path(&format!("oracle/{name}.safetensors"));
    let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    Splats::from_safetensors(&bytes).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

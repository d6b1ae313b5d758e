//! The rasteriser on the oracle's scenes.

use crate::splats::Splats;
use streamsplat_kernels::Level;
use streamsplat_kernels::raster::{
    ColourFit, ColourMap, Drawing, Effort, FitView, FootprintGradient, Image, Projection, Solution, WorldGradients,
    WorldRasteriser, WorldView, render,
};

use super::{Digest, Thing};

pub(super) fn things() -> Vec<Thing> {
    let scenes = ["predicted-t050", "rotated-orthographic", "perspective", "extreme"];
    let images = scenes.map(|name| {
        Thing::new(format!("splats/{name}"), move |level, digest| {
            let scene = scene(name);
            let image = render(level, &scene.gaussians(), &scene.projection, &scene.request);
            add(digest, &image);
        })
    });
    let maps = scenes
        .map(|name| Thing::new(format!("colour-map/{name}"), move |level, digest| linear(level, digest, &scene(name))));
    let world = Thing::new("splats/world", |level, digest| world(level, digest, &scene("perspective")));
    images.into_iter().chain(maps).chain([world]).collect()
}

/// The linear map of the colours: adjoint, normal operator, residual and sums, of the scene's colours and its image in
/// negative.
fn linear(level: Level, digest: &mut Digest, scene: &Splats) {
    let (gaussians, background) = (scene.gaussians(), scene.request.background);
    let size = [scene.request.width, scene.request.height];
    let mut map = ColourMap::new(level);
    map.prepare(&gaussians, &scene.projection, size);
    let mut image = vec![0.0; 3 * size[0] * size[1]];
    map.forward(gaussians.rgb, background, &mut image);
    digest.floats(&image);
    let mut sums = vec![[0.0; 3]; map.gaussians()];
    map.adjoint(&image, &mut sums);
    digest.floats(sums.as_flattened());
    map.normal(gaussians.rgb, &mut sums);
    digest.floats(sums.as_flattened());
    let negative: Vec<f32> = image.iter().map(|v| 1.0 - v).collect();
    let squares = map.residual_adjoint(gaussians.rgb, background, &negative, &mut sums);
    digest.floats(sums.as_flattened());
    digest.doubles(&[squares]);
    let (mut rows, mut columns) = (vec![0.0; map.gaussians()], vec![[0.0; 2]; map.gaussians()]);
    map.row_sums(&mut rows);
    map.column_sums(&mut columns);
    digest.floats(&rows);
    digest.floats(columns.as_flattened());
    let unknown: Vec<u32> = (0..).take(map.gaussians()).collect();
    let factor: Vec<f32> = unknown.iter().map(|i| 1.0 - 0.25 * (i % 7) as f32).collect();
    let views = [&[][..], &factor].map(|factor| FitView { map: &map, unknown: &unknown, factor });
    let fit = ColourFit::new(level, views.to_vec(), unknown.len(), 1e-3);
    let Solution { change, steps } =
        fit.solve(gaussians.rgb, &[&negative, &image], background, Effort { steps: 3, ..Effort::default() });
    digest.floats(change.as_flattened());
    digest.integers([u64::from(steps)]);
}

/// The scene by gsplat's conventions from a slightly moved camera, in five channels, and the gradients of a loss.
fn world(level: Level, digest: &mut Digest, scene: &Splats) {
    let gaussians = scene.gaussians();
    let Projection::Pinhole { focal, centre } = scene.projection else { panic!("a pinhole") };
    let size = [scene.request.width, scene.request.height];
    let matrix = [[0.99, 0.02, -0.05, 0.03], [-0.02, 1.0, 0.01, -0.04], [0.05, -0.01, 0.98, 0.1]];
    for antialias in [false, true] {
        let mut rasteriser = WorldRasteriser::new(level);
        rasteriser.project(&gaussians, &WorldView { antialias, ..WorldView::pinhole(matrix, focal, centre, size) });
        let projected = rasteriser.projected();
        digest.floats(projected.centre.as_flattened());
        digest.floats(projected.conic.as_flattened());
        digest.floats(&projected.opacity);
        digest.integers(projected.radius.as_flattened().iter().map(|&r| u64::from(r.unsigned_abs())));
        let colours: Vec<f32> =
            gaussians.rgb.iter().zip(gaussians.mean).flat_map(|(c, m)| [c[0], c[1], c[2], m[0], m[2]]).collect();
        let drawing = Drawing { channels: 5, colours: &colours, background: &[0.1, 0.2, 0.3, 0.4, 0.5] };
        let (mut image, mut alpha) = (vec![0.0; 5 * size[0] * size[1]], vec![0.0; size[0] * size[1]]);
        rasteriser.draw(&drawing, &mut image, &mut alpha);
        digest.floats(&image);
        digest.floats(&alpha);
        let of_image: Vec<f32> = image.iter().map(|v| v - 0.5).collect();
        let of_alpha: Vec<f32> = alpha.iter().map(|v| 0.25 - v).collect();
        let n = gaussians.len();
        let mut footprints = vec![FootprintGradient::default(); n];
        let (mut of_colours, mut of_background) = (vec![0.0; 5 * n], [0.0; 5]);
        let of = [&of_image[..], &of_alpha];
        rasteriser.draw_adjoint(&drawing, [&image, &alpha], of, &mut footprints, &mut of_colours, &mut of_background);
        let (mut mean, mut rotation) = (vec![[0.0; 3]; n], vec![[0.0; 4]; n]);
        let (mut scale, mut opacity) = (vec![[0.0; 3]; n], vec![0.0; n]);
        let to = WorldGradients { mean: &mut mean, rotation: &mut rotation, scale: &mut scale, opacity: &mut opacity };
        let view = rasteriser.project_adjoint(&gaussians, &footprints, None, to);
        for of in [&of_colours, mean.as_flattened(), rotation.as_flattened(), scale.as_flattened(), &opacity] {
            digest.floats(of);
        }
        digest.doubles(&of_background);
        digest.doubles(view.as_flattened());
    }
}

/// Adds all planes of an image.
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

//! Gaussians of a pixel's size along edges of depth.
//!
//! Where the model's Gaussians cross an edge, the picture needs an order in which near and far ones mix; lifted, all
//! near ones cover the far ones. So along edges each pixel gets a Gaussian of its own, on its own side and in its own
//! colour, if it is within [`BAND`] pixels of the edge and the picture has some contrast there. Their colours are
//! fitted with all others.

use rayon::prelude::*;
use streamsplat_model::{StaticGaussian, StaticGaussians};

use super::THIN;
use super::edges::{Place, Surfaces};
use crate::world::{scene_depth, y_at};

/// Pixels from an edge.
const BAND: f32 = 3.0;
/// Range of a channel over 3×3 pixels from which on a pixel gets its own Gaussian.
const CONTRAST: f32 = 0.02;
/// Standard deviation in pixels.
const SCALE: f32 = 0.3;
const OPACITY: f32 = 0.3;

/// Adds the Gaussians of all pixels along edges, row by row; returns for each the factor by which its colour is
/// [held](super::HELD).
pub(super) fn add(gaussians: &mut StaticGaussians, surfaces: &Surfaces<'_>) -> Vec<f32> {
    let [height, width] = surfaces.resolution();
    let along = |pixel: usize| {
        let (row, column) = (pixel / width, pixel % width);
        let own = surfaces.edge_within(row, column, BAND) && surfaces.contrast(row, column) >= CONTRAST;
        own.then(|| (pixel, surfaces.at(row, column)))
    };
    let found: Vec<(usize, Place)> = (0..height * width).into_par_iter().with_min_len(256).filter_map(along).collect();
    let middle = |i: usize, side: usize| (2.0 * i as f32 + 1.0) / side as f32 - 1.0;
    for (pixel, place) in &found {
        let y = y_at(scene_depth(place.inverse));
        gaussians.push(StaticGaussian {
            position: [middle(pixel % width, width), y, -middle(pixel / width, height)],
            scale: [SCALE * 2.0 / width as f32, SCALE * 2.0 / height as f32],
            thickness: THIN,
            opacity: OPACITY,
            rgb: surfaces.colour(*pixel),
        });
    }
    found.iter().map(|(_, place)| place.held()).collect()
}

impl Surfaces<'_> {
    /// The largest range of a channel over the 3×3 pixels around one.
    fn contrast(&self, row: usize, column: usize) -> f32 {
        let [height, width] = self.resolution();
        let (mut least, mut most) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for y in row.saturating_sub(1)..(row + 2).min(height) {
            for x in column.saturating_sub(1)..(column + 2).min(width) {
                let rgb = self.colour(y * width + x);
                for channel in 0..3 {
                    least[channel] = least[channel].min(rgb[channel]);
                    most[channel] = most[channel].max(rgb[channel]);
                }
            }
        }
        (0..3).map(|channel| most[channel] - least[channel]).fold(0.0, f32::max)
    }
}

#[cfg(test)]
mod tests {
    use streamsplat_kernels::Level;

    use super::super::DepthMap;
    use super::*;
    use crate::world::{FAR, NEAR};

    #[test]
    fn pixels_along_edges_of_depth_and_colour_get_their_own_on_their_side() {
        const SIZE: [usize; 2] = [6, 32];
        let near = |at: usize| at % 32 >= 16;
        let inverse: Vec<f32> = (0..6 * 32).map(|at| f32::from(u8::from(near(at)))).collect();
        let map = DepthMap { inverse: inverse.clone(), confidence: None, resolution: SIZE };
        let rest = vec![0.25; 2 * 6 * 32];
        for (red, columns) in [(inverse.clone(), 15..17), (vec![0.5; 6 * 32], 0..0)] {
            let frame = [red, rest.clone()].concat();
            let mut gaussians = StaticGaussians::default();
            let added = add(&mut gaussians, &Surfaces::new(Level::scalar(), &map, &frame)).len();
            assert_eq!(added, 6 * columns.len(), "where colours differ, within a pixel");
            assert_eq!(added, gaussians.position.len());
            for (i, [x, y, _]) in gaussians.position.iter().enumerate() {
                let column = columns.start + i % columns.len();
                assert!((x - ((2 * column + 1) as f32 / 32.0 - 1.0)).abs() < 1e-6);
                assert!((y - if column >= 16 { NEAR } else { FAR }).abs() < 1e-3, "{column}: {y}");
                assert_eq!(gaussians.rgb[i], [f32::from(u8::from(column >= 16)), 0.25, 0.25]);
            }
        }
    }
}

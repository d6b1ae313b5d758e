//! Colours where an image has none: what lies around goes on there, ever more smoothly.
//!
//! An image's pixel is `C + (1 − A)·b`: what was drawn, multiplied by its coverage A, on the background b. [`fill`] puts a colour of the surroundings in
//! place of b, by pull and push (Gortler et al., The Lumigraph, 1996, section 3.4):
//!
//! ```text
//! pull    W' = ΣW   C' = ΣC   over the 2×2 (at an odd end fewer) pixels below, C' divided by W' and W' = 1 where W' is above 1
//! push    F = C + (1 − W)·up(F')        F = C/W, b where W is 0, at the top, of one pixel
//! ```
//!
//! with `W = min(A, 1)` at the bottom and `up` the bilinear interpolation of the level above. Rows and columns end at the image's edge. Covered pixels
//! keep their colour.
//!
//! # Order of operations
//! Binary32. Sums of the pull go over the upper row, then the lower one, from the left, each from +0. `up` is, along x, then along y,
//! `near + ¼·(far − near)`: `near` is the pixel above, `far` the one on the other side of the pixel, at the edge the same.
//!
//! Tracing: one span `fill` per image.

use rayon::prelude::*;
use tracing::debug_span;

use crate::raster::Image;
use crate::size::product;

pub mod reference;
#[cfg(test)]
mod tests;

/// Colour times coverage, and coverage.
type Pixel = [f32; 4];

/// A level of the pyramid.
struct Plane {
    width: usize,
    pixels: Vec<Pixel>,
}

/// The share of an image's pixels less than half of which is covered; 0 without alpha.
pub fn uncovered(image: &Image) -> f64 {
    let alpha = image.alpha.as_deref().unwrap_or_default();
    alpha.iter().filter(|alpha| **alpha < 0.5).count() as f64 / alpha.len().max(1) as f64
}

/// Puts colours of what lies around in place of an image's background. Returns [`uncovered`].
///
/// Alpha, depth and the other planes stay.
///
/// # Panics
/// When the image has no alpha, or planes of other sizes.
pub fn fill(image: &mut Image, background: [f32; 3]) -> f64 {
    let _span = debug_span!("fill", width = image.width, height = image.height).entered();
    let (width, count) = (image.width, product([image.width, image.height]));
    let alpha = image.alpha.as_deref().expect("alpha, which says where colours are missing");
    assert!(alpha.len() == count && image.rgb.len() == 3 * count, "planes of {width}×{}", image.height);
    if count == 0 {
        return 0.0;
    }
    let share = uncovered(image);
    let [red, green, blue] = [0, 1, 2].map(|c| &image.rgb[c * count..][..count]);
    let bottom = (0..count).into_par_iter().map(|i| {
        let weight = if alpha[i] < 1.0 { alpha[i] } else { 1.0 };
        let under = 1.0 - weight;
        [red[i] - under * background[0], green[i] - under * background[1], blue[i] - under * background[2], weight]
    });
    let mut levels = vec![Plane { width, pixels: bottom.collect() }];
    while levels[levels.len() - 1].pixels.len() > 1 {
        levels.push(pull(&levels[levels.len() - 1]));
    }
    let mut above = Plane { width: 1, pixels: Vec::new() };
    for level in levels.into_iter().rev() {
        above = push(level, &above, background);
    }
    for (c, plane) in image.rgb.chunks_exact_mut(count).enumerate() {
        plane.par_iter_mut().zip(&above.pixels).for_each(|(value, pixel)| *value = pixel[c]);
    }
    share
}

/// The level above.
fn pull(below: &Plane) -> Plane {
    let (width, height) = (below.width, below.pixels.len() / below.width);
    let half = width.div_ceil(2);
    let mut pixels = vec![[0.0; 4]; half * height.div_ceil(2)];
    pixels.par_chunks_exact_mut(half).enumerate().for_each(|(y, row)| {
        for (x, to) in row.iter_mut().enumerate() {
            let mut sum = [0.0; 4];
            for from in below.pixels.chunks_exact(width).skip(2 * y).take(2) {
                for pixel in from.iter().skip(2 * x).take(2) {
                    sum = std::array::from_fn(|i| sum[i] + pixel[i]);
                }
            }
            let [red, green, blue, weight] = sum;
            *to = if weight > 1.0 { [red / weight, green / weight, blue / weight, 1.0] } else { sum };
        }
    });
    Plane { width: half, pixels }
}

/// A level whose pixels are wholly covered, as the fourth number has it.
fn push(mut level: Plane, above: &Plane, background: [f32; 3]) -> Plane {
    if level.pixels.len() == 1 {
        let [red, green, blue, weight] = level.pixels[0];
        let [r, g, b] = if weight > 0.0 { [red / weight, green / weight, blue / weight] } else { background };
        level.pixels[0] = [r, g, b, 1.0];
        return level;
    }
    let height = above.pixels.len() / above.width;
    let row = |y: usize| &above.pixels[y * above.width..][..above.width];
    level.pixels.par_chunks_exact_mut(level.width).enumerate().for_each(|(y, to)| {
        let (near, far) = (row(y / 2), row(other(y, height)));
        for (x, pixel) in to.iter_mut().enumerate() {
            let [red, green, blue, weight] = *pixel;
            if weight >= 1.0 {
                continue;
            }
            let (left, right) = (x / 2, other(x, above.width));
            let under = 1.0 - weight;
            let color = |i: usize, value: f32| {
                let along = |row: &[Pixel]| row[left][i] + 0.25 * (row[right][i] - row[left][i]);
                let (near, far) = (along(near), along(far));
                value + under * (near + 0.25 * (far - near))
            };
            *pixel = [color(0, red), color(1, green), color(2, blue), 1.0];
        }
    });
    level
}

/// The other pixel of the level above that a pixel lies between.
fn other(place: usize, above: usize) -> usize {
    let near = place / 2;
    if place.is_multiple_of(2) { near.saturating_sub(1) } else { (near + 1).min(above - 1) }
}

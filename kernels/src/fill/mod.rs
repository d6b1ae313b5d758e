//! Fills pixels without colour from the colours around them, the farther from those the more smoothly.
//!
//! An image's pixel is `C + (1 − A)·b`: the drawn colour, multiplied by its coverage A, on the background b. [`fill`]
//! replaces b by a colour of the surroundings, by pull and push (Gortler et al., The Lumigraph, 1996, section 3.4):
//!
//! ```text
//! pull    W' = ΣW   C' = ΣC   over the 2×2 (at an odd end fewer) pixels below, C' divided by W' and W' = 1 where W' is above 1
//! push    F = C + (1 − W)·up(F')        F = C/W, b where W is 0, at the top, of one pixel
//! ```
//!
//! with `W = min(A, 1)` at the bottom and `up` the bilinear interpolation of the level above. Rows and columns end at
//! the image's edge. Covered pixels keep their colour.
//!
//! # Order of operations
//! Binary32. Sums of the pull go over the upper row, then the lower one, from the left, each from +0. `up` is, along x,
//! then along y, `near + ¼·(far − near)`: `near` is the pixel above, `far` the one on the other side of the pixel, at
//! the edge the same.
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

/// A level of the pyramid above the image.
struct Plane {
    width: usize,
    pixels: Vec<Pixel>,
}

/// The share of an image's pixels less than half of which is covered; 0 without alpha.
pub fn uncovered(image: &Image) -> f64 {
    let alpha = image.alpha.as_deref().unwrap_or_default();
    alpha.iter().filter(|alpha| **alpha < 0.5).count() as f64 / alpha.len().max(1) as f64
}

/// Replaces an image's background by the colours around it. Returns [`uncovered`].
///
/// Alpha, depth and the other planes stay. Takes 5 bytes and a third per pixel while it works.
///
/// # Panics
/// When the image has no alpha, or planes of other sizes.
pub fn fill(image: &mut Image, background: [f32; 3]) -> f64 {
    let _span = debug_span!("fill", width = image.width, height = image.height).entered();
    let (width, count) = (image.width, product([image.width, image.height]));
    let share = uncovered(image);
    let alpha = image.alpha.as_deref().expect("alpha, which says where colours are missing");
    assert!(alpha.len() == count && image.rgb.len() == 3 * count, "planes of {width}×{}", image.height);
    if count == 0 {
        return 0.0;
    }
    let (red, others) = image.rgb.split_at_mut(count);
    let (green, blue) = others.split_at_mut(count);
    let pixel = |[red, green, blue]: [f32; 3], alpha: f32| {
        let weight = if alpha < 1.0 { alpha } else { 1.0 };
        let under = 1.0 - weight;
        [red - under * background[0], green - under * background[1], blue - under * background[2], weight]
    };
    let mut levels = Vec::new();
    if count > 1 {
        levels.push(pull(width, count, |i| pixel([red[i], green[i], blue[i]], alpha[i])));
    }
    while let Some(below) = levels.last().filter(|below| below.pixels.len() > 1) {
        levels.push(pull(below.width, below.pixels.len(), |i| below.pixels[i]));
    }
    let mut above: Option<Plane> = None;
    for mut level in levels.into_iter().rev() {
        level.pixels.par_chunks_exact_mut(level.width).enumerate().for_each(|(y, row)| {
            for (x, pixel) in row.iter_mut().enumerate() {
                *pixel = over(*pixel, above.as_ref(), [x, y], background);
            }
        });
        above = Some(level);
    }
    let rows = red.par_chunks_mut(width).zip(green.par_chunks_mut(width)).zip(blue.par_chunks_mut(width));
    rows.zip(alpha.par_chunks(width)).enumerate().for_each(|(y, (((red, green), blue), alpha))| {
        for x in 0..width {
            let pixel = pixel([red[x], green[x], blue[x]], alpha[x]);
            [red[x], green[x], blue[x], _] = over(pixel, above.as_ref(), [x, y], background);
        }
    });
    share
}

/// The level above `count` pixels in rows of `width`.
fn pull(width: usize, count: usize, pixel: impl Fn(usize) -> Pixel + Sync) -> Plane {
    let (height, half) = (count / width, width.div_ceil(2));
    let mut pixels = vec![[0.0; 4]; half * height.div_ceil(2)];
    pixels.par_chunks_exact_mut(half).enumerate().for_each(|(y, row)| {
        for (x, to) in row.iter_mut().enumerate() {
            let mut sum = [0.0; 4];
            for below in 2 * y..(2 * y + 2).min(height) {
                for beside in 2 * x..(2 * x + 2).min(width) {
                    let pixel = pixel(below * width + beside);
                    sum = std::array::from_fn(|i| sum[i] + pixel[i]);
                }
            }
            let [red, green, blue, weight] = sum;
            *to = if weight > 1.0 { [red / weight, green / weight, blue / weight, 1.0] } else { sum };
        }
    });
    Plane { width: half, pixels }
}

/// A pixel over the level above at its place; at the top level the pixel alone.
#[inline]
fn over(pixel: Pixel, above: Option<&Plane>, [x, y]: [usize; 2], background: [f32; 3]) -> Pixel {
    let [red, green, blue, weight] = pixel;
    if weight >= 1.0 {
        return pixel;
    }
    let Some(above) = above else {
        let [r, g, b] = if weight > 0.0 { [red / weight, green / weight, blue / weight] } else { background };
        return [r, g, b, 1.0];
    };
    let height = above.pixels.len() / above.width;
    let row = |y: usize| &above.pixels[y * above.width..][..above.width];
    let (near, far) = (row(y / 2), row(other(y, height)));
    let (left, right) = (x / 2, other(x, above.width));
    let under = 1.0 - weight;
    let colour = |i: usize, value: f32| {
        let along = |row: &[Pixel]| row[left][i] + 0.25 * (row[right][i] - row[left][i]);
        let (near, far) = (along(near), along(far));
        value + under * (near + 0.25 * (far - near))
    };
    [colour(0, red), colour(1, green), colour(2, blue), 1.0]
}

/// The second of the two pixels of the level above that enclose a pixel.
fn other(place: usize, above: usize) -> usize {
    let near = place / 2;
    if place.is_multiple_of(2) { near.saturating_sub(1) } else { (near + 1).min(above - 1) }
}

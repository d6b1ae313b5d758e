//! Edges of depth, and the side of an edge that a place belongs to.
//!
//! In a map from a network or a sensor an edge is a ramp, a few pixels off the edge in the picture. A Gaussian on the
//! ramp would float between two surfaces and tear when the view turns. So within [`REACH`] pixels of an edge the values
//! around a place are divided into two sides, nearer and farther than the middle of their range. They are
//! [weighted](super::sides) by the similarity of their colour to the place's own:
//!
//! ```text
//! w = 1/(1 + |c − c₀|²/C²)² · 1/(1 + r²/R²)        r: distance in pixels
//! ```
//!
//! The place belongs to the side of its own value unless the other one weighs [`DECISIVE`] times as much. Its depth is
//! its own value where that is no edge away from the weighted median of its side, otherwise that median. Its slope is
//! that of the line of least squares through it and up to [`ALONG`] pixels on both sides, as far as there is no edge.
//! Sums run over the window row by row, those of the median over ascending values, in binary32.

use rayon::prelude::*;
use streamsplat_kernels::Level;

use super::DepthMap;
use super::sides::{Picture, Weights};
use crate::world::{map_value, scene_depth};

/// Pixels around a place that are read, along rows and columns.
pub(super) const REACH: usize = 4;
/// Pixels along a row or a column, on both sides, that a slope is fitted to.
const ALONG: isize = 3;
/// The steepest slope.
const STEEPEST: f32 = 3.0;
/// Factor by which the other side must weigh more.
const DECISIVE: f32 = 3.0;
/// Part of a side's weight above which the values close to a place contain the median: half, and a margin for the
/// rounding of sums in any order.
const MOST: f32 = 0.501;
/// Difference of z at which two neighbours belong to different surfaces, times pixels of a row: seen from 10° to the
/// side they come apart by a pixel.
const TEAR: f32 = 11.5;

/// A key frame's depth and colours.
pub(super) struct Surfaces<'a> {
    map: &'a DepthMap,
    /// z in the scene of each pixel.
    z: Vec<f32>,
    /// The least and the greatest z within [`REACH`] of each pixel.
    around: Vec<[f32; 2]>,
    /// Difference of z at an edge.
    tear: f32,
    /// `[3, H, W]`
    frame: &'a [f32],
    picture: Picture,
    /// Around each pixel with an edge within reach.
    weights: Vec<Weights>,
}

/// Depth of one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    /// A value of the map.
    pub(super) inverse: f32,
    /// True if it is on the nearer side.
    pub(super) near: bool,
    /// Pixels from the pixel's middle to the nearest edge along rows and columns; infinite where there is none within
    /// reach.
    pub(super) clear: [f32; 2],
}

/// Difference of z between two neighbours of different surfaces, in rows of `width` pixels.
pub(in crate::stream) fn tear(width: usize) -> f32 {
    TEAR / width as f32
}

impl<'a> Surfaces<'a> {
    /// The surfaces of a frame `[3, H, W]` with this map.
    pub(super) fn new(level: Level, map: &'a DepthMap, frame: &'a [f32]) -> Self {
        let z: Vec<f32> = map.inverse.iter().map(|d| scene_depth(*d)).collect();
        let tear = tear(map.resolution[1]);
        let around = around(&z, map.resolution);
        let picture = Picture::new(level, frame, &z, map.resolution);
        let weights = picture.weights(&around, tear);
        Self { map, z, around, tear, frame, picture, weights }
    }

    fn edge(&self, a: f32, b: f32) -> bool {
        (a - b).abs() > self.tear
    }

    /// Height and width.
    pub(super) fn resolution(&self) -> [usize; 2] {
        self.map.resolution
    }

    /// z in the scene of each pixel.
    pub(super) fn z(&self) -> &[f32] {
        &self.z
    }

    /// Difference of z at an edge.
    pub(super) fn tear(&self) -> f32 {
        self.tear
    }

    /// The colour of a pixel.
    pub(super) fn colour(&self, pixel: usize) -> [f32; 3] {
        std::array::from_fn(|channel| self.frame[channel * self.z.len() + pixel])
    }

    /// Returns true if there is an edge within [`REACH`] of a pixel.
    pub(super) fn edge_around(&self, pixel: usize) -> bool {
        let [near, far] = self.around[pixel];
        self.edge(near, far)
    }

    /// Returns true if there is an edge within `pixels` along the row or the column.
    pub(super) fn edge_within(&self, row: usize, column: usize, pixels: f32) -> bool {
        let at = row * self.map.resolution[1] + column;
        let [near, far] = self.around[at];
        let [along_row, along_column] = match self.edge(near, far) {
            true => self.clear(row, column, self.z[at]),
            false => return false,
        };
        along_row.min(along_column) < pixels
    }

    /// Depth at the pixel in this row and column.
    pub(super) fn at(&self, row: usize, column: usize) -> Place {
        let own = row * self.map.resolution[1] + column;
        let [near, far] = self.around[own];
        if !self.edge(near, far) {
            return Place { inverse: self.map.inverse[own], near: false, clear: [f32::INFINITY; 2] };
        }
        let middle = 0.5 * (near + far);
        let weights = &self.weights[own];
        let own_side = usize::from(self.z[own] > middle);
        let other_weighs_more = weights.sides[1 - own_side] > DECISIVE * weights.sides[own_side];
        let side = if other_weighs_more { 1 - own_side } else { own_side };
        let total = weights.sides[side];
        let inverse = if side == own_side && weights.own > MOST * total {
            // The median, whatever its value, is no edge away.
            self.map.inverse[own]
        } else {
            let z = self.picture.on_side([row, column], side, middle).median(total);
            let keeps = side == own_side && !self.edge(z, self.z[own]);
            if keeps { self.map.inverse[own] } else { map_value(z) }
        };
        Place { inverse, near: side == 0, clear: self.clear(row, column, scene_depth(inverse)) }
    }

    /// Slope of a surface of this z at the pixel in this row and column: change of z per unit rightwards and per unit
    /// downwards; 0 where the pixel shows another surface.
    pub(super) fn slope(&self, row: usize, column: usize, z: f32) -> [f32; 2] {
        let [height, width] = self.map.resolution;
        let own = self.z[row * width + column];
        if self.edge(own, z) {
            return [0.0; 2];
        }
        let along = |side: usize, at: &dyn Fn(isize) -> Option<f32>| {
            let (mut product, mut square) = (0.0f32, 0.0f32);
            for step in [-1, 1] {
                let mut last = own;
                for n in (1..=ALONG).map(|n| step * n) {
                    let Some(z) = at(n).filter(|z| !self.edge(*z, last)) else { break };
                    product = (n as f32).mul_add(z - own, product);
                    square += (n * n) as f32;
                    last = z;
                }
            }
            let per_pixel = if square > 0.0 { product / square } else { 0.0 };
            (per_pixel * 0.5 * side as f32).clamp(-STEEPEST, STEEPEST)
        };
        let inside = |at: usize, n: isize, side: usize| at.checked_add_signed(n).filter(|at| *at < side);
        [
            along(width, &|n| inside(column, n, width).map(|x| self.z[row * width + x])),
            along(height, &|n| inside(row, n, height).map(|y| self.z[y * width + column])),
        ]
    }

    /// Pixels from a pixel's middle to the nearest pixel on another surface than z, less half a pixel, along rows and
    /// columns.
    fn clear(&self, row: usize, column: usize, z: f32) -> [f32; 2] {
        let [height, width] = self.map.resolution;
        let other = |y: usize, x: usize| self.edge(z, self.z[y * width + x]);
        let first = |reached: Option<usize>| reached.map_or(f32::INFINITY, |n| (n as f32 - 0.5).max(0.0));
        let along_row = (0..=REACH).find(|n| {
            (column + n < width && other(row, column + n)) || column.checked_sub(*n).is_some_and(|x| other(row, x))
        });
        let along_column = (0..=REACH).find(|n| {
            (row + n < height && other(row + n, column)) || row.checked_sub(*n).is_some_and(|y| other(y, column))
        });
        [first(along_row), first(along_column)]
    }
}

/// The least and the greatest z within [`REACH`] of each pixel, along rows and then along columns.
fn around(z: &[f32], [height, width]: [usize; 2]) -> Vec<[f32; 2]> {
    fn join(joined: &mut [[f32; 2]], others: impl IntoIterator<Item = [f32; 2]>) {
        for ([near, far], [a, b]) in joined.iter_mut().zip(others) {
            (*near, *far) = (near.min(a), far.max(b));
        }
    }
    let of_rows = |fill: &(dyn Fn(usize, &mut [[f32; 2]]) + Sync)| {
        let mut joined = vec![[f32::INFINITY, f32::NEG_INFINITY]; z.len()];
        joined.par_chunks_mut(width).enumerate().for_each(|(y, joined)| fill(y, joined));
        joined
    };
    let along_rows = of_rows(&|y, joined| {
        let row = &z[y * width..][..width];
        for shift in 0..(REACH + 1).min(width) {
            join(joined, row[shift..].iter().map(|z| [*z; 2]));
            join(&mut joined[shift..], row.iter().map(|z| [*z; 2]));
        }
    });
    of_rows(&|y, joined| {
        for other in y.saturating_sub(REACH)..(y + REACH + 1).min(height) {
            join(joined, along_rows[other * width..][..width].iter().copied());
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [21, 149];

    /// The value at a place, computed directly from the definition.
    fn plainly(surfaces: &Surfaces<'_>, row: usize, column: usize) -> (f32, bool) {
        let [height, width] = SIZE;
        let own = row * width + column;
        let window = || {
            let rows = row.saturating_sub(REACH)..(row + REACH + 1).min(height);
            let columns = column.saturating_sub(REACH)..(column + REACH + 1).min(width);
            rows.flat_map(move |y| columns.clone().map(move |x| (y, x)))
        };
        let range = window().map(|(y, x)| surfaces.z[y * width + x]);
        let [near, far] = range.fold([f32::INFINITY, 0.0], |[near, far], z| [z.min(near), z.max(far)]);
        if !surfaces.edge(near, far) {
            return (surfaces.map.inverse[own], false);
        }
        let middle = 0.5 * (near + far);
        let c0 = surfaces.colour(own);
        let (mut sides, mut weights) = ([Vec::new(), Vec::new()], [0.0f32; 2]);
        for (y, x) in window() {
            let at = y * width + x;
            let c = surfaces.colour(at);
            let apart = (0..3).fold(0.0f32, |sum, i| (c[i] - c0[i]).mul_add(c[i] - c0[i], sum));
            let alike = 1.0 / (1.0 + apart / (0.08 * 0.08));
            let [dx, dy] = [x.abs_diff(column) as f32, y.abs_diff(row) as f32];
            let w = alike * alike / (1.0 + (dx * dx + dy * dy) / 4.0);
            let side = usize::from(surfaces.z[at] > middle);
            weights[side] += w;
            sides[side].push((surfaces.z[at], w));
        }
        let own_side = usize::from(surfaces.z[own] > middle);
        let side = if weights[1 - own_side] > DECISIVE * weights[own_side] { 1 - own_side } else { own_side };
        sides[side].sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let mut sum = 0.0;
        let reached = |(_, w): &&(f32, f32)| {
            sum += w;
            sum >= 0.5 * weights[side]
        };
        let z = sides[side].iter().find(reached).or(sides[side].last()).expect("a side").0;
        let keeps = side == own_side && !surfaces.edge(z, surfaces.z[own]);
        (if keeps { surfaces.map.inverse[own] } else { map_value(z) }, side == 0)
    }

    #[test]
    fn every_level_gives_the_bits_of_the_definition() {
        let [height, width] = SIZE;
        let noise = |i: usize| ((i as u32 + 1).wrapping_mul(2_654_435_761) >> 8) as f32 / 16_777_216.0;
        // Things with a ramp around them, bumps, and colours whose edge is next to the ramp.
        let distance = |at: usize, x0: f32| ((at % width % 37) as f32 - x0).hypot((at / width) as f32 - 9.0);
        let inverse = |at: usize| (0.12 * (9.0 - distance(at, 15.0))).clamp(0.0, 0.6) + 0.35 * noise(at).powi(3);
        let map = DepthMap { inverse: (0..height * width).map(inverse).collect(), confidence: None, resolution: SIZE };
        let colour = |i: usize| {
            let thing = if distance(i % (height * width), 16.0) < 6.0 { 0.7 } else { 0.4 };
            thing + 0.2 * noise(i + 7000)
        };
        let frame: Vec<f32> = (0..3 * height * width).map(colour).collect();
        for level in Level::available() {
            let surfaces = Surfaces::new(level, &map, &frame);
            let mut kept = 0;
            for at in 0..height * width {
                let place = surfaces.at(at / width, at % width);
                assert_eq!((place.inverse, place.near), plainly(&surfaces, at / width, at % width), "{level}: {at}");
                kept += usize::from(place.inverse == map.inverse[at]);
            }
            let moved = height * width - kept;
            assert!((50..height * width / 2).contains(&moved), "{moved} take another value");
        }
    }

    #[test]
    fn slopes_are_those_of_the_surface_up_to_its_edge() {
        let [height, width] = SIZE;
        // A plane, and one in front of it from column 80 on that falls away steeply.
        let z = |at: usize| {
            let [x, y] = [(at % width) as f32 * 2.0 / width as f32, (at / width) as f32 * 2.0 / height as f32];
            if at % width < 80 { 0.2f32.mul_add(x, 0.5) - 0.1 * y } else { 2.5f32.mul_add(x - 1.07, 0.15) }
        };
        let inverse = (0..height * width).map(|at| map_value(z(at))).collect();
        let map = DepthMap { inverse, confidence: None, resolution: SIZE };
        let surfaces = Surfaces::new(Level::scalar(), &map, &[0.5; 3 * SIZE[0] * SIZE[1]]);
        let close = |[a, b]: [f32; 2], [c, d]: [f32; 2]| (a - c).abs() < 2e-3 && (b - d).abs() < 2e-3;
        for column in [0, 40, 78, 79, 80, 81, 90] {
            let expected = if column < 80 { [0.2, -0.1] } else { [2.5, 0.0] };
            for row in [0, 10, 20] {
                let z = surfaces.z()[row * width + column];
                let found = surfaces.slope(row, column, z);
                assert!(close(found, expected), "{row}, {column}: {found:?}");
                assert_eq!(surfaces.slope(row, column, z + 0.2), [0.0; 2], "another surface");
            }
        }
        // The steepest slope that differs from an edge, and a single row without neighbours.
        let steep = (0..4 * 64).map(|at| map_value(0.1 + 0.3 * TEAR / 64.0 * (at % 64).min(12) as f32)).collect();
        let steep = DepthMap { inverse: steep, confidence: None, resolution: [4, 64] };
        let surfaces = Surfaces::new(Level::scalar(), &steep, &[0.5; 3 * 4 * 64]);
        assert!(close(surfaces.slope(1, 5, surfaces.z()[64 + 5]), [0.3 * TEAR / 2.0, 0.0]));
        // Steeper than that counts as STEEPEST.
        let wall = (0..4 * 64).map(|at| map_value(0.1 + 0.8 * TEAR / 64.0 * (at % 64).min(4) as f32)).collect();
        let wall = DepthMap { inverse: wall, confidence: None, resolution: [4, 64] };
        let surfaces = Surfaces::new(Level::scalar(), &wall, &[0.5; 3 * 4 * 64]);
        assert_eq!(surfaces.slope(1, 2, surfaces.z()[64 + 2]), [STEEPEST, 0.0]);
        let one = DepthMap { inverse: vec![0.5], confidence: None, resolution: [1, 1] };
        assert_eq!(Surfaces::new(Level::scalar(), &one, &[0.5; 3]).slope(0, 0, scene_depth(0.5)), [0.0; 2]);
    }
}

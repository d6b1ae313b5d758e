//! Edges of depth, and which side of one a place belongs to.
//!
//! A map from a network or a sensor runs over its edges as a ramp, a few pixels beside the picture's own. A Gaussian on
//! the ramp would stand in the air between two surfaces and tear when the view turns. So within [`REACH`] pixels of an
//! edge the values around a place are divided in two, nearer and farther than the middle of their range, and weighed by
//! how like the place's own colour theirs is:
//!
//! ```text
//! w = 1/(1 + |c − c₀|²/C²)² · 1/(1 + r²/R²)        r: distance in pixels
//! ```
//!
//! The place belongs to the side of its own value unless the other one weighs [`DECISIVE`] times as much. Its depth is
//! its own value where that lies with its side, else the weighted median of the side. Sums run over the window row by
//! row, in binary32.

use rayon::prelude::*;

use super::{DepthMap, scene_depth};

/// Pixels around a place that are looked at, along rows and columns.
const REACH: usize = 4;
/// Pixels in reach, and the place itself.
const WINDOW: usize = (2 * REACH + 1) * (2 * REACH + 1);
/// C².
const COLOUR: f32 = 0.08 * 0.08;
/// R².
const NEARBY: f32 = 2.0 * 2.0;
/// How many times more the other side must weigh.
const DECISIVE: f32 = 3.0;
/// Difference of z at which two neighbours are of different surfaces, times pixels of a row: seen from 10° to the side
/// they come apart by a pixel.
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
    colours: Vec<[f32; 3]>,
}

/// Depth of one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    /// A value of the map.
    pub(super) inverse: f32,
    /// True if it is on the nearer side.
    pub(super) near: bool,
    /// Pixels from the pixel's middle to the nearest edge along rows and columns; infinite where there is none in
    /// reach.
    pub(super) clear: [f32; 2],
}

/// Difference of z between two neighbours of different surfaces, in a row of so many pixels.
pub(super) fn tear(width: usize) -> f32 {
    TEAR / width as f32
}

impl<'a> Surfaces<'a> {
    /// The surfaces of a frame `[3, H, W]` with this map.
    pub(super) fn new(map: &'a DepthMap, frame: &[f32]) -> Self {
        let z: Vec<f32> = map.inverse.iter().map(|d| scene_depth(*d)).collect();
        let area = z.len();
        let colours = (0..area).map(|at| std::array::from_fn(|channel| frame[channel * area + at])).collect();
        Self { map, around: around(&z, map.resolution), z, tear: tear(map.resolution[1]), colours }
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
        self.colours[pixel]
    }

    /// Returns true if an edge lies within [`REACH`] of a pixel.
    pub(super) fn edge_around(&self, pixel: usize) -> bool {
        let [near, far] = self.around[pixel];
        self.edge(near, far)
    }

    /// Returns true if an edge lies within so many pixels along the row or the column.
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
        let [height, width] = self.map.resolution;
        let rows = row.saturating_sub(REACH)..(row + REACH + 1).min(height);
        let columns = column.saturating_sub(REACH)..(column + REACH + 1).min(width);
        let own = row * width + column;
        let [near, far] = self.around[own];
        if !self.edge(near, far) {
            return Place { inverse: self.map.inverse[own], near: false, clear: [f32::INFINITY; 2] };
        }
        let middle = 0.5 * (near + far);
        let c0 = self.colour(own);
        let mut sides = [[(0.0f32, 0.0f32); WINDOW]; 2];
        let (mut counts, mut weights) = ([0; 2], [0.0f32; 2]);
        for y in rows {
            for x in columns.clone() {
                let at = y * width + x;
                let (dx, dy) = (x.abs_diff(column) as f32, y.abs_diff(row) as f32);
                let c = self.colour(at);
                let apart = (0..3).fold(0.0f32, |sum, i| (c[i] - c0[i]).mul_add(c[i] - c0[i], sum));
                let alike = 1.0 / (1.0 + apart / COLOUR);
                let w = alike * alike / (1.0 + dx.mul_add(dx, dy * dy) / NEARBY);
                let side = usize::from(self.z[at] > middle);
                weights[side] += w;
                sides[side][counts[side]] = (self.z[at], w);
                counts[side] += 1;
            }
        }
        let own_side = usize::from(self.z[own] > middle);
        let side = if weights[1 - own_side] > DECISIVE * weights[own_side] { 1 - own_side } else { own_side };
        let z = median(&mut sides[side][..counts[side]], weights[side]);
        let inverse =
            if side == own_side && !self.edge(z, self.z[own]) { self.map.inverse[own] } else { super::map_value(z) };
        Place { inverse, near: side == 0, clear: self.clear(row, column, scene_depth(inverse)) }
    }

    /// Pixels from a pixel's middle to the nearest one on another surface than z, less half a pixel, along rows and
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
    let join = |[a, b]: [f32; 2], [c, d]: [f32; 2]| [a.min(c), b.max(d)];
    let near = |at: usize, side: usize| at.saturating_sub(REACH)..(at + REACH + 1).min(side);
    let all = |values: &[[f32; 2]]| values.iter().copied().fold([f32::INFINITY, f32::NEG_INFINITY], join);
    let own: Vec<[f32; 2]> = z.iter().map(|z| [*z; 2]).collect();
    let rows = own.par_chunks(width);
    let along_rows: Vec<[f32; 2]> =
        rows.flat_map_iter(|row| (0..width).map(move |x| all(&row[near(x, width)]))).collect();
    let row = |y: usize| {
        let mut joined = vec![[f32::INFINITY, f32::NEG_INFINITY]; width];
        for other in near(y, height) {
            let other = &along_rows[other * width..][..width];
            joined.iter_mut().zip(other).for_each(|(joined, other)| *joined = join(*joined, *other));
        }
        joined
    };
    (0..height).into_par_iter().flat_map_iter(row).collect()
}

/// The value at which half of the weight is reached, ascending; equal values by their weights.
fn median(values: &mut [(f32, f32)], total: f32) -> f32 {
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let mut sum = 0.0;
    for (value, weight) in values.iter() {
        sum += weight;
        if sum >= 0.5 * total {
            return *value;
        }
    }
    values.last().map_or(0.0, |last| last.0)
}

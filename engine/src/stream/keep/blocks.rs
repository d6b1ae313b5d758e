//! Blocks of pictures, and how a frame differs from a mean in them.

use std::ops::Range;

use streamsplat_kernels::parallel::{for_each_chunk, map_indexed};

use super::{BLOCK, CELL};

/// Blocks of pictures of one size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::stream) struct Blocks {
    pub(super) size: [usize; 2],
    pub(super) grid: [usize; 2],
}

/// Statistics of the difference of a block.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Difference {
    /// Mean square.
    pub(super) square: f64,
    /// Mean square of the means over cells.
    pub(super) cells: f64,
    /// Mean, per channel.
    pub(super) mean: [f64; 3],
}

impl Difference {
    /// Mean square of the mean per channel: what remains of `square` for a block that is brighter or darker as a whole.
    pub(super) fn offset(&self) -> f64 {
        self.mean.iter().map(|mean| mean * mean).sum::<f64>() / 3.0
    }
}

impl Blocks {
    /// Blocks of pictures of `[height, width]`; `None` where these are not multiples of a cell's side.
    pub(in crate::stream) fn of(size: [usize; 2]) -> Option<Self> {
        let whole = size.iter().all(|side| *side > 0 && side.is_multiple_of(CELL));
        whole.then(|| Self { size, grid: size.map(|side| side.div_ceil(BLOCK)) })
    }

    pub(super) fn count(self) -> usize {
        self.grid[0] * self.grid[1]
    }

    /// Rows and columns of pixels of block `at`.
    pub(super) fn pixels(self, at: usize) -> [Range<usize>; 2] {
        let place = [at / self.grid[1], at % self.grid[1]];
        [0, 1].map(|axis| place[axis] * BLOCK..((place[axis] + 1) * BLOCK).min(self.size[axis]))
    }

    /// The means of a block's cells, row by row, channel by channel.
    pub(super) fn cell_means(self, at: usize, rgb: impl Fn(usize) -> f32, mut put: impl FnMut(usize, f32)) {
        let [rows, columns] = self.pixels(at);
        let [height, width] = self.size;
        for channel in 0..3 {
            for y in rows.clone().step_by(CELL) {
                for x in columns.clone().step_by(CELL) {
                    let mut sum = 0.0f32;
                    for row in y..y + CELL {
                        let start = (channel * height + row) * width + x;
                        (start..start + CELL).for_each(|i| sum += rgb(i));
                    }
                    let place = (channel * (height / CELL) + y / CELL) * (width / CELL) + x / CELL;
                    put(place, sum / (CELL * CELL) as f32);
                }
            }
        }
    }

    pub(super) fn difference(self, at: usize, frame: &[f32], mean: &[f32]) -> Difference {
        let [rows, columns] = self.pixels(at);
        let [height, width] = self.size;
        let mut out = Difference::default();
        let area = (rows.len() * columns.len()) as f64;
        for channel in 0..3 {
            for y in rows.clone().step_by(CELL) {
                // Down the columns first, so that they are lanes of a vector; then four columns to a cell.
                let (mut sums, mut squares) = ([0.0f32; BLOCK], [0.0f32; BLOCK]);
                for row in y..y + CELL {
                    let line = (channel * height + row) * width;
                    let [a, b] = [frame, mean].map(|of| &of[line + columns.start..line + columns.end]);
                    for (((a, b), sum), square) in a.iter().zip(b).zip(&mut sums).zip(&mut squares) {
                        let d = a - b;
                        *sum += d;
                        *square += d * d;
                    }
                }
                let whole = |[a, b, c, d]: [f32; CELL]| f64::from((a + b) + (c + d));
                for (sums, squares) in sums.as_chunks().0.iter().zip(squares.as_chunks().0) {
                    let sum = whole(*sums);
                    let cell = sum / (CELL * CELL) as f64;
                    out.square += whole(*squares);
                    out.cells += cell * cell;
                    out.mean[channel] += sum;
                }
            }
        }
        out.square /= 3.0 * area;
        out.cells *= (CELL * CELL) as f64 / (3.0 * area);
        out.mean = out.mean.map(|sum| sum / area);
        out
    }

    /// Standard deviation of the means of a block's cells.
    pub(super) fn deviation(self, at: usize, rgb: &[f32]) -> f64 {
        let (mut sums, mut squares, mut count) = ([0.0; 3], 0.0, 0u32);
        let plane = self.size[0] * self.size[1] / (CELL * CELL);
        self.cell_means(
            at,
            |i| rgb[i],
            |place, mean| {
                let mean = f64::from(mean);
                sums[place / plane] += mean;
                squares += mean * mean;
                count += 1;
            },
        );
        let each = f64::from(count) / 3.0;
        let of_means: f64 = sums.iter().map(|sum| sum * sum / each).sum();
        ((squares - of_means).max(0.0) / f64::from(count)).sqrt()
    }

    /// The block that holds a pixel.
    pub(in crate::stream) fn holding(self, [y, x]: [usize; 2]) -> usize {
        y / BLOCK * self.grid[1] + x / BLOCK
    }

    /// The indices of the blocks.
    pub(in crate::stream) fn indices(self) -> Range<usize> {
        0..self.count()
    }

    /// Returns for each block whether it is `wanted` and the root of the mean square difference of two pictures `[3, H,
    /// W]` is more than `most`.
    pub(in crate::stream) fn differing(
        self,
        one: &[f32],
        other: &[f32],
        most: f64,
        wanted: impl Fn(usize) -> bool + Sync,
    ) -> Vec<bool> {
        map_indexed(self.count(), |at| wanted(at) && self.difference(at, one, other).square > most * most)
    }

    /// Calls `work(channel, start, block, row)` for each row of pixels of each block; `start`: the index of the row's
    /// first pixel in the picture `[3, H, W]`.
    pub(super) fn for_each_row(self, rgb: &mut [f32], work: impl Fn(usize, usize, usize, &mut [f32]) + Sync + Send) {
        let [height, width] = self.size;
        for_each_chunk(rgb, width, |index, line| {
            let (channel, y) = (index / height, index % height);
            for (column, row) in line.chunks_mut(BLOCK).enumerate() {
                work(channel, index * width + column * BLOCK, y / BLOCK * self.grid[1] + column, row);
            }
        });
    }
}

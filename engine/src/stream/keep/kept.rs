//! The blocks that an interval keeps, and what they show.

use std::ops::Range;

use super::blocks::{Blocks, Difference};
use super::{BLOCK, Change, Keeps, Lattice, Past};
use crate::stream::lift::pixel;

/// Largest number of frames in a mean; older ones lose their weight.
const MOST_FRAMES: u32 = 16;
/// Rms change of means over cells above which colours are fitted again.
pub(super) const FOLLOWED: f64 = 0.4 / 255.0;
/// Pixels that a block's Gaussians extend beyond it.
const REACH: usize = 8;
/// Pixels around the changing blocks that flow reads.
const MARGIN_OF_FLOW: usize = 32;

/// The kept part of an interval.
#[derive(Debug)]
pub(in crate::stream) struct Kept {
    blocks: Blocks,
    pub(in crate::stream) changes: Vec<Change>,
    shows: Vec<Shows>,
    /// The picture at the interval's end, where kept blocks show their mean.
    last: Vec<f32>,
    /// The past at the interval's end.
    pub(in crate::stream) past: Past,
}

/// What a block shows over an interval.
#[derive(Clone, Copy, Debug)]
enum Shows {
    /// The frames as they are.
    Frames,
    /// The mean at the interval's end, which holds this many frames and those of the interval.
    Mean(u32),
    /// The mean at the interval's start, which moves linearly by this much.
    Moved([f64; 3]),
}

impl Shows {
    /// The value at time `t` of a block that drifts.
    fn moved(moved: [f64; 3], channel: usize, t: f32, mean: f32) -> f32 {
        (mean + (f64::from(t) * moved[channel]) as f32).clamp(0.0, 1.0)
    }
}

impl Kept {
    /// The part that is kept over an interval. `mean`, `past`: those of the key frame at its start; `frames`: times and
    /// pictures, the last of them the key frame at its end; `changes`: [`Change::None`] for blocks that rest,
    /// [`Change::Colours`] for those that drift.
    pub(super) fn new(
        blocks: Blocks,
        mean: &[f32],
        past: &Past,
        frames: &[(f32, &[f32])],
        mut changes: Vec<Change>,
        differences: &[Vec<Difference>],
    ) -> Self {
        let mut past = past.clone();
        let shows: Vec<Shows> = (changes.iter().enumerate())
            .map(|(at, change)| match change {
                Change::All => Shows::Frames,
                Change::Colours => Shows::Moved(differences[at].last().map_or([0.0; 3], |d| d.mean)),
                Change::None => Shows::Mean(past.count[at]),
            })
            .collect();
        let mut last = frames.last().map_or_else(Vec::new, |(_, rgb)| rgb.to_vec());
        blocks.for_each_row(&mut last, |channel, start, block, row| match shows[block] {
            Shows::Frames => {}
            Shows::Moved(moved) => {
                let mean = &mean[start..start + row.len()];
                row.iter_mut().zip(mean).for_each(|(to, mean)| *to = Shows::moved(moved, channel, 1.0, *mean));
            }
            Shows::Mean(first) => {
                row.copy_from_slice(&mean[start..start + row.len()]);
                for ((_, rgb), before) in frames.iter().zip(first..) {
                    let weight = 1.0 / (before + 1).min(MOST_FRAMES) as f32;
                    let frame = &rgb[start..start + row.len()];
                    row.iter_mut().zip(frame).for_each(|(value, frame)| *value += (frame - *value) * weight);
                }
            }
        });
        for (at, change) in changes.iter_mut().enumerate() {
            match shows[at] {
                Shows::Frames => {
                    (past.count[at], past.fitted[at]) = (1, 1);
                    blocks.cell_means(at, |i| last[i], |place, mean| past.anchor[place] = mean);
                    continue;
                }
                Shows::Moved(_) => {}
                Shows::Mean(first) => past.count[at] = (first + frames.len() as u32).min(MOST_FRAMES),
            }
            let (mut square, mut cells) = (0.0, 0u32);
            let anchor = &past.anchor;
            blocks.cell_means(
                at,
                |i| last[i],
                |place, mean| {
                    square += f64::from(mean - anchor[place]) * f64::from(mean - anchor[place]);
                    cells += 1;
                },
            );
            let moved = square > FOLLOWED * FOLLOWED * f64::from(cells);
            if *change == Change::Colours || moved || past.count[at] >= 2 * past.fitted[at] {
                *change = Change::Colours;
                past.fitted[at] = past.count[at];
                blocks.cell_means(at, |i| last[i], |place, mean| past.anchor[place] = mean);
            }
        }
        Self { blocks, changes, shows, last, past }
    }

    /// Replaces the kept blocks of a frame at `t` by their mean. `mean`: that of the key frame at the interval's start.
    pub(in crate::stream) fn show(&self, mean: &[f32], t: f32, rgb: &mut [f32]) {
        self.blocks.for_each_row(rgb, |channel, start, block, row| match self.shows[block] {
            Shows::Frames => {}
            Shows::Mean(_) => row.copy_from_slice(&self.last[start..start + row.len()]),
            Shows::Moved(moved) => {
                let mean = &mean[start..start + row.len()];
                row.iter_mut().zip(mean).for_each(|(to, mean)| *to = Shows::moved(moved, channel, t, *mean));
            }
        });
    }

    /// Numbers of kept blocks and of all.
    pub(in crate::stream) fn share(&self) -> [usize; 2] {
        let kept = self.changes.iter().filter(|change| **change != Change::All).count();
        [kept, self.changes.len()]
    }

    /// Returns true if more than three quarters of the blocks are kept: the camera is then static.
    pub(in crate::stream) fn mostly(&self) -> bool {
        let [kept, all] = self.share();
        4 * kept > 3 * all
    }

    /// What happens to each Gaussian: the model's own on their lattice, then details at these places.
    pub(in crate::stream) fn of_cells(
        &self,
        Lattice { side, columns, count }: &Lattice,
        details: &[[f32; 3]],
    ) -> Keeps {
        let [height, width] = self.blocks.size;
        let own = (0..*count).map(|cell| [cell / columns, cell % columns].map(|at| at * side));
        let details =
            details.iter().map(|&[x, _, z]| [pixel(-z, height), pixel(x, width)].map(Option::unwrap_or_default));
        Keeps::new(own.chain(details).map(|pixel| self.at(pixel)).collect(), *count)
    }

    /// What happens at a pixel (row and column).
    pub(in crate::stream) fn at(&self, pixel: [usize; 2]) -> Change {
        let [y, x] = pixel.map(|at| at / BLOCK);
        self.changes[y * self.blocks.grid[1] + x]
    }

    /// Returns true if `wanted` holds for a block that meets a rectangle of pixels (rows and columns) widened by
    /// [`REACH`].
    pub(in crate::stream) fn any_in(&self, pixels: [Range<usize>; 2], wanted: impl Fn(Change) -> bool) -> bool {
        let [rows, columns] = [0, 1].map(|axis| {
            let range = &pixels[axis];
            let end = (range.end + REACH).min(self.blocks.size[axis]);
            range.start.saturating_sub(REACH) / BLOCK..end.div_ceil(BLOCK)
        });
        rows.into_iter()
            .any(|row| columns.clone().any(|column| wanted(self.changes[row * self.blocks.grid[1] + column])))
    }

    /// The rectangle of pixels (rows and columns) around all blocks that change, with a margin for flow; `None` where
    /// none changes.
    pub(in crate::stream) fn changing(&self) -> Option<[Range<usize>; 2]> {
        let [_, columns] = self.blocks.grid;
        let changed = || (0..self.changes.len()).filter(|at| self.changes[*at] == Change::All);
        changed().next()?;
        let places = || changed().map(|at| [at / columns, at % columns]);
        Some([0, 1].map(|axis| {
            let along = || places().map(|place| place[axis]);
            let (first, last) = (along().min().unwrap_or(0), along().max().unwrap_or(0));
            let start = (first * BLOCK).saturating_sub(MARGIN_OF_FLOW);
            start..((last + 1) * BLOCK + MARGIN_OF_FLOW).min(self.blocks.size[axis])
        }))
    }
}

//! Static blocks of the picture keep their Gaussians.
//!
//! A picture is divided into blocks of [`BLOCK`]×[`BLOCK`] pixels. For each block the stream holds the mean of the
//! frames since its Gaussians were computed. Over an interval, let d be the difference of a frame from that mean, m the
//! number of frames in the mean, and μ the mean of d per channel. Then the block
//!
//! ```text
//! rests    where in every frame   rms(d) ≤ R and rms of d's means over 4×4 pixels ≤ S,
//!                                 or rms(d − μ) ≤ CLOSE, that of its means ≤ CLOSE_CELLS, and |μ| small
//! drifts   where in every frame   the same of d − μ, |μ| ≤ D, and |μ − t·μ(key frame)| ≤ S
//! changes  otherwise
//!
//! σ = the 40th percentile of rms(d)/√(1 + 1/m) over blocks and frames
//! R = MARGIN·σ·√(1 + 1/m) + ROUNDING     S = R/2
//! ```
//!
//! The second line counts where the noise is that of a codec: where it is not white, or less than the rounding of
//! 8-bit frames. A codec updates blocks at different times, so that the differences of quiet blocks are neither small
//! nor white. There a block that stays within [`CLOSE`] of its mean is kept, and |μ| and |μ − t·μ(key frame)| may be
//! [`CLOSE_MEAN`].
//!
//! σ estimates the camera's noise, at most [`MOST_NOISE`] where it is white and [`MOST_CHANGE`] where it is not. Means
//! over 4×4 pixels of white noise have a quarter of its deviation; motion and a codec's artefacts change them nearly as
//! much as the pixels. Noise counts as white where their ratio is less than [`WHITE`], over the blocks and frames up to
//! the percentile. A block that rests or drifts keeps its Gaussians: one record per Gaussian through the interval,
//! without motion and without fading. The frames of a block that rests enter its mean; the mean of a block that drifts
//! moves by μ.
//!
//! Blocks are kept only where they are a share of [`LEAST`] of those with a texture. The camera is static there, and
//! where a share of [`STATIC`] of the blocks with a texture has rms(d − μ) ≤ [`STEADY`] in every frame. A static
//! camera's frames are alike: of many in between every second one is used for motion and colours.
//!
//! Colours of kept Gaussians follow the mean. They are fitted to it again when the block drifts, when the mean holds
//! twice as many frames as at the last fit, and when its means over 4×4 pixels have moved by more than [`FOLLOWED`]
//! since. Over that interval they change linearly, so that crossing a key frame changes no bit.
//!
//! # Order of operations
//!
//! Sums are binary32 over 16 pixels, row-major, and binary64 above, block by block: a function of the pictures alone.

use std::sync::Arc;

use streamsplat_kernels::parallel::map_indexed;
use streamsplat_model::StaticGaussians;

use super::canonical::still;
use super::keyframe::KeyView;
use super::lift::{Added, pixel};

/// Side of a block, in pixels.
pub(super) const BLOCK: usize = 16;
/// Side of the cells of a block whose means are compared.
const CELL: usize = 4;
/// The share of blocks and frames whose changes are taken for noise.
const QUIET: f64 = 0.4;
/// Highest standard deviation taken for noise where it is white.
const MOST_NOISE: f64 = 8.0 / 255.0;
/// Highest standard deviation taken for noise where it is not.
const MOST_CHANGE: f64 = 0.5 / 255.0;
/// The ratio of the deviation of means over cells to that of pixels, below which noise is white.
const WHITE: f64 = 0.35;
/// The greatest difference that counts as noise, in standard deviations of it.
const MARGIN: f64 = 1.35;
/// The greatest difference without its mean that is close enough where noise is that of a codec, 42.1 dB, and that of
/// its means over cells.
const CLOSE: f64 = 2.0 / 255.0;
const CLOSE_CELLS: f64 = 0.8 * CLOSE;
/// The greatest mean of such a difference, per channel.
const CLOSE_MEAN: f64 = 1.0 / 255.0;
/// Rounding of 8-bit frames.
const ROUNDING: f64 = 0.4 / 255.0;
/// Largest drift of a block in one interval.
const DRIFT: f64 = 16.0 / 255.0;
/// Largest number of frames in a mean; older ones lose their weight.
const MOST_FRAMES: u32 = 16;
/// Rms change of means over cells above which colours are fitted again.
const FOLLOWED: f64 = 0.4 / 255.0;
/// The greatest rms(d − μ) of a block that a static camera sees: codecs and steps of exposure change blocks by so much.
const STEADY: f64 = 6.0 / 255.0;
/// The least share of such blocks among those with a texture where the camera is static. Flat blocks look static even
/// when the camera moves. (Over the intervals of 14 clips the share is 0.46 to 1 where the camera is static, and 0 to
/// 0.15 where it moves.)
const STATIC: f64 = 0.3;
/// The least share of kept blocks among those with a texture; below it none is kept.
const LEAST: f64 = 0.2;

/// Standard deviation of means over cells above which a block has a texture.
const TEXTURE: f64 = 4.0 / 255.0;

/// What happens to a block over an interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Change {
    /// Its Gaussians are kept with their colours.
    None,
    /// Its Gaussians are kept; their colours change.
    Colours,
    /// Its Gaussians are computed.
    All,
}

/// Blocks of pictures of one size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Blocks {
    size: [usize; 2],
    grid: [usize; 2],
}

/// The past of each block of a key frame's picture, where that picture is the mean itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Past {
    /// Frames in the mean.
    pub count: Vec<u32>,
    /// Frames in the mean when colours were last fitted to it.
    pub fitted: Vec<u32>,
    /// The means over cells at that fit, `[3, H/4, W/4]`.
    pub anchor: Vec<f32>,
}

/// The model's Gaussians, one per square of pixels.
#[derive(Debug)]
pub(super) struct Lattice {
    side: usize,
    columns: usize,
    count: usize,
}

impl Lattice {
    /// The lattice of `count` Gaussians on a picture of `[height, width]`; `None` where its cells are not squares of
    /// whole pixels.
    pub(super) fn of(count: usize, [height, width]: [usize; 2]) -> Option<Self> {
        let side = (height * width).checked_div(count)?.isqrt();
        let whole = side > 0 && height.is_multiple_of(side) && width.is_multiple_of(side);
        (whole && (height / side) * (width / side) == count).then(|| Self { side, columns: width / side, count })
    }
}

/// What an interval keeps of the Gaussians of the key frame at its start. In the new key frame the model's own keep
/// their indices; kept [details](super::detail) follow them in their order, before new details.
#[derive(Debug, PartialEq)]
pub(crate) struct Keeps {
    /// What happens to each of them.
    pub(super) changes: Vec<Change>,
    /// Number of the model's own.
    cells: usize,
    /// For each of the details the number of kept ones before it, and the number of all kept ones.
    before: Vec<usize>,
}

impl Keeps {
    /// `changes`: what happens to each Gaussian, of which the first `cells` are the model's own.
    pub(super) fn new(changes: Vec<Change>, cells: usize) -> Self {
        let mut before = vec![0];
        for change in &changes[cells..] {
            before.push(before[before.len() - 1] + usize::from(*change != Change::All));
        }
        Self { changes, cells, before }
    }

    /// The index in the new frame of the Gaussian at this index of the frame before; `None` if it is not kept.
    pub(super) fn index(&self, before: usize) -> Option<usize> {
        let place = || before.checked_sub(self.cells).map_or(before, |detail| self.cells + self.before[detail]);
        (self.changes[before] != Change::All).then(place)
    }

    /// Returns true if the Gaussian at this index of the new frame is kept from the frame before.
    pub(super) fn holds(&self, now: usize) -> bool {
        match now.checked_sub(self.cells) {
            None => self.changes[now] != Change::All,
            Some(detail) => detail < self.details(),
        }
    }

    /// What happens to each of the model's own.
    pub(super) fn of_own(&self) -> &[Change] {
        &self.changes[..self.cells]
    }

    /// Number of kept details.
    pub(super) fn details(&self) -> usize {
        self.before[self.before.len() - 1]
    }

    /// What happened to each Gaussian of the new frame that is not a new detail.
    pub(super) fn of_new(&self) -> impl Iterator<Item = Change> {
        let details = self.changes[self.cells..].iter().filter(|change| **change != Change::All);
        self.changes[..self.cells].iter().chain(details).copied()
    }
}

/// The camera over an interval.
#[derive(Debug)]
pub(super) enum Camera {
    /// It moves, or too much of the picture does.
    Moving,
    /// It is static; what is kept, if that is enough.
    Static(Option<Kept>),
}

/// The kept part of an interval.
#[derive(Debug)]
pub(super) struct Kept {
    blocks: Blocks,
    pub(super) changes: Vec<Change>,
    /// The past at the interval's end.
    pub(super) past: Past,
}

/// Statistics of the difference of a block.
#[derive(Clone, Copy, Debug, Default)]
struct Difference {
    /// Mean square.
    square: f64,
    /// Mean square of the means over cells.
    cells: f64,
    /// Mean, per channel.
    mean: [f64; 3],
}

impl Blocks {
    /// Blocks of pictures of `[height, width]`; `None` where these are not multiples of a cell's side.
    pub(super) fn of(size: [usize; 2]) -> Option<Self> {
        let whole = size.iter().all(|side| *side > 0 && side.is_multiple_of(CELL));
        whole.then(|| Self { size, grid: size.map(|side| side.div_ceil(BLOCK)) })
    }

    fn count(self) -> usize {
        self.grid[0] * self.grid[1]
    }

    /// Rows and columns of pixels of block `at`.
    fn pixels(self, at: usize) -> [std::ops::Range<usize>; 2] {
        let place = [at / self.grid[1], at % self.grid[1]];
        [0, 1].map(|axis| place[axis] * BLOCK..((place[axis] + 1) * BLOCK).min(self.size[axis]))
    }

    /// The means of a block's cells, row by row, channel by channel.
    fn cell_means(self, at: usize, rgb: impl Fn(usize) -> f32, mut put: impl FnMut(usize, f32)) {
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

    fn difference(self, at: usize, frame: &[f32], mean: &[f32]) -> Difference {
        let [rows, columns] = self.pixels(at);
        let [height, width] = self.size;
        let mut out = Difference::default();
        let area = (rows.len() * columns.len()) as f64;
        for channel in 0..3 {
            for y in rows.clone().step_by(CELL) {
                for x in columns.clone().step_by(CELL) {
                    let (mut sum, mut square) = (0.0f32, 0.0f32);
                    for row in y..y + CELL {
                        let start = (channel * height + row) * width + x;
                        for (a, b) in frame[start..start + CELL].iter().zip(&mean[start..start + CELL]) {
                            let d = a - b;
                            sum += d;
                            square += d * d;
                        }
                    }
                    out.square += f64::from(square);
                    let cell = f64::from(sum) / (CELL * CELL) as f64;
                    out.cells += cell * cell;
                    out.mean[channel] += f64::from(sum);
                }
            }
        }
        out.square /= 3.0 * area;
        out.cells *= (CELL * CELL) as f64 / (3.0 * area);
        out.mean = out.mean.map(|sum| sum / area);
        out
    }

    /// Standard deviation of the means of a block's cells.
    fn deviation(self, at: usize, rgb: &[f32]) -> f64 {
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

    fn each(self, at: usize, mut of: impl FnMut(usize)) {
        let [rows, columns] = self.pixels(at);
        let [height, width] = self.size;
        for channel in 0..3 {
            for row in rows.clone() {
                let start = (channel * height + row) * width;
                (start + columns.start..start + columns.end).for_each(&mut of);
            }
        }
    }
}

impl Past {
    /// The past of a key frame whose Gaussians were all computed.
    pub(super) fn none(blocks: Blocks, rgb: &[f32]) -> Self {
        let mut anchor = vec![0.0; rgb.len() / (CELL * CELL)];
        for at in 0..blocks.count() {
            blocks.cell_means(at, |i| rgb[i], |place, mean| anchor[place] = mean);
        }
        Self { count: vec![1; blocks.count()], fitted: vec![1; blocks.count()], anchor }
    }

    /// Returns why this cannot be the past of a picture of this size.
    pub(super) fn contradiction(&self, size: [usize; 2]) -> Option<String> {
        let Some(blocks) = Blocks::of(size) else {
            return Some(format!("expected no past of blocks of a picture of {}x{}", size[1], size[0]));
        };
        let lengths = [self.count.len(), self.fitted.len(), self.anchor.len()];
        let expected = [blocks.count(), blocks.count(), 3 * size[0] * size[1] / (CELL * CELL)];
        if lengths != expected {
            return Some(format!("expected a past of {expected:?} numbers, found {lengths:?}"));
        }
        let counted = self.count.iter().zip(&self.fitted).all(|(count, fitted)| (1..=*count).contains(fitted));
        (!counted).then(|| "expected blocks of one frame or more".to_owned())
    }
}

impl Kept {
    /// Returns the part that the interval keeps, from a key frame with this mean and past to the last of `frames`;
    /// nothing where that is too little. `frames`: times in the interval and pictures, the last of them the key frame
    /// at its end. Kept blocks become the mean in each of them.
    pub(super) fn of(blocks: Blocks, mean: &[f32], past: Option<&Past>, frames: &mut [(f32, &mut Vec<f32>)]) -> Camera {
        let none;
        let past = match past {
            Some(past) => past,
            None => {
                none = Past::none(blocks, mean);
                &none
            }
        };
        let differences: Vec<Vec<Difference>> = {
            let pictures: Vec<&[f32]> = frames.iter().map(|(_, rgb)| &rgb[..]).collect();
            map_indexed(blocks.count(), |at| pictures.iter().map(|rgb| blocks.difference(at, rgb, mean)).collect())
        };
        let wider = |at: usize| 1.0 + 1.0 / f64::from(past.count[at]);
        let mut levels: Vec<[f64; 2]> = differences
            .iter()
            .enumerate()
            .flat_map(|(at, all)| all.iter().map(move |d| [d.square, d.cells].map(|square| square / wider(at))))
            .collect();
        let quiet = (levels.len() as f64 * QUIET) as usize;
        // Ties by the second value, so that the order is unique.
        let ascending = |a: &[f64; 2], b: &[f64; 2]| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1]));
        levels.sort_unstable_by(ascending);
        let [square, cells] =
            levels[..=quiet].iter().fold([0.0; 2], |sum, level| [sum[0] + level[0], sum[1] + level[1]]);
        let white = cells <= WHITE * WHITE * square;
        let most = if white { MOST_NOISE } else { MOST_CHANGE };
        let noise = levels[quiet][0].sqrt().min(most);
        let codec = !white || noise < ROUNDING;
        let offset = |d: &Difference| d.mean.iter().map(|mean| mean * mean).sum::<f64>() / 3.0;
        let changes: Vec<Change> = (0..blocks.count())
            .map(|at| {
                let rms = MARGIN * noise * wider(at).sqrt() + ROUNDING;
                let structure = 0.5 * rms;
                let (rms2, structure2) = (rms * rms, structure * structure);
                let all = &differences[at];
                let noise = |d: &Difference, offset: f64| d.square - offset <= rms2 && d.cells - offset <= structure2;
                let close = |d: &Difference| {
                    let [square, cells] = [d.square, d.cells].map(|square| square - offset(d));
                    codec && square <= CLOSE * CLOSE && cells <= CLOSE_CELLS * CLOSE_CELLS
                };
                let most = if codec { structure.max(CLOSE_MEAN) } else { structure };
                let level = |d: &Difference| d.mean.iter().all(|mean| mean.abs() <= most);
                let rests = |d: &Difference| noise(d, 0.0) || (close(d) && level(d));
                if all.iter().all(rests) {
                    return Change::None;
                }
                let last = all.last().map_or([0.0; 3], |d| d.mean);
                let drifts = |(d, (t, _)): (&Difference, &(f32, &mut Vec<f32>))| {
                    let along = (0..3).all(|c| (d.mean[c] - f64::from(*t) * last[c]).abs() <= most);
                    (noise(d, offset(d)) || close(d)) && along
                };
                let near = last.iter().all(|mean| mean.abs() <= DRIFT);
                if near && all.iter().zip(frames.iter()).all(drifts) { Change::Colours } else { Change::All }
            })
            .collect();
        // Flat blocks look the same wherever the camera is.
        let textured: Vec<bool> = map_indexed(blocks.count(), |at| blocks.deviation(at, mean) > TEXTURE);
        let flat = !textured.contains(&true);
        let counted: Vec<usize> = (0..blocks.count()).filter(|at| flat || textured[*at]).collect();
        let steady = |d: &Difference| d.square - offset(d) <= STEADY * STEADY;
        let share = |wanted: &dyn Fn(usize) -> bool| {
            counted.iter().filter(|at| wanted(**at)).count() as f64 / counted.len() as f64
        };
        let kept = share(&|at| changes[at] != Change::All);
        if kept == 0.0 || kept < LEAST {
            return match share(&|at| differences[at].iter().all(steady)) < STATIC {
                true => Camera::Moving,
                false => Camera::Static(None),
            };
        }
        Camera::Static(Some(Self::with(blocks, mean, past, frames, changes, &differences)))
    }

    fn with(
        blocks: Blocks,
        mean: &[f32],
        past: &Past,
        frames: &mut [(f32, &mut Vec<f32>)],
        mut changes: Vec<Change>,
        differences: &[Vec<Difference>],
    ) -> Self {
        let mut past = past.clone();
        for (at, change) in changes.iter_mut().enumerate() {
            if *change == Change::All {
                let Some((_, last)) = frames.last() else { continue };
                (past.count[at], past.fitted[at]) = (1, 1);
                blocks.cell_means(at, |i| last[i], |place, mean| past.anchor[place] = mean);
                continue;
            }
            if *change == Change::Colours {
                let moved = differences[at].last().map_or([0.0; 3], |d| d.mean);
                let plane = blocks.size[0] * blocks.size[1];
                for (t, rgb) in frames.iter_mut() {
                    let moved = moved.map(|moved| (f64::from(*t) * moved) as f32);
                    blocks.each(at, |i| rgb[i] = (mean[i] + moved[i / plane]).clamp(0.0, 1.0));
                }
            } else {
                let first = past.count[at];
                blocks.each(at, |i| {
                    let (mut value, mut count) = (mean[i], first);
                    for (_, rgb) in frames.iter() {
                        count = (count + 1).min(MOST_FRAMES);
                        value += (rgb[i] - value) * (1.0 / count as f32);
                    }
                    for (_, rgb) in frames.iter_mut() {
                        rgb[i] = value;
                    }
                });
                past.count[at] = (first + frames.len() as u32).min(MOST_FRAMES);
            }
            let Some((_, last)) = frames.last() else { continue };
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
        Self { blocks, changes, past }
    }

    /// Numbers of kept blocks and of all.
    pub(super) fn share(&self) -> [usize; 2] {
        let kept = self.changes.iter().filter(|change| **change != Change::All).count();
        [kept, self.changes.len()]
    }

    /// Returns true if more than three quarters of the blocks are kept: the camera is then static.
    pub(super) fn mostly(&self) -> bool {
        let [kept, all] = self.share();
        4 * kept > 3 * all
    }

    /// What happens to each Gaussian: the model's own on their lattice, then details at these places.
    pub(super) fn of_cells(&self, Lattice { side, columns, count }: &Lattice, details: &[[f32; 3]]) -> Keeps {
        let [height, width] = self.blocks.size;
        let own = (0..*count).map(|cell| [cell / columns, cell % columns].map(|at| at * side));
        let details =
            details.iter().map(|&[x, _, z]| [pixel(-z, height), pixel(x, width)].map(Option::unwrap_or_default));
        Keeps::new(own.chain(details).map(|pixel| self.at(pixel)).collect(), *count)
    }

    /// What happens at a pixel (row and column).
    pub(super) fn at(&self, pixel: [usize; 2]) -> Change {
        let [y, x] = pixel.map(|at| at / BLOCK);
        self.changes[y * self.blocks.grid[1] + x]
    }

    /// Returns true if `wanted` holds for a block that meets a rectangle of pixels (rows and columns) widened by
    /// [`REACH`].
    pub(super) fn any_in(&self, pixels: [std::ops::Range<usize>; 2], wanted: impl Fn(Change) -> bool) -> bool {
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
    pub(super) fn changing(&self) -> Option<[std::ops::Range<usize>; 2]> {
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

/// Pixels that a block's Gaussians extend beyond it.
const REACH: usize = 8;
/// Pixels around the changing blocks that flow reads.
const MARGIN_OF_FLOW: usize = 32;

/// State of a key frame that keeps parts of the one before, as far as it is not a function of its frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct KeptState {
    /// Its picture, with the mean in kept blocks: `[3, H, W]`.
    pub rgb: Vec<f32>,
    /// The past of its blocks.
    pub past: Past,
    /// Its Gaussians.
    pub gaussians: StaticGaussians,
    /// How many of them, at the end, are details (docs/choosing.md).
    pub details: usize,
}

impl KeptState {
    /// The state of a key frame; `None` where it has kept nothing.
    pub(super) fn of(view: &KeyView) -> Option<Self> {
        let past = view.past.clone()?;
        let details = view.added.details;
        Some(Self { rgb: view.rgb.clone(), past, gaussians: StaticGaussians::clone(&view.gaussians), details })
    }

    /// Restores the state of a frame; there must be no [contradiction](Self::contradiction).
    pub(super) fn restore(&self, view: &mut KeyView) {
        view.rgb.clone_from(&self.rgb);
        view.past = Some(self.past.clone());
        view.gaussians = Arc::new(self.gaussians.clone());
        let cells = self.gaussians.len() - self.details;
        view.added =
            Added { details: self.details, moving: self.gaussians.position[cells..].to_vec(), ..Added::default() };
    }

    /// Returns true if all numbers of a Gaussian can be drawn.
    pub(super) fn is_sound(&self, cell: usize) -> bool {
        still(&self.gaussians, cell, 0).is_sound()
    }

    /// Returns why this cannot be the state of a key frame of this size.
    pub(super) fn contradiction(&self, size: [usize; 2]) -> Option<String> {
        let Self { rgb, past, gaussians: g, details } = self;
        if rgb.len() != 3 * size[0] * size[1] || !rgb.iter().all(|x| (0.0..=1.0).contains(x)) {
            return Some(format!("expected a picture of {}x{} with values from 0 to 1", size[1], size[0]));
        }
        let cells = g.len().checked_sub(*details).and_then(|cells| Lattice::of(cells, size));
        if g.uneven().is_some() || cells.is_none() {
            return Some(format!("expected kept Gaussians on a lattice, found {} with {details} details", g.len()));
        }
        past.contradiction(size)
    }
}

/// Replaces the kept ones of the model's own Gaussians by those of `before`, and adds its kept details.
pub(super) fn with_kept(now: &mut StaticGaussians, before: &StaticGaussians, keeps: &Keeps) {
    for (cell, place) in (0..before.len()).filter_map(|cell| Some((cell, keeps.index(cell)?))) {
        match place < now.len() {
            true => now.set(place, before.get(cell)),
            false => now.push(before.get(cell)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [64, 80];

    /// A texture with noise of a standard deviation of about `noise`, the same for the same seed.
    fn picture(noise: f32, seed: u64) -> Vec<f32> {
        let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        let mut next = move || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 40) as f32 / (1 << 24) as f32 - 0.5
        };
        let texture = |i: usize| 0.5 + 0.2 * ((i % SIZE[1]) as f32 * 0.4).sin() * ((i / SIZE[1]) as f32 * 0.3).cos();
        (0..3 * SIZE[0] * SIZE[1]).map(|i| texture(i) + 12f32.sqrt() * noise * next()).collect()
    }

    fn blocks() -> Blocks {
        Blocks::of(SIZE).expect("whole cells")
    }

    fn camera(mean: &[f32], past: Option<&Past>, frames: &mut [Vec<f32>]) -> Camera {
        let count = frames.len() as f32;
        let mut frames: Vec<(f32, &mut Vec<f32>)> =
            frames.iter_mut().enumerate().map(|(i, frame)| ((i + 1) as f32 / count, frame)).collect();
        Kept::of(blocks(), mean, past, &mut frames)
    }

    fn keep(mean: &[f32], past: Option<&Past>, frames: &mut [Vec<f32>]) -> Option<Kept> {
        match camera(mean, past, frames) {
            Camera::Static(kept) => kept,
            Camera::Moving => None,
        }
    }

    fn error(a: &[f32], b: &[f32]) -> f64 {
        let sum: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a - b) * f64::from(a - b)).sum();
        (sum / a.len() as f64).sqrt()
    }

    #[test]
    fn noise_rests_and_its_mean_comes_nearer_to_the_scene() {
        let truth = picture(0.0, 0);
        for noise in [0.5, 1.5, 3.0, 6.0].map(|n| n / 255.0) {
            let mut mean = picture(noise, 1);
            let mut past = None;
            for interval in 0..6 {
                let mut frames: Vec<Vec<f32>> = (0..4).map(|i| picture(noise, 2 + 4 * interval + i)).collect();
                let kept = keep(&mean, past.as_ref(), &mut frames).expect("all of it");
                assert!(kept.share()[0] * 20 >= kept.share()[1] * 19, "noise {noise}: {:?}", kept.share());
                assert!(kept.mostly());
                (mean, past) = (frames.pop().expect("four"), Some(kept.past));
            }
            assert!(error(&mean, &truth) < 0.35 * f64::from(noise), "{} of {noise}", error(&mean, &truth));
        }
    }

    #[test]
    fn what_moves_changes_and_nothing_else() {
        let noise = 1.5 / 255.0;
        let mean = picture(noise, 1);
        let mut frames: Vec<Vec<f32>> = (0..3).map(|i| picture(noise, 2 + i)).collect();
        // 6×6 pixels, an eighth brighter, in the second block of the second row, in one frame between.
        for (y, x) in (20..26).flat_map(|y| (20..26).map(move |x| (y, x))) {
            frames[1][y * SIZE[1] + x] += 0.125;
        }
        let kept = keep(&mean, None, &mut frames).expect("the rest of it");
        let changed: Vec<usize> = (0..kept.changes.len()).filter(|at| kept.changes[*at] == Change::All).collect();
        assert_eq!(changed, [6]);
        // That block is as it came, the others show the mean in all frames.
        assert!(frames[1][20 * SIZE[1] + 20] != frames[2][20 * SIZE[1] + 20]);
        assert!(frames[1][0] == frames[2][0]);
        assert_eq!(kept.changing().expect("a rectangle"), [0..64, 0..64]);
        assert!(kept.any_in([30..36, 30..36], |change| change == Change::All));
        assert!(!kept.any_in([40..60, 40..60], |change| change == Change::All));
    }

    #[test]
    fn light_that_fades_is_followed_and_light_that_flickers_is_not() {
        let noise = 0.8 / 255.0;
        let mean = picture(noise, 1);
        let lit =
            |seed: u64, light: f32| -> Vec<f32> { picture(noise, seed).iter().map(|x| x + light / 255.0).collect() };
        let mut fading: Vec<Vec<f32>> = (1..=4).map(|i| lit(1 + i, i as f32)).collect();
        let kept = keep(&mean, None, &mut fading).expect("all of it");
        assert!(kept.changes.iter().all(|change| *change == Change::Colours));
        assert!(error(&fading[3], &lit(9, 4.0)) < 1.9 * f64::from(noise));
        let mut flickering: Vec<Vec<f32>> = [6.0, 0.0, 6.0, 1.0].iter().zip(2..).map(|(l, s)| lit(s, *l)).collect();
        assert!(keep(&mean, None, &mut flickering).is_none());
    }

    #[test]
    fn blocks_that_a_codec_updates_are_kept_while_they_are_close_to_their_mean() {
        let mean = picture(0.0, 0);
        // Every cell of 4×4 pixels is brighter or darker in each frame, as after coarse quantisation.
        let coded = |frame: usize, strength: f32| -> Vec<f32> {
            let sign = |i: usize| {
                let (x, y) = (i % SIZE[1] / CELL, i / SIZE[1] / CELL);
                if (x + y + (frame >> (x / 4 % 2))).is_multiple_of(2) { 1.0 } else { -1.0 }
            };
            mean.iter().enumerate().map(|(i, value)| value + sign(i) * strength / 255.0).collect()
        };
        let mut frames: Vec<Vec<f32>> = (0..4).map(|frame| coded(frame, 1.5)).collect();
        let came = frames.clone();
        let kept = keep(&mean, None, &mut frames).expect("all of it");
        assert_eq!(kept.share(), [20, 20]);
        for (shown, came) in frames.iter().zip(&came) {
            assert!(error(shown, came) < 2.0 / 255.0, "{}", 255.0 * error(shown, came));
        }
        let mut frames: Vec<Vec<f32>> = (0..4).map(|frame| coded(frame, 2.5)).collect();
        assert!(keep(&mean, None, &mut frames).is_none());
    }

    #[test]
    fn a_mean_stays_within_the_range_of_pictures_however_bright_it_becomes() {
        let bright = |seed: u64, light: f32| -> Vec<f32> {
            picture(0.4 / 255.0, seed).iter().map(|x| (x + 0.28 + light / 255.0).min(1.0)).collect()
        };
        let mut frames: Vec<Vec<f32>> = (1..=3).map(|i| bright(1 + i, 2.0 * i as f32)).collect();
        let kept = keep(&bright(1, 0.0), None, &mut frames).expect("nearly all of it");
        assert!(kept.changes.iter().filter(|change| **change == Change::Colours).count() > 10);
        let rgb = frames.pop().expect("three");
        assert!(rgb.iter().all(|x| (0.0..=1.0).contains(x)));
    }

    #[test]
    fn a_scene_without_noise_keeps_what_is_equal() {
        let mean = picture(0.0, 0);
        let mut frames = vec![mean.clone(); 3];
        for (y, x) in (4..8).flat_map(|y| (4..8).map(move |x| (y, x))) {
            frames[2][y * SIZE[1] + x] += 0.05;
        }
        let at = 4 * SIZE[1] + 4;
        let before = frames[2][at];
        let kept = keep(&mean, None, &mut frames).expect("nearly all of it");
        assert_eq!(kept.share(), [19, 20]);
        assert_eq!(frames[2][at].to_bits(), before.to_bits());
        assert!(frames[0].iter().zip(&mean).all(|(a, b)| a.to_bits() == b.to_bits()));
        assert!(kept.changes[1..].iter().all(|change| *change == Change::Colours || *change == Change::None));
    }

    #[test]
    fn kept_details_follow_the_models_own_in_their_order() {
        use Change::{All, Colours, None};
        let keeps = Keeps::new(vec![None, All, Colours, All, None, All, Colours], 3);
        let indices: Vec<Option<usize>> = (0..7).map(|at| keeps.index(at)).collect();
        assert_eq!(indices, [Some(0), Option::None, Some(2), Option::None, Some(3), Option::None, Some(4)]);
        // New details come after the two kept ones.
        let held: Vec<bool> = (0..7).map(|at| keeps.holds(at)).collect();
        assert_eq!(held, [true, false, true, true, true, false, false]);
        assert_eq!(keeps.of_new().collect::<Vec<_>>(), [None, All, Colours, None, Colours]);
        assert_eq!((keeps.details(), keeps.of_own()), (2, &[None, All, Colours][..]));
        let of = |opacities: &[f32]| {
            let one = |opacity: &f32| streamsplat_model::StaticGaussian { opacity: *opacity, ..Default::default() };
            opacities.iter().map(one).collect::<StaticGaussians>()
        };
        let mut now = of(&[0.1, 0.2, 0.3]);
        with_kept(&mut now, &of(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]), &keeps);
        assert_eq!(now.opacity, [1.0, 0.2, 3.0, 5.0, 7.0]);
    }

    #[test]
    fn a_moving_picture_keeps_nothing() {
        let mean = picture(0.0, 0);
        let mut moved = mean.clone();
        moved.rotate_left(3);
        assert!(matches!(camera(&mean, None, &mut [moved]), Camera::Moving));
    }

    #[test]
    fn a_static_camera_is_static_while_a_codec_or_light_changes_the_picture() {
        let mean = picture(0.0, 0);
        // Each cell is brighter or darker by 5/255, and all of them by the step of exposure.
        let coded = |step: f32| -> Vec<f32> {
            let sign = |i: usize| if (i % SIZE[1] / CELL + i / SIZE[1] / CELL).is_multiple_of(2) { 1.0 } else { -1.0 };
            mean.iter().enumerate().map(|(i, value)| value + (5.0 * sign(i) + step) / 255.0).collect()
        };
        let mut frames: Vec<Vec<f32>> = [12.0, -9.0, 6.0].into_iter().map(coded).collect();
        assert!(matches!(camera(&mean, None, &mut frames), Camera::Static(None)));
        // A quarter of the blocks is not enough.
        let steady = coded(0.0);
        let moved = (0..3 * SIZE[0] * SIZE[1]).map(|i| {
            let row = i / SIZE[1] % SIZE[0];
            if row < SIZE[0] / 4 { steady[i] } else { mean[(i + 3) % mean.len()] }
        });
        let moved = moved.collect();
        assert!(matches!(camera(&mean, None, &mut [moved]), Camera::Moving));
    }

    #[test]
    fn a_past_that_does_not_fit_is_found() {
        let past = Past::none(blocks(), &picture(0.0, 0));
        assert_eq!(past.contradiction(SIZE), None);
        assert!(past.contradiction([64, 96]).is_some());
        let zero = Past { count: vec![0; past.count.len()], ..past.clone() };
        assert!(zero.contradiction(SIZE).is_some());
        assert!(Blocks::of([10, 16]).is_none() && Blocks::of([0, 16]).is_none());
    }
}

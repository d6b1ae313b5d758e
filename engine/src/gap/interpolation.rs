//! How well the frames between two key frames can be predicted from these, in low-resolution luma.
//!
//! A frame is averaged to [`COLUMNS`] × [`ROWS`] cells of luma. For each block of [`BLOCK`] × [`BLOCK`] cells a
//! displacement `v` is searched, at most [`REACH`] cells along each axis. It is the one for which the first frame at `p
//! − v` is nearest to the last at `p + v`, as for an object that passes the block half-way. Shorter displacements win
//! unless a longer one is better by a tenth. A block of frame i of n is predicted twice, with `t = i/n`: as the
//! cross-fade `A(p)·(1−t) + B(p)·t`, and as that along the displacement, `A(p − 2v·t)·(1−t) + B(p + 2v·(1−t))·t`. The
//! smaller sum of squared errors counts. Places outside have the values at the border.
//!
//! All computations after the averages are in integers; the averages are plain sums in binary32, in the order of the
//! pixels.

use crate::picture::Picture;

/// Cells of a row.
pub const COLUMNS: usize = 64;
/// Rows of cells.
pub const ROWS: usize = 36;
/// Cells.
pub const CELLS: usize = COLUMNS * ROWS;
/// Cells along a block's side.
pub const BLOCK: usize = 4;
/// Largest displacement of half an interval along an axis, in cells.
pub const REACH: i32 = 4;
/// The luma value of white.
pub const PEAK: u64 = 1023;

/// The low-resolution luma of a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Small(Vec<i32>);

impl Small {
    /// The luma of `picture`. In small pictures a cell holds at least the pixel at its corner.
    pub fn of(picture: &Picture) -> Small {
        let Picture { width, height, rgb } = picture;
        let plane = width * height;
        let cell = |i: usize, cells: usize, side: usize| {
            let start = (i * side / cells).min(side.saturating_sub(1));
            start..((i + 1) * side / cells).max(start + 1).min(side)
        };
        let mut luma = Vec::with_capacity(CELLS);
        for row in 0..ROWS {
            for column in 0..COLUMNS {
                let (rows, columns) = (cell(row, ROWS, *height), cell(column, COLUMNS, *width));
                let count = rows.len() * columns.len();
                let mut sums = [0.0_f32; 3];
                for (plane, sum) in rgb.chunks_exact(plane.max(1)).zip(&mut sums) {
                    for y in rows.clone() {
                        plane[y * width..][columns.clone()].iter().for_each(|x| *sum += x);
                    }
                }
                let [r, g, b] = sums.map(|sum| sum / count.max(1) as f32);
                let value = 0.299 * r + 0.587 * g + 0.114 * b;
                // `as` saturates and sends NaN to 0.
                luma.push((value.clamp(0.0, 1.0) * PEAK as f32 + 0.5) as i32);
            }
        }
        Small(luma)
    }

    fn at(&self, row: i32, column: i32) -> i32 {
        let row = row.clamp(0, ROWS as i32 - 1) as usize;
        self.0[row * COLUMNS + column.clamp(0, COLUMNS as i32 - 1) as usize]
    }
}

/// Sum of squared errors of `frame` predicted from the frame before, each block displaced there by at most [`REACH`].
pub fn step(before: &Small, frame: &Small) -> u64 {
    let blocks =
        (0..ROWS as i32).step_by(BLOCK).flat_map(|row| (0..COLUMNS as i32).step_by(BLOCK).map(move |c| (row, c)));
    let miss = |at: (i32, i32)| {
        let error = |[dy, dx]: [i32; 2], (y, x): (i32, i32)| before.at(y - dy, x - dx) - frame.at(y, x);
        let v = nearest(|v| block(at).map(|cell| error(v, cell).abs()).sum());
        block(at).map(|cell| i64::from(error(v, cell)).pow(2) as u64).sum::<u64>()
    };
    blocks.map(miss).sum()
}

/// Sums of squared errors of the predictions of the frames between the first and the last of `frames`.
pub fn misses(frames: &[Small]) -> Vec<u64> {
    let [first, between @ .., last] = frames else { return Vec::new() };
    let n = between.len() as i32 + 1;
    let mut errors = vec![0; between.len()];
    for row in (0..ROWS as i32).step_by(BLOCK) {
        for column in (0..COLUMNS as i32).step_by(BLOCK) {
            let v = displacement(first, last, row, column);
            for (i, (frame, error)) in between.iter().zip(&mut errors).enumerate() {
                let still = miss(first, last, frame, (row, column), [0, 0], i as i32 + 1, n);
                let moving =
                    if v == [0, 0] { still } else { miss(first, last, frame, (row, column), v, i as i32 + 1, n) };
                *error += still.min(moving);
            }
        }
    }
    errors
}

/// The cells of the block at `(row, column)`.
fn block((row, column): (i32, i32)) -> impl Iterator<Item = (i32, i32)> {
    let side = BLOCK as i32;
    (row..row + side).flat_map(move |y| (column..column + side).map(move |x| (y, x)))
}

/// The displacement of half an interval at a block.
fn displacement(first: &Small, last: &Small, row: i32, column: i32) -> [i32; 2] {
    nearest(|[dy, dx]| {
        block((row, column)).map(|(y, x)| (first.at(y - dy, x - dx) - last.at(y + dy, x + dx)).abs()).sum()
    })
}

/// The displacement within [`REACH`] of the least distance; shorter ones win unless a longer one is better by a tenth.
fn nearest(distance: impl Fn([i32; 2]) -> i32) -> [i32; 2] {
    let mut best = ([0, 0], distance([0, 0]));
    // Rings of growing size around the middle.
    for ring in 1..=REACH {
        for dy in -ring..=ring {
            let step = if dy.abs() == ring { 1 } else { 2 * ring };
            for dx in (-ring..=ring).step_by(step as usize) {
                let distance = distance([dy, dx]);
                if 10 * distance < 9 * best.1 {
                    best = ([dy, dx], distance);
                }
            }
        }
    }
    best.0
}

/// Sum of squared errors of the prediction of a block of frame `i` of `n`.
fn miss(first: &Small, last: &Small, frame: &Small, at: (i32, i32), v: [i32; 2], i: i32, n: i32) -> u64 {
    // 2v·t, rounded half up.
    let [dy, dx] = v.map(|v| (4 * v * i + n).div_euclid(2 * n));
    let [ry, rx] = [2 * v[0] - dy, 2 * v[1] - dx];
    let square = |(y, x): (i32, i32)| {
        let mixed = first.at(y - dy, x - dx) * (n - i) + last.at(y + ry, x + rx) * i;
        let error = i64::from((mixed + n / 2) / n - frame.at(y, x));
        (error * error) as u64
    };
    block(at).map(square).sum()
}

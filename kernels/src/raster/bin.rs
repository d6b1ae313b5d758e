//! The tiles that a footprint can touch, and each tile's list.

use super::project::{BLOCK, Splat};

/// Blocks across and down a tile.
pub(super) const TILE: [usize; 2] = [16, 8];

/// A footprint that spans more tiles than this is tested against them row by row.
const TEST_ABOVE: usize = 4;

/// The tiles of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Grid {
    pub columns: usize,
    pub rows: usize,
    /// Blocks in a row of the image.
    pub blocks: usize,
    /// True if the last column's neighbour is the first.
    pub around: bool,
}

impl Grid {
    pub(super) fn new(width: usize, height: usize) -> Self {
        Self {
            columns: width.div_ceil(BLOCK * TILE[0]),
            rows: height.div_ceil(BLOCK * TILE[1]),
            blocks: width.div_ceil(BLOCK),
            around: false,
        }
    }

    pub(super) fn len(self) -> usize {
        self.columns * self.rows
    }

    /// Calls `visit` with every tile that `splat` may touch, in ascending order.
    #[inline(always)]
    pub(super) fn for_each_tile(self, splat: &Splat, mut visit: impl FnMut(usize)) {
        if splat.is_hidden() {
            return;
        }
        let [top, bottom] = splat.rows.map(|r| usize::from(r) / TILE[1]);
        if self.around {
            return self.for_each_around(splat, [top, bottom], visit);
        }
        let [left, right] = splat.columns.map(|c| usize::from(c) / TILE[0]);
        if (right - left + 1) * (bottom - top + 1) <= TEST_ABOVE {
            for row in top..=bottom {
                for column in left..=right {
                    visit(row * self.columns + column);
                }
            }
            return;
        }
        let reach = Reach::new(splat);
        for row in top..=bottom {
            let height = (BLOCK * TILE[1]) as f32;
            let (from, to) = reach.columns(row as f32 * height, height - 1.0);
            let width = (BLOCK * TILE[0]) as f32;
            // The comparison keeps the box of the footprint where the bounds are NaN.
            let first = if from / width > left as f32 { (from / width) as usize } else { left };
            let last = if to / width < right as f32 { (to.max(-1.0) / width).floor() as isize } else { right as isize };
            for column in first as isize..=last {
                visit(row * self.columns + column as usize);
            }
        }
    }

    /// [`Grid::for_each_tile`] where columns continue at the other edge.
    fn for_each_around(self, splat: &Splat, [top, bottom]: [usize; 2], mut visit: impl FnMut(usize)) {
        let [own, beyond] = around(splat.columns, self.blocks).map(|ends| ends.map(|column| column / TILE[0]));
        // A tile in which both parts meet is visited once.
        let beyond = if splat.columns[1] as usize >= self.blocks { 0..(beyond[1] + 1).min(own[0]) } else { 0..0 };
        for row in top..=bottom {
            for column in beyond.clone().chain(own[0]..own[1] + 1) {
                visit(row * self.columns + column);
            }
        }
    }
}

/// Columns of a footprint in an image of `blocks` columns of blocks whose left and right edges meet: those up to the
/// right edge, and those from the left edge on. There may be none of the latter (first past last).
#[inline(always)]
pub(super) fn around([first, last]: [u16; 2], blocks: usize) -> [[usize; 2]; 2] {
    let (first, last) = (usize::from(first), usize::from(last));
    if last < blocks { [[first, last], [1, 0]] } else { [[first, blocks - 1], [0, last - blocks]] }
}

/// Coefficients of a footprint's horizontal extent over a strip of rows.
#[derive(Clone, Copy)]
pub(super) struct Reach {
    /// The centre.
    pub x: f32,
    pub y: f32,
    pub p: f32,
    pub q: f32,
    pub k: f32,
    /// The exponent at the rim.
    pub exponent: f32,
    /// Half the height.
    pub height: f32,
    /// Row, from the centre, of the rim's rightmost point; the leftmost is opposite.
    pub rightmost: f32,
    /// Pixels added on both sides against rounding.
    pub slack: f32,
}

impl Reach {
    #[inline(always)]
    pub(super) fn new(splat: &Splat) -> Self {
        let (x, y, k) = (splat.x[0] + splat.x[1], splat.y[0] + splat.y[1], splat.k as f32);
        let root = splat.reach.sqrt();
        let height = root / splat.q;
        let slope = k * splat.p;
        let norm = (splat.q * splat.q + slope * slope).sqrt();
        let width = root * norm / (splat.p * splat.q);
        Self {
            x,
            y,
            p: splat.p,
            q: splat.q,
            k,
            exponent: splat.reach,
            height,
            rightmost: height * (slope / norm),
            slack: 0.05 + 2e-6 * (x.abs() + width),
        }
    }

    /// First and last x of the rim over the rows `from ..= from + extent`, with some slack.
    #[inline(always)]
    fn columns(&self, from: f32, extent: f32) -> (f32, f32) {
        let low = (from - self.y).max(-self.height).min(self.height);
        let high = (from + extent - self.y).max(-self.height).min(self.height);
        let at_right = self.rightmost.max(low).min(high);
        let at_left = (-self.rightmost).max(low).min(high);
        let half = |dy: f32| (self.exponent - (self.q * dy) * (self.q * dy)).max(0.0).sqrt() / self.p;
        let right = self.k * at_right + half(at_right);
        let left = self.k * at_left - half(at_left);
        (self.x + left - self.slack, self.x + right + self.slack)
    }
}

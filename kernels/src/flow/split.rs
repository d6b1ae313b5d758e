//! Planes in which even and odd columns are separate, so that one colour of a chessboard is whole vectors.

use crate::memory::Scratch;
use crate::simd::LANES;

/// `KINDS` values per pixel. A row holds those of the even columns, then those of the odd ones. The picture is
/// surrounded by zeros: a row above and below, [`LANES`] values and the rest of a vector left and right.
pub(super) struct Split<const KINDS: usize> {
    pub places: Places<KINDS>,
    pub data: Scratch,
}

/// Index arithmetic of a [`Split`].
#[derive(Clone, Copy)]
pub(super) struct Places<const KINDS: usize> {
    /// Values of a row of one kind and parity.
    row: usize,
}

impl<const KINDS: usize> Places<KINDS> {
    /// Values of all kinds and both parities of a row.
    #[inline(always)]
    pub fn block(self) -> usize {
        2 * KINDS * self.row
    }

    /// From one kind to the next.
    #[inline(always)]
    pub fn step(self) -> usize {
        self.row
    }

    /// Index of the first value of row `y` (from −1 on), columns of one parity, one kind.
    #[inline(always)]
    pub fn start(self, y: isize, parity: usize, kind: usize) -> usize {
        (y + 1) as usize * self.block() + self.within(parity, kind)
    }

    /// [`Places::start`] inside a row's block.
    #[inline(always)]
    pub fn within(self, parity: usize, kind: usize) -> usize {
        (parity * KINDS + kind) * self.row + LANES
    }

    /// Spreads a picture's row over the two parities of `block`, zeros behind it.
    #[inline(always)]
    pub fn put(self, block: &mut [f32], kind: usize, from: &[f32]) {
        let n = from.len();
        let (even, odd) = block.split_at_mut(self.within(1, 0) - LANES);
        let (start, whole) = (self.within(0, kind), self.row - 2 * LANES);
        let (even, odd) = (&mut even[start..][..whole], &mut odd[start..][..whole]);
        even[n.div_ceil(2)..].fill(0.0);
        odd[n / 2..].fill(0.0);
        for (out, x) in even.iter_mut().zip(from.iter().step_by(2)) {
            *out = *x;
        }
        for (out, x) in odd.iter_mut().zip(from.iter().skip(1).step_by(2)) {
            *out = *x;
        }
    }
}

impl<const KINDS: usize> Split<KINDS> {
    /// Zeros outside the picture, unspecified values inside.
    pub fn new(h: usize, columns: &Columns) -> Self {
        let places = Places { row: columns.row };
        let mut data = Scratch::take((h + 2) * places.block());
        let rows = data.len() / places.block();
        for (y, block) in data.chunks_mut(places.block()).enumerate() {
            if y == 0 || y + 1 == rows {
                block.fill(0.0);
            } else {
                for row in block.chunks_mut(columns.row) {
                    row[..LANES].fill(0.0);
                    row[LANES + columns.whole..].fill(0.0);
                }
            }
        }
        Self { places, data }
    }

    /// The rows inside the picture.
    pub fn inside(&mut self) -> &mut [f32] {
        let block = self.places.block();
        let end = self.data.len() - block;
        &mut self.data[block..end]
    }

    /// Collects a picture's row.
    pub fn take(&self, y: usize, kind: usize, out: &mut [f32]) {
        for parity in 0..2.min(out.len()) {
            let from = &self.data[self.places.start(y as isize, parity, kind)..];
            for (out, x) in out[parity..].iter_mut().step_by(2).zip(from) {
                *out = *x;
            }
        }
    }
}

/// The columns of a [`Split`].
pub(super) struct Columns {
    row: usize,
    /// Values of a row of one parity in whole vectors.
    pub whole: usize,
    /// 1 where there is a column of the parity, else 0.
    pub exists: [Vec<f32>; 2],
    /// 1 where there is a column to the right of it, else 0.
    pub right: [Vec<f32>; 2],
}

impl Columns {
    pub fn new(w: usize) -> Self {
        let whole = w.div_ceil(2).next_multiple_of(LANES);
        let below = |n: usize| {
            [0, 1].map(|parity| (0..whole).map(|i| if 2 * i + parity < n { 1.0 } else { 0.0 }).collect::<Vec<f32>>())
        };
        Self { row: whole + 2 * LANES, whole, exists: below(w), right: below(w - 1) }
    }
}

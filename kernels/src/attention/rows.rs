//! The matrices of attention, its shape, and the sizes of its blocks.

use crate::size::{checked_product, product};

/// Keys of a block: whole register blocks on every level.
pub const KEY_BLOCK: usize = 192;

/// Queries of a task. A block of keys stays in the second-level cache while they pass over it.
pub(super) const QUERY_BLOCK: usize = 64;

/// Converted keys take a multiple of this: whole register blocks on every level.
pub(super) const WHOLE: usize = 12;

/// Scales of queries and keys are at most this, so that no logit is infinite.
pub(super) const LARGEST_SCALE: f32 = (1_u64 << 48) as f32;

/// A matrix `[rows, heads·width]`: part of a wider one, or a matrix for each head.
#[derive(Clone, Copy)]
pub struct Rows<'a> {
    pub(super) values: &'a [f32],
    pub(super) rows: usize,
    /// From a row to the next.
    pub(super) stride: usize,
    /// Distance from a head to the next; `None`: heads are contiguous.
    head: Option<usize>,
    pub(super) first: usize,
}

impl<'a> Rows<'a> {
    /// Columns `first..` of `values [rows, stride]`.
    ///
    /// # Panics
    /// When `values` does not hold `rows · stride` values.
    pub fn new(values: &'a [f32], rows: usize, stride: usize, first: usize) -> Self {
        assert_eq!(
            values.len(),
            product([rows, stride]),
            "{} values, expected rows·stride = {rows}·{stride}",
            values.len()
        );
        Self { values, rows, stride, head: None, first }
    }

    /// The heads from `first` on of `values [heads][rows][width]`: as
    /// [`Epilogue::in_groups_of`](crate::gemm::Epilogue::in_groups_of) writes them.
    ///
    /// # Panics
    /// When `values` holds no whole number of heads.
    pub fn of_heads(values: &'a [f32], rows: usize, width: usize, first: usize) -> Self {
        let head = product([rows, width]);
        assert!(
            values.is_empty() || values.len().is_multiple_of(head),
            "{} values in heads of {rows}·{width}",
            values.len()
        );
        Self { values, rows, stride: width, head: Some(head), first: product([first, head]) }
    }

    /// Rows of the matrix.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Where the channels of a head begin in a row.
    #[inline(always)]
    fn place(&self, row: usize, head: usize, width: usize) -> usize {
        self.first + row * self.stride + head * self.head.unwrap_or(width)
    }

    #[inline(always)]
    pub(super) fn head(&self, row: usize, head: usize, width: usize) -> &'a [f32] {
        &self.values[self.place(row, head, width)..][..width]
    }

    /// A head's channels of `count` rows from `row` on, each `stride` after the one before; `None` where `values` ends
    /// before. The content of rows past the last is unspecified.
    #[inline(always)]
    pub(super) fn lines(&self, row: usize, count: usize, head: usize, width: usize) -> Option<&'a [f32]> {
        self.values.get(self.place(row, head, width)..)?.get(..(count - 1) * self.stride + width)
    }

    /// Returns true if all heads are inside.
    pub(super) fn holds(&self, heads: usize, width: usize) -> bool {
        let (width_of_one, all) = match self.head {
            None => (width, self.stride),
            Some(head) if self.stride == width => (head, self.values.len()),
            Some(_) => return self.rows == 0,
        };
        let end = checked_product([heads, width_of_one]).and_then(|heads| heads.checked_add(self.first));
        self.rows == 0 || end.is_some_and(|end| end <= all)
    }
}

/// Which keys a query sees.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Windows {
    /// All of them.
    Full,
    /// The keys of its own run. The sequence, rolled forward by `roll` (the last `roll` tokens wrap to the front), is
    /// cut into consecutive runs of `length`; the last may be shorter. Needs as many queries as keys.
    Runs {
        /// Tokens of a run.
        length: usize,
        /// Tokens by which the sequence is rolled forward before it is cut.
        roll: usize,
    },
}

/// Heads and windows of an attention.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Shape {
    /// Heads.
    pub heads: usize,
    /// Channels of a head, a multiple of 16.
    pub width: usize,
    /// Which keys a query sees.
    pub windows: Windows,
}

//! Places of a product's rows and columns in its output.

/// Layout of rows and columns in the output.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(super) enum Layout {
    /// `[m][n]`
    #[default]
    Rows,
    /// `[n/width][m][width]`
    Groups(usize),
    /// `[m/columns][2][columns][2][n/4]`
    Shuffled(usize),
}

/// Column `j` of row `i` is at `of_column(j) + i·stride + ⌊i/run⌋·jump`.
#[derive(Clone, Copy)]
pub(super) struct Places {
    /// Columns that are contiguous.
    width: usize,
    /// From a group of such columns to the next, of even and of odd ones.
    group: usize,
    pair: usize,
    stride: usize,
    run: usize,
    jump: usize,
}

impl Places {
    /// Places of `m` rows and `n` columns.
    pub(super) fn new(layout: Layout, m: usize, n: usize) -> Self {
        let rows =
            |width| Self { width, group: m * width, pair: 2 * m * width, stride: width, run: usize::MAX, jump: 0 };
        match layout {
            Layout::Rows => rows(n),
            Layout::Groups(width) => rows(width),
            Layout::Shuffled(columns) => {
                let width = n / 4;
                let line = 2 * columns * width;
                Self { width, group: width, pair: line, stride: 2 * width, run: columns, jump: line }
            }
        }
    }

    /// Offset of a column from where its row begins.
    #[inline(always)]
    pub(super) fn of_column(&self, column: usize) -> usize {
        let group = column / self.width;
        group / 2 * self.pair + group % 2 * self.group + column % self.width
    }

    /// From a row to the next of the same run.
    #[inline(always)]
    pub(super) fn stride(&self) -> usize {
        self.stride
    }

    /// The rows from `first` on.
    #[inline(always)]
    pub(super) fn rows_from(&self, first: usize) -> Walk {
        let (runs, row) = (first / self.run, first % self.run);
        Walk { at: first * self.stride + runs * self.jump, left: self.run - row, of: *self }
    }
}

/// A walk over rows.
#[derive(Clone, Copy)]
pub(super) struct Walk {
    /// Where the row begins.
    pub(super) at: usize,
    /// Rows of the run from this one on.
    left: usize,
    of: Places,
}

impl Walk {
    /// Goes to the next row.
    #[inline(always)]
    pub(super) fn step(&mut self) {
        self.at += self.of.stride;
        self.left -= 1;
        if self.left == 0 {
            (self.at, self.left) = (self.at + self.of.jump, self.of.run);
        }
    }

    /// The walk from `rows` further on.
    #[inline(always)]
    pub(super) fn skip(mut self, mut rows: usize) -> Self {
        while rows >= self.left {
            rows -= self.left;
            self.at += self.left * self.of.stride + self.of.jump;
            self.left = self.of.run;
        }
        self.at += rows * self.of.stride;
        self.left -= rows;
        self
    }
}

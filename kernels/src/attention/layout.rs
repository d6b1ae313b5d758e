//! Places of windows in the sequences and in packed memory, and the blocks of queries that tasks own.

use std::ops::Range;

use super::rows::{KEY_BLOCK, QUERY_BLOCK, Shape, WHOLE, Windows};
use crate::size::product;

/// Places of the windows' tokens, in the sequences and packed.
pub(super) struct Layout {
    pub(super) shape: Shape,
    queries: usize,
    pub(super) keys: usize,
    /// The queries, where only some tokens of runs are queried.
    gathered: Option<Gathered>,
}

/// Rows of queries, sorted by window.
struct Gathered {
    /// Rows of the queries, window by window.
    rows: Vec<u32>,
    /// Start of each window's rows, and the end of the last.
    starts: Vec<usize>,
}

/// A block of queries of one head and window.
pub(super) struct QueryBlock {
    pub(super) window: usize,
    pub(super) head: usize,
    pub(super) queries: Range<usize>,
}

impl Layout {
    pub(super) fn new(shape: Shape, queries: usize, keys: usize, places: Option<&[u32]>) -> Self {
        let mut layout = Self { shape, queries, keys, gathered: None };
        if let Windows::Runs { length, .. } = shape.windows {
            assert!(length > 0, "windows of no tokens");
            match places {
                Some(places) => layout.gathered = Some(layout.gather(places)),
                None => assert_eq!(queries, keys, "windows need as many queries as keys, found {queries} and {keys}"),
            }
        }
        layout
    }

    /// Sorts queries into their windows.
    fn gather(&self, places: &[u32]) -> Gathered {
        let mut starts = vec![0; self.windows() + 1];
        for &place in places {
            starts[self.window(place as usize) + 1] += 1;
        }
        for window in 0..self.windows() {
            starts[window + 1] += starts[window];
        }
        let (mut next, mut rows) = (starts.clone(), vec![0; places.len()]);
        for (row, &place) in places.iter().enumerate() {
            let next = &mut next[self.window(place as usize)];
            rows[*next] = row as u32;
            *next += 1;
        }
        Gathered { rows, starts }
    }

    /// The window of a token.
    fn window(&self, token: usize) -> usize {
        assert!(token < self.keys, "a query at {token} among {} tokens", self.keys);
        match self.shape.windows {
            Windows::Full => 0,
            Windows::Runs { roll, .. } => (token + roll % self.keys) % self.keys / self.length(),
        }
    }

    /// Queries of a window.
    pub(super) fn queries(&self, window: usize) -> usize {
        match &self.gathered {
            Some(gathered) => gathered.starts[window + 1] - gathered.starts[window],
            None => self.count(window, self.queries),
        }
    }

    /// The row of query `i` of a window.
    #[inline(always)]
    pub(super) fn query(&self, window: usize, i: usize) -> usize {
        match &self.gathered {
            Some(gathered) => gathered.rows[gathered.starts[window] + i] as usize,
            None => self.row(window, i),
        }
    }

    fn length(&self) -> usize {
        match self.shape.windows {
            Windows::Full => self.keys,
            Windows::Runs { length, .. } => length.min(self.keys),
        }
    }

    fn windows(&self) -> usize {
        match self.shape.windows {
            Windows::Full => 1,
            Windows::Runs { .. } => self.keys.div_ceil(self.length().max(1)),
        }
    }

    /// Tokens of a window among `all` of a sequence.
    pub(super) fn count(&self, window: usize, all: usize) -> usize {
        match self.shape.windows {
            Windows::Full => all,
            Windows::Runs { .. } => self.length().min(all - window * self.length()),
        }
    }

    /// The row of token `i` of a window.
    #[inline(always)]
    pub(super) fn row(&self, window: usize, i: usize) -> usize {
        match self.shape.windows {
            Windows::Full => i,
            Windows::Runs { roll, .. } => {
                let back = self.keys - roll % self.keys;
                (window * self.length() + i + back) % self.keys
            }
        }
    }

    /// Length of the packed keys (or values) of one head in one window: whole register blocks of keys.
    pub(super) fn head_len(&self) -> usize {
        self.head_rows() * self.shape.width
    }

    /// Keys of one head of one window, in whole register blocks.
    pub(super) fn head_rows(&self) -> usize {
        self.length().next_multiple_of(WHOLE)
    }

    /// Keys of all heads and windows, in whole register blocks.
    pub(super) fn packed_rows(&self) -> usize {
        product([self.windows(), self.shape.heads, self.head_rows()])
    }

    /// Range of the scales of one head's keys in one window.
    pub(super) fn packed_scales(&self, window: usize, head: usize) -> Range<usize> {
        let start = (window * self.shape.heads + head) * self.head_rows();
        start..start + self.head_rows()
    }

    /// Scales of the values of one head of one window: one per block of keys and channel.
    pub(super) fn head_value_scales(&self) -> usize {
        self.length().div_ceil(KEY_BLOCK) * self.shape.width
    }

    /// Scales of all values.
    pub(super) fn all_value_scales(&self) -> usize {
        product([self.windows(), self.shape.heads, self.head_value_scales()])
    }

    /// Range of the scales of one head's values in one window.
    pub(super) fn value_scales(&self, window: usize, head: usize) -> Range<usize> {
        let start = (window * self.shape.heads + head) * self.head_value_scales();
        start..start + self.head_value_scales()
    }

    /// Length of the packed keys of all heads and windows.
    pub(super) fn packed_len(&self) -> usize {
        product([self.windows(), self.shape.heads, self.head_len()])
    }

    pub(super) fn packed(&self, window: usize, head: usize) -> Range<usize> {
        let start = (window * self.shape.heads + head) * self.head_len();
        start..start + self.head_len()
    }

    pub(super) fn tasks(&self) -> Vec<QueryBlock> {
        let mut tasks = Vec::new();
        for window in 0..self.windows() {
            let count = self.queries(window);
            for head in 0..self.shape.heads {
                for start in (0..count).step_by(QUERY_BLOCK) {
                    tasks.push(QueryBlock { window, head, queries: start..(start + QUERY_BLOCK).min(count) });
                }
            }
        }
        tasks
    }
}

//! The tokens that a pass computes, as rows, and kept rows for the comparison.

use streamsplat_kernels::Level;
use streamsplat_kernels::change::{Tolerance, moved};
use streamsplat_kernels::memory::Aligned;

use crate::layers::sized;

/// Rows of a matrix `[n, d]`: their places and their values.
pub(crate) struct Rows {
    /// Their places; `None`: all, in order.
    pub(crate) at: Option<Vec<u32>>,
    /// `[rows, d]`
    pub(crate) x: Aligned<f32>,
}

impl Rows {
    /// The rows `at` of `x [n, d]`, in `memory`.
    pub(super) fn gather(at: Option<Vec<u32>>, x: &[f32], d: usize, memory: Aligned<f32>) -> Rows {
        let mut rows = Rows { at, x: memory };
        match &rows.at {
            None => sized(&mut rows.x, x.len()).copy_from_slice(x),
            Some(at) => gather(at, x, d, sized(&mut rows.x, at.len() * d)),
        }
        rows
    }

    /// Keeps the rows that are `wanted`.
    fn retain(&mut self, wanted: &[bool], d: usize) {
        let mut kept = 0;
        for (row, _) in wanted.iter().enumerate().filter(|(_, wanted)| **wanted) {
            if let Some(at) = &mut self.at {
                at[kept] = at[row];
            }
            self.x.copy_within(row * d..(row + 1) * d, kept * d);
            kept += 1;
        }
        if let Some(at) = &mut self.at {
            at.truncate(kept);
        }
        self.x.resize(kept * d);
    }
}

/// Copies the rows `at` of `x [n, d]` to `to`, one after the other.
pub(crate) fn gather(at: &[u32], x: &[f32], d: usize, to: &mut [f32]) {
    for (row, to) in at.iter().zip(to.chunks_exact_mut(d)) {
        to.copy_from_slice(&x[*row as usize * d..][..d]);
    }
}

/// Writes the rows of `x` to the places `at` of `to [n, d]`.
pub(super) fn scatter(at: &[u32], x: &[f32], to: &mut [f32], d: usize) {
    for (row, x) in at.iter().zip(x.chunks_exact(d)) {
        to[*row as usize * d..][..d].copy_from_slice(x);
    }
}

/// Writes the rows of every head of `x [heads][rows][width]` to their places in `kept [heads][n][width]`. If `at` is
/// `None`, `kept` is rebuilt.
pub(crate) fn keep_heads(at: Option<&[u32]>, x: &[f32], width: usize, kept: &mut Vec<f32>) {
    match at {
        None => {
            kept.clear();
            kept.extend_from_slice(x);
        }
        Some([]) => {}
        Some(at) => {
            let heads = x.len() / (at.len() * width);
            let n = kept.len() / heads;
            for (x, to) in x.chunks_exact(at.len() * width).zip(kept.chunks_exact_mut(n)) {
                scatter(at, x, to, width);
            }
        }
    }
}

/// The places that are `true`.
pub(super) fn places(marks: &[bool]) -> Vec<u32> {
    (0..marks.len() as u32).filter(|i| marks[*i as usize]).collect()
}

/// Rows as of their last computation.
#[derive(Debug)]
pub(super) struct Gate {
    d: usize,
    rows: usize,
    reference: Vec<f32>,
}

impl Gate {
    /// A gate of `rows` rows of width `d`; takes no memory before the first [`Gate::keep`].
    pub(super) fn new(rows: usize, d: usize) -> Gate {
        Gate { d, rows, reference: Vec::new() }
    }

    /// Keeps all of `x`.
    pub(super) fn keep(&mut self, x: &[f32]) {
        self.reference.clear();
        self.reference.extend_from_slice(x);
        self.rows = x.len() / self.d;
    }

    /// Marks the rows of `x` that moved; all of them when nothing of this size was kept.
    pub(super) fn moved(&self, level: Level, tolerance: Tolerance, x: &[f32]) -> Vec<bool> {
        let mut marks = vec![true; x.len() / self.d];
        if x.len() == self.reference.len() {
            moved(level, tolerance, self.d, x, &self.reference, None, &mut marks);
        }
        marks
    }

    /// Keeps the rows `at` of `x`, which holds all rows.
    pub(super) fn replace(&mut self, at: &[u32], x: &[f32]) {
        for range in at.iter().map(|row| *row as usize * self.d..(*row as usize + 1) * self.d) {
            self.reference[range.clone()].copy_from_slice(&x[range]);
        }
    }

    /// Drops the rows that did not move, and keeps the values of the others. Keeps all where `rows` holds all rows.
    pub(super) fn pass(&mut self, level: Level, tolerance: Tolerance, rows: &mut Rows) {
        let Some(at) = &rows.at else { return self.keep(&rows.x) };
        let mut marks = vec![false; at.len()];
        moved(level, tolerance, self.d, &rows.x, &self.reference, Some(at), &mut marks);
        rows.retain(&marks, self.d);
        scatter(rows.at.as_deref().unwrap_or_default(), &rows.x, &mut self.reference, self.d);
    }

    /// All rows as they were kept.
    pub(super) fn reference(&self) -> &[f32] {
        &self.reference
    }

    /// Number of rows.
    pub(super) fn rows(&self) -> usize {
        self.rows
    }

    /// Values in a row.
    pub(super) fn width(&self) -> usize {
        self.d
    }

    pub(super) fn bytes(&self) -> usize {
        4 * self.reference.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_every_head_reach_their_places() {
        let (n, width) = (3, 2);
        let mut to = Vec::new();
        keep_heads(None, &[0.0; 12], width, &mut to);
        assert_eq!(to.len(), 2 * n * width);
        // Two rows of two heads; the last row first.
        keep_heads(Some(&[2, 0]), &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0], width, &mut to);
        assert_eq!(to, [3.0, 4.0, 0.0, 0.0, 1.0, 2.0, 7.0, 8.0, 0.0, 0.0, 5.0, 6.0]);
        keep_heads(Some(&[]), &[], width, &mut to);
        assert_eq!(to[..2], [3.0, 4.0]);
    }
}
